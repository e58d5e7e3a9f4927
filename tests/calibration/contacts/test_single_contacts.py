# SPDX-License-Identifier: Apache-2.0
"""Contact circles found in synthetic and in real images."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.calibration.capture import CaptureSet, ContactCircle
from taccel_lab.calibration.contacts.fit import detect_contact
from taccel_lab.calibration.contacts.labels import compare_with_labels
from taccel_lab.calibration.contacts.rim import fit_circle
from taccel_lab.errors import InputError
from tests.calibration.contacts.presses import contacts_of
from tests.support.synthetic_presses import (
    GRID,
    flat_background,
    press_image,
    synthetic_captures,
    with_circles,
)


@given(
    x=st.floats(-500, 500), y=st.floats(-500, 500), radius=st.floats(5, 200),
    outliers=st.integers(0, 30), seed=st.integers(0, 50),
)  # fmt: skip
def test_a_circle_ignores_outliers(
    x: float, y: float, radius: float, outliers: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    good = np.column_stack([x + radius * np.cos(angle), y + radius * np.sin(angle)])
    away = rng.uniform(1.5, 3.0, outliers) * radius
    turn = rng.uniform(0, 2 * np.pi, outliers)
    bad = np.column_stack([x + away * np.cos(turn), y + away * np.sin(turn)])
    points = np.concatenate([good, bad])
    # A guess as rough as the first circles of presses.
    start = np.array([x, y]) + 0.15 * radius * rng.uniform(-1, 1, 2)
    fit = fit_circle(points, start, radius * rng.uniform(0.85, 1.15), tolerance=0.05 * radius)
    assert fit.center == pytest.approx([x, y], abs=1e-6 * max(radius, abs(x), abs(y)))
    assert fit.radius == pytest.approx(radius, rel=1e-6)
    assert fit.inliers.tolist() == [True] * 60 + [False] * outliers


@settings(max_examples=10)
@given(u=st.floats(30, 130), v=st.floats(30, 90), radius=st.floats(11, 17), seed=st.integers(0, 99))
def test_finds_synthetic_contacts(u: float, v: float, radius: float, seed: int) -> None:
    circle = ContactCircle(u, v, radius)
    image, _ = press_image(circle, np.random.default_rng(seed), noise=2.0)
    found = detect_contact(image, flat_background(), GRID)
    assert np.hypot(found.circle.u_px - u, found.circle.v_px - v) < 1.0
    assert abs(found.circle.radius_px - radius) < 2.0
    assert found.inlier_fraction > 0.8


def test_drift_does_not_look_like_a_contact() -> None:
    rng = np.random.default_rng(1)
    image = flat_background() + [9.0, -4.0, 6.0] + rng.normal(0, 2, flat_background().shape)
    with pytest.raises(InputError, match=r"empty\.png: no contact found.*give its circle"):
        detect_contact(image, flat_background(), GRID, name="empty.png")


def test_a_straight_edge_is_not_a_ball() -> None:
    image = flat_background()
    image[:, 80:84] += 60.0
    with pytest.raises(InputError, match=r"edge\.png: no round contact found"):
        detect_contact(image, flat_background(), GRID, name="edge.png")


def test_masked_pixels_have_no_effect() -> None:
    circle = ContactCircle(70.0, 60.0, 14.0)
    image, _ = press_image(circle, np.random.default_rng(0))
    mask = np.ones(image.shape[:2], dtype=bool)
    mask[5:25, 100:150] = False
    poisoned = image.copy()
    poisoned[5:25, 100:150] = 255
    clean = detect_contact(image, flat_background(), GRID, mask=mask)
    assert detect_contact(poisoned, flat_background(), GRID, mask=mask) == clean


def test_agreement_counts_labelled_presses_only() -> None:
    captures, _ = synthetic_captures(4)
    captures = with_circles(captures, {2: None})
    found = contacts_of(captures)
    agreement = compare_with_labels(captures, found)
    assert agreement is not None and agreement.count == 3
    assert agreement.center_median_px < 1.0
    assert compare_with_labels(with_circles(captures, [None] * 4), found) is None


@pytest.mark.parametrize("every", [4, pytest.param(1, marks=pytest.mark.slow)])
def test_real_presses(taxim_captures: CaptureSet, every: int) -> None:
    some = taxim_captures.only(range(0, 48, every))
    # Labels are clicked by hand: even pixels, odd radii; 3 px are 0.09 mm.
    agreement = compare_with_labels(some, contacts_of(some))
    assert agreement is not None and agreement.count == 48 // every
    assert agreement.center_median_px < 2.2 and agreement.center_p90_px < 4.5
    assert agreement.radius_median_px < 1.8 and agreement.radius_p90_px < 3.3


def test_real_background_is_refused(taxim_captures: CaptureSet) -> None:
    with pytest.raises(InputError, match="no contact found"):
        detect_contact(taxim_captures.background, taxim_captures.background, taxim_captures.grid)
