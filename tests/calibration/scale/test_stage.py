# SPDX-License-Identifier: Apache-2.0
"""Places of a stage give the scale, however its axes lie in the image."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.capture.captures import CapturedPress, ContactCircle
from taccel_lab.calibration.scale.ball_contacts import BallContact, scale_from_stage
from taccel_lab.errors import InputError

SCALE = np.array([0.0634, 0.0621])


def contacts(
    angle_deg: float = 0.0, mirrored: bool = False, noise_px: float = 0.0, step: int = 0, seed=0
) -> list[BallContact]:
    """Three presses at each of 12 places; the table lags behind by ``step`` presses."""
    rng = np.random.default_rng(seed)
    places = [(x, y) for y in (-4, 0, 4) for x in (-6, -2, 2, 6) for _ in range(3)]
    c, s = np.cos(np.deg2rad(angle_deg)), np.sin(np.deg2rad(angle_deg))
    turn = np.array([[c, -s], [s, c]]) @ np.diag([1.0, -1.0 if mirrored else 1.0])
    found = []
    for k in range(len(places) - step):
        u, v = np.array([160, 120]) + turn.T @ places[k] / SCALE + noise_px * rng.normal(size=2)
        circle = ContactCircle(float(u), float(v), 16.0)
        press = CapturedPress(
            f"{k}", f"{k}", "", lambda: np.zeros(0), circle, stage_mm=places[k + step]
        )
        found.append(BallContact(press, 2.0, circle))
    return found


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("angle_deg", [0.0, 37.0, 90.0, 180.0])
def test_exact_places_give_the_exact_scale(angle_deg: float, mirrored: bool) -> None:
    found = scale_from_stage(contacts(angle_deg, mirrored))
    assert found.x is not None and found.y is not None
    assert (found.x.value, found.y.value) == pytest.approx(SCALE, rel=1e-9)


def test_the_interval_holds_the_scale() -> None:
    inside, draws = 0, 60
    for seed in range(draws):
        found = scale_from_stage(contacts(20.0, noise_px=2.0, seed=seed))
        assert found.x is not None and found.x.sigma < 0.01 * SCALE[0]
        low, high = found.x.interval95
        inside += low < SCALE[0] < high
    assert 0.85 * draws < inside


def test_one_wrong_contact_changes_little() -> None:
    found = contacts(noise_px=0.5)
    found[7] = BallContact(found[7].press, 2.0, ContactCircle(300.0, 10.0, 16.0))
    estimate = scale_from_stage(found)
    assert estimate.x is not None and estimate.x.value == pytest.approx(SCALE[0], rel=0.01)


def test_a_table_that_is_out_of_step_and_places_on_a_line_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is each press beside the place"):
        scale_from_stage(contacts(noise_px=0.5, step=1))
    with pytest.raises(InputError, match="all on one line; at least 4"):
        scale_from_stage(contacts()[:12])
