# SPDX-License-Identifier: Apache-2.0
"""The map between disc and rounded rectangle is what it claims to be."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.cad.mesh.conformal import disc_automorphism, disc_map
from taccel_lab.cad.mesh.plan_smoothing import smooth_plan
from taccel_lab.cad.parts.pad_outline import PadOutline, d_shape, rounded_rectangle


@pytest.mark.parametrize(
    "outline",
    [
        rounded_rectangle(24, 20, 2),
        rounded_rectangle(20, 25, 1.5),
        rounded_rectangle(16, 16, 4),
        d_shape(18.4, 25, 1.3),
        d_shape(18.4, 25, 1.3).inset(0.9),
    ],
)
def test_outline_maps_to_the_circle_and_back(outline: PadOutline) -> None:
    chart = disc_map(outline)
    np.testing.assert_allclose(np.abs(chart.disc_from_plan(chart.outline_mm)), 1, atol=2e-4)
    for factor in (0.2, 0.5, 0.8):
        z = factor * chart.outline_mm
        np.testing.assert_allclose(chart.plan_from_disc(chart.disc_from_plan(z)), z, atol=2e-3)


def test_map_is_conformal() -> None:
    chart = disc_map(rounded_rectangle(24, 20, 2))
    w = 0.7 * np.exp(1j * np.linspace(0, 2 * np.pi, 40))
    step = 1e-6
    along = chart.plan_from_disc(w + step) - chart.plan_from_disc(w)
    across = chart.plan_from_disc(w + 1j * step) - chart.plan_from_disc(w)
    np.testing.assert_allclose(across / along, 1j, atol=1e-5)
    slope = chart.slope_mm(complex(w[3]))
    assert slope == pytest.approx(complex(along[3]) / step, rel=1e-5)


def test_a_circle_maps_by_scaling_alone() -> None:
    chart = disc_map(rounded_rectangle(20, 20, 9.999))
    w = np.array([0.3 + 0.2j, -0.8j])
    np.testing.assert_allclose(chart.plan_from_disc(w), 10 * w, atol=5e-3)


def test_automorphism_keeps_the_circle_and_moves_the_centre() -> None:
    center = 0.4 - 0.5j
    circle = np.exp(1j * np.linspace(0, 6, 9))
    assert disc_automorphism(np.array(0.0), center) == pytest.approx(center)
    np.testing.assert_allclose(np.abs(disc_automorphism(circle, center)), 1, atol=1e-12)


def test_smoothing_unfolds_and_squares_a_grid() -> None:
    n = 5
    i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    square = np.stack([i, j], axis=-1).reshape(-1, 2).astype(float)
    a = (i[:-1, :-1] * n + j[:-1, :-1]).ravel()
    quads = np.stack([a, a + n, a + n + 1, a + 1], axis=1)
    free = ((i > 0) & (i < n - 1) & (j > 0) & (j < n - 1)).ravel().nonzero()[0]
    folded = square.copy()
    folded[free] += np.random.default_rng(0).uniform(-1.5, 1.5, (len(free), 2))
    smoothed = smooth_plan(folded, quads, free, iterations=400)
    np.testing.assert_allclose(smoothed, square, atol=0.02)
    fixed = np.setdiff1d(np.arange(n * n), free)
    assert np.array_equal(smoothed[fixed], square[fixed])
