# SPDX-License-Identifier: Apache-2.0
"""Huber's weights: the constant that is stated is the one that is used, whatever the axes."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.calibration.camera.board import BoardView
from taccel_lab.calibration.camera.plane_fit import fit_planes
from taccel_lab.calibration.camera.plane_models import BentHomography
from taccel_lab.calibration.camera.robust import huber_weights


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
