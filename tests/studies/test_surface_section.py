# SPDX-License-Identifier: Apache-2.0
"""Sections of a mesh against scipy's interpolation on the same triangles."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import Delaunay

from taccel_lab.studies.presses.press_record import section_heights


def test_a_section_is_the_piecewise_linear_interpolant() -> None:
    rng = np.random.default_rng(0)
    plane = rng.uniform(-1, 1, (300, 2))
    plane[:20, 1] = 0.0  # Nodes on the line, and edges along it.
    mesh, heights = Delaunay(plane), rng.normal(size=300)
    x = np.linspace(-1.2, 1.2, 500)
    expected = LinearNDInterpolator(mesh, heights)(x, np.zeros(500))
    points = np.column_stack([plane, heights])
    found = section_heights(points, mesh.simplices, x)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert np.isnan(found).any() and np.isfinite(found).sum() > 300
    # Of two surfaces the upper one is seen.
    both = np.concatenate([points, points - [0, 0, 1]])
    faces = np.concatenate([mesh.simplices + 300, mesh.simplices])
    np.testing.assert_array_equal(section_heights(both, faces, x), found)
