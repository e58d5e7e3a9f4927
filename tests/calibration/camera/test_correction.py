# SPDX-License-Identifier: Apache-2.0
"""The spline over what a model of the gel's plane leaves: its held-out error is one."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.calibration.camera.board import BoardView
from taccel_lab.calibration.camera.plane_fit import correct_plane, fit_planes
from taccel_lab.calibration.camera.plane_models import BentHomography

SIZE, SHAPE, NOISE_PX = (300, 300), (9, 7), 0.3


def board(bulge_px: float, seed: int) -> BoardView:
    """A board that is pushed aside in its middle."""
    rng = np.random.default_rng(seed)
    index = np.stack(np.meshgrid(*map(np.arange, SHAPE)), axis=-1).reshape(-1, 2)
    place = index - (np.array(SHAPE) - 1) / 2
    uv = 25.0 * place + 149.5 + rng.normal(0, NOISE_PX, place.shape)
    uv += bulge_px * np.exp(-((place / 2.0) ** 2).sum(axis=1))[:, None] * (1, -0.7)
    return BoardView("v", "v", SIZE, index, uv, len(index), pitch_mm=1.0)


@pytest.mark.parametrize(("bulge_px", "boards"), [(1.0, 8), (3.0, 2)])
def test_the_held_out_error_is_that_of_another_picture_of_the_board(
    bulge_px: float, boards: int
) -> None:
    stated, found = [], []
    for seed in range(boards):
        view = board(bulge_px, seed)
        fit = fit_planes([view], [BentHomography(SIZE, 9.0, 2, True)])[0]
        corrected = correct_plane(fit, [view], 1.0)
        if corrected.correction is None:
            continue
        assert corrected.heldout_px < fit.heldout_px
        predicted = corrected.project(view.board_mm()[:, :2])
        fresh = [
            np.sum((board(bulge_px, 100 + k).uv_px - predicted) ** 2, axis=1) for k in range(9)
        ]
        stated.append(corrected.heldout_px**2)
        found.append(np.mean(fresh))
    assert len(stated) >= 1
    # Points of the picture that is fitted are nearer to it than those of another one.
    assert 0.97 < np.sqrt(np.mean(stated) / np.mean(found)) < 1.15
