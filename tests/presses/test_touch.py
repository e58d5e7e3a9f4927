# SPDX-License-Identifier: Apache-2.0
"""The height of first touch against closed forms, and against distances found another way."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.bodies.crossings import point_triangle_distances
from taccel_lab.presses import parse_indenter
from taccel_lab.presses.touch import first_touch_m
from taccel_lab.scene import Ball, TriangleMesh

DOME_M = 50e-3


def grid_surface(heights: np.ndarray, step_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and triangles of a height field [rows, columns] about the origin."""
    rows, columns = heights.shape
    y, x = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    xy = np.stack([x - (columns - 1) / 2, y - (rows - 1) / 2], axis=-1) * step_m
    nodes = np.concatenate([xy, heights[..., None]], axis=-1).reshape(-1, 3)
    i = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    halves = ([i, i + 1, i + columns], [i + 1, i + columns + 1, i + columns])
    return nodes, np.concatenate([np.stack(half, axis=1) for half in halves])


AXIS = (np.arange(61) - 30) * 0.2e-3
DOME = grid_surface(np.sqrt(DOME_M**2 - AXIS[:, None] ** 2 - AXIS**2) - DOME_M, 0.2e-3)
"""Apex at the origin; facets dip by at most step^2 / (4 R) = 0.2 um."""

coordinate = st.floats(-1.0, 1.0)


@given(x=coordinate, y=coordinate, radius=st.sampled_from([0.5e-3, 2e-3]))
def test_ball_over_a_dome_off_centre(x, y, radius):
    at = 3e-3 * np.array([x, y])
    touch = first_touch_m(Ball(radius), *DOME, at)
    expected = math.sqrt((DOME_M + radius) ** 2 - at @ at) - DOME_M
    assert expected - 0.25e-6 <= touch <= expected + 1e-12


def knife(angle: float) -> TriangleMesh:
    """A narrow prism, 4 mm long, whose sharp edge, at z = 0, looks down."""
    h, w, t = 2e-3, 0.05e-3, 2e-3
    corners = np.array([[-h, 0, 0], [h, 0, 0], [-h, -w, t], [h, -w, t], [-h, w, t], [h, w, t]])
    c, s = math.cos(angle), math.sin(angle)
    faces = [[0, 1, 3], [0, 3, 2], [0, 5, 1], [0, 4, 5], [2, 3, 5], [2, 5, 4], [0, 2, 4], [1, 5, 3]]
    return TriangleMesh(corners @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]), np.array(faces))


@given(angle=st.floats(0, math.pi), x=st.floats(-0.9e-3, 0.9e-3), y=st.floats(-0.9e-3, 0.9e-3))
def test_sharp_edge_between_the_nodes_of_a_ridge(angle, x, y):
    """Edge against edge: neither has a corner near the point of first touch."""
    ridge = grid_surface(np.array([[-1.0, 0.0, -1.0]] * 2) * 1e-3, 6e-3)
    touch = first_touch_m(knife(angle), *ridge, np.array([x, y]))
    # Height of the roof-shaped surface below the highest point of the knife's edge.
    away = max(abs(x) - 2e-3 * abs(math.cos(angle)), 0.0)
    assert touch == pytest.approx(-1e-3 * away / 6e-3, abs=2e-5)


@given(
    heights=st.lists(coordinate, min_size=16, max_size=16),
    at=st.tuples(coordinate, coordinate),
    radius=st.floats(1e-4, 6e-3),
)
def test_ball_at_first_touch_is_one_radius_away(heights, at, radius):
    nodes, faces = grid_surface(1e-3 * np.array(heights).reshape(4, 4), 1e-3)
    x, y = 2.5e-3 * np.array(at)
    touch = first_touch_m(Ball(radius), nodes, faces, np.array([x, y]))
    if touch == -np.inf:
        # Beside the surface: even as seen from above, every face is out of reach.
        flat = nodes * [1, 1, 0]
        assert point_triangle_distances(np.array([x, y, 0.0]), flat[faces]).min() > radius - 1e-9
        return
    distance, higher = (
        point_triangle_distances(np.array([x, y, touch + up]), nodes[faces]).min()
        for up in (0.0, 1e-5)
    )
    assert distance == pytest.approx(radius, abs=1e-9) and higher > radius


COUNTS = np.stack(np.meshgrid(np.arange(61), np.arange(61)), axis=-1).reshape(-1, 2)
COUNTS = COUNTS[COUNTS.sum(axis=1) <= 60]
SHARES = np.column_stack([COUNTS, 60 - COUNTS.sum(axis=1)]) / 60


@given(
    heights=st.lists(coordinate, min_size=9, max_size=9),
    lowest=st.tuples(st.floats(-0.2, 0.2), st.floats(-0.6, -0.2)),
    at=st.tuples(coordinate, coordinate),
)
def test_mesh_against_dense_sampling(heights, lowest, at):
    """No sample of the surface lies above the indenter at first touch, and one nearly touches."""
    at = 1e-3 * np.array(at)
    nodes, faces = grid_surface(np.array(heights).reshape(3, 3) * 0.5e-3, 1.5e-3)
    tip = np.array([[*lowest, 0.0], [-1, -1, 0.5], [1, -1, 0.5], [0, 1, 0.5]]) * 1e-3
    shape = TriangleMesh(tip, np.array([[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3]]))
    touch = first_touch_m(shape, nodes, faces, at)

    corners = shape.vertices_m[shape.faces[:3]] + [*at, touch]
    points = np.einsum("sw,fwi->fsi", SHARES, corners).reshape(-1, 3)
    points = points[np.abs(points[:, :2]).max(axis=1) <= 1.5e-3]
    over = np.vstack([points[:, :2].T, np.ones(len(points))])
    above = np.full(len(points), -np.inf)
    for triangle in nodes[faces]:
        weights = np.linalg.solve(np.vstack([triangle[:, :2].T, np.ones(3)]), over)
        inside = (weights >= -1e-9).all(axis=0)
        above[inside] = np.maximum(above[inside], (triangle[:, 2] @ weights)[inside])
    gap = points[:, 2] - above
    # Slopes are at most 1.5 and 1, and some sample lies within 0.03 mm of the touch.
    assert -1e-9 < gap.min() < 2.5 * 0.03e-3


@pytest.mark.parametrize("text", ["sphere:1", "cylinder:1", "box:2x2"])
def test_beside_the_surface(text):
    surface, shape = grid_surface(np.zeros((5, 5)), 3e-3), parse_indenter(text).shape
    for at_mm in ((7.01, 0.0), (0.0, -7.01), (100.0, 100.0)):
        assert first_touch_m(shape, *surface, np.array(at_mm) * 1e-3) == -np.inf
    assert first_touch_m(shape, *surface, np.array([6.9e-3, 0.0])) > -1e-3
