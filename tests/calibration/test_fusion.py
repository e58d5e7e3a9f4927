# SPDX-License-Identifier: Apache-2.0
"""Fused circles are closer to the truth than labels or detections."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calibration.capture import ContactCircle
from calibration.targets import choose_circles, fuse_circles, resolve_contacts
from taccel_lab.errors import InputError
from tests.calibration.synthetic import synthetic_captures


def circles(values: np.ndarray) -> list[ContactCircle]:
    return [ContactCircle(*(float(x) for x in row)) for row in values]


def radii(items: list[ContactCircle]) -> np.ndarray:
    return np.array([item.radius_px for item in items])


@pytest.mark.parametrize("true_spread", [0.0, 1.0, 5.0])
def test_fusion_beats_both(true_spread: float) -> None:
    rng = np.random.default_rng(0)
    truth = np.column_stack([np.full((400, 2), 100.0), rng.normal(60, true_spread, 400)])
    label = truth + rng.normal(0, 2.0, truth.shape)
    found = truth + rng.normal(0, 2.0, truth.shape)
    fused = fuse_circles(circles(label), circles(found))
    error = radii(fused) - truth[:, 2]
    # Best possible: the posterior spread of two measurements with noise 2 and prior true_spread.
    best = (1 / (2 / 4.0 + 1 / true_spread**2)) ** 0.5 if true_spread else 0.0
    assert error.std() < best * 1.1 + 0.25
    assert np.std([c.u_px - 100 for c in fused]) == pytest.approx(2 / np.sqrt(2), rel=0.1)


@given(
    st.lists(
        st.tuples(st.floats(20, 200), st.floats(20, 200), st.floats(5, 60), st.floats(5, 60)),
        min_size=1,
        max_size=20,
    )
)
def test_fused_radii_stay_within_the_measured_range(
    rows: list[tuple[float, float, float, float]],
) -> None:
    label = [ContactCircle(u, v, a) for u, v, a, _ in rows]
    found = [ContactCircle(u, v, b) for u, v, _, b in rows]
    fused = radii(fuse_circles(label, found))
    mean = (radii(label) + radii(found)) / 2
    assert fused.mean() == pytest.approx(mean.mean())
    assert (fused >= mean.min() - 1e-9).all() and (fused <= mean.max() + 1e-9).all()


def test_few_presses_are_only_averaged() -> None:
    label = [ContactCircle(50, 50, r) for r in (20.0, 30.0)]
    found = [ContactCircle(52, 50, r) for r in (24.0, 28.0)]
    assert fuse_circles(label, found) == [ContactCircle(51, 50, 22.0), ContactCircle(51, 50, 29.0)]


def test_choice_of_circles() -> None:
    captures, _ = synthetic_captures(3)
    object.__setattr__(captures.presses[1], "circle", None)
    found = resolve_contacts(captures)
    for which in ("fused", "labels", "detected"):
        chosen = choose_circles(captures, found, which)
        assert chosen[1] == found[1].circle
    given = captures.presses[0].circle
    assert given is not None
    assert choose_circles(captures, found, "labels")[0] == given
    assert choose_circles(captures, found, "detected")[0] == found[0].circle
    fused = choose_circles(captures, found, "fused")[0]
    assert fused.u_px == pytest.approx((given.u_px + found[0].circle.u_px) / 2)


def test_counts_have_to_match() -> None:
    with pytest.raises(InputError, match="1 labels do not match 0"):
        fuse_circles([ContactCircle(5, 5, 5)], [])
