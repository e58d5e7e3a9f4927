# SPDX-License-Identifier: Apache-2.0
"""A camera that refocuses between views of the board is found out, one that does not is not."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.calibration.camera.board import BoardView
from taccel_lab.calibration.camera.intrinsics import calibrate_intrinsics
from taccel_lab.calibration.camera.lens import LENSES
from tests.calibration.drawn.boards import BOARD, PITCH, SIZE, TRUTHS, lattice_points, pose_over

FOCAL = TRUTHS["k1"][0]


def views(factors: np.ndarray, noise_px: float, seed: int = 0) -> list[BoardView]:
    """Views whose focal lengths are the true ones times these factors."""
    rng, found = np.random.default_rng(seed), []
    index = lattice_points(*BOARD[:2])
    points = np.column_stack([index * PITCH, np.zeros(len(index))])
    while len(found) < len(factors):
        pose = pose_over(
            *BOARD, distance_mm=rng.uniform(26, 40), tilt_deg=tuple(rng.uniform(-35, 35, 2)),
            turn_deg=rng.uniform(-180, 180), shift_mm=tuple(rng.uniform(-8, 8, 2)),
        )  # fmt: skip
        lens = TRUTHS["k1"] * np.array([factors[len(found)]] * 2 + [1.0] * 3)
        uv = LENSES["k1"].project(points, lens, pose) + rng.normal(0, noise_px, (len(index), 2))
        if (uv > 2).all() and (uv < np.array(SIZE) - 3).all():
            name = f"view{len(found)}"
            found.append(BoardView(name, name, SIZE, index, uv, len(index), pitch_mm=PITCH))
    return found


ONE = np.where(np.arange(12) == 5, 1.03, 1.0)
DRIFT = np.linspace(0.95, 1.05, 12)
GROUPS = np.where(np.arange(12) % 3 == 0, 1.06, 1.0)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("factors", "noise_px", "name", "widest"),
    [(DRIFT, 0.02, "view0", 0.05), (ONE, 0.02, "view5", 0.02), (GROUPS, 0.05, "view3", 0.05)],
)
def test_views_of_other_focal_lengths_are_named(
    factors: np.ndarray, noise_px: float, name: str, widest: float
) -> None:
    found = calibrate_intrinsics(views(factors, noise_px), models=("k1",))
    (remark,) = (one for one in found.remarks if one.code == "focals_differ")
    assert name in remark.message and "tilt" not in remark.message
    assert "focal_uncertain" not in [one.code for one in found.remarks]
    # The figure is as uncertain as the camera was.
    relative = found.chosen.fit.sigma[0] / found.parameters[0]
    assert 0.3 * factors.std() < relative < widest


@pytest.mark.thorough
@pytest.mark.parametrize("noise_px", [0.02, 0.2])
def test_a_camera_that_stays_as_it_is_gets_no_remark(noise_px: float) -> None:
    z = []
    for seed in range(8):
        found = calibrate_intrinsics(views(np.ones(12), noise_px, seed), models=("k1",))
        assert not found.remarks
        z.append((found.parameters[0] - FOCAL) / found.chosen.fit.sigma[0])
    assert 0.4 < np.sqrt(np.mean(np.square(z))) < 1.7
