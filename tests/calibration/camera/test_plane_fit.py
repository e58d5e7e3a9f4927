# SPDX-License-Identifier: Apache-2.0
"""Huber's weights, and the spline over what a model of the gel's plane leaves."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.calibration.camera.board import BoardView
from taccel_lab.calibration.camera.plane_fit import correct_plane, fit_planes
from taccel_lab.calibration.camera.plane_models import BentHomography
from taccel_lab.calibration.camera.robust import huber_weights

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


def test_efficiency_on_normal_noise_is_the_stated_one() -> None:
    """Variance of the mean of normal 2-vectors over that of Huber's estimate, by its influence."""
    length = np.linspace(0, 12, 240_001)
    density = length * np.exp(-(length**2) / 2) * length[1]
    weight = huber_weights(np.stack([length, 0 * length], axis=1), 1.0)
    psi = weight * length
    # Divergence of psi(x) x / |x| in two dimensions.
    slope = np.gradient(psi, length) + weight
    efficiency = (0.5 * np.sum(density * slope)) ** 2 / (0.5 * np.sum(density * psi**2))
    assert efficiency == pytest.approx(0.98, abs=0.004)


def test_a_plane_is_fitted_alike_in_a_turned_image() -> None:
    rng = np.random.default_rng(0)
    index = np.stack(np.meshgrid(np.arange(9), np.arange(9)), axis=-1).reshape(-1, 2)
    seen = 20.0 * (index - 4) + rng.normal(0, 0.3, index.shape)
    seen[::9] += rng.normal(0, 3.0, seen[::9].shape)
    fits = []
    for turn in (0.0, np.pi / 4):
        c, s = np.cos(turn), np.sin(turn)
        uv = seen @ np.array([[c, s], [-s, c]]) + 149.5
        view = BoardView("v", "v.png", (300, 300), index, uv, len(index), pitch_mm=1.0)
        fit = fit_planes([view], [BentHomography((300, 300), 4.0)])[0]
        fits.append((fit.project(view.board_mm()[:, :2]) - 149.5) @ np.array([[c, -s], [s, c]]))
    assert fits[1] == pytest.approx(fits[0], abs=2e-3)
