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
    faces = np.concatenate(
        [
            np.stack([i, i + 1, i + columns], axis=1),
            np.stack([i + 1, i + columns + 1, i + columns], axis=1),
        ]
    )
    return nodes, faces


def dome_height(radius_sq: np.ndarray | float) -> np.ndarray | float:
    return np.sqrt(DOME_M**2 - radius_sq) - DOME_M


def dome(step_m: float = 0.2e-3, count: int = 61) -> tuple[np.ndarray, np.ndarray]:
    """A spherical face, apex at the origin; facets dip by at most step^2 / (4 R) = 0.2 um."""
    axis = (np.arange(count) - (count - 1) / 2) * step_m
    return grid_surface(np.asarray(dome_height(axis[:, None] ** 2 + axis[None] ** 2)), step_m)


DOME = dome()
FACET_DIP_M = 0.25e-6


@given(
    at_x=st.floats(-3e-3, 3e-3), at_y=st.floats(-3e-3, 3e-3), radius=st.sampled_from([0.5e-3, 2e-3])
)
def test_ball_over_a_dome_off_centre(at_x, at_y, radius):
    touch = first_touch_m(Ball(radius), *DOME, np.array([at_x, at_y]))
    expected = math.sqrt((DOME_M + radius) ** 2 - at_x**2 - at_y**2) - DOME_M
    assert expected - FACET_DIP_M <= touch <= expected + 1e-12


def knife(angle: float, length_m: float = 4e-3) -> TriangleMesh:
    """A narrow prism whose sharp edge, at z = 0, looks down."""
    h, w, t = length_m / 2, 0.05e-3, 2e-3
    corners = np.array([[-h, 0, 0], [h, 0, 0], [-h, -w, t], [h, -w, t], [-h, w, t], [h, w, t]])
    c, s = math.cos(angle), math.sin(angle)
    faces = [[0, 1, 3], [0, 3, 2], [0, 5, 1], [0, 4, 5], [2, 3, 5], [2, 5, 4], [0, 2, 4], [1, 5, 3]]
    return TriangleMesh(corners @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]), np.array(faces))


@given(angle=st.floats(0, math.pi), x=st.floats(-0.9e-3, 0.9e-3), y=st.floats(-0.9e-3, 0.9e-3))
def test_sharp_edge_between_the_nodes_of_a_ridge(angle, x, y):
    """Edge against edge: neither has a corner near the point of first touch."""
    nodes, faces = grid_surface(np.array([[-1.0, 0.0, -1.0]] * 2) * 1e-3, 6e-3)
    touch = first_touch_m(knife(angle), nodes, faces, np.array([x, y]))
    # Height of the roof-shaped surface below the highest point of the knife's edge.
    reach = 2e-3 * abs(math.cos(angle))
    away = max(abs(x) - reach, 0.0)
    assert touch == pytest.approx(-1e-3 * away / 6e-3, abs=2e-5)


@given(
    heights=st.lists(st.floats(-1e-3, 1e-3), min_size=16, max_size=16),
    x=st.floats(-2.5e-3, 2.5e-3),
    y=st.floats(-2.5e-3, 2.5e-3),
    radius=st.floats(1e-4, 6e-3),
)
def test_ball_at_first_touch_is_one_radius_away(heights, x, y, radius):
    nodes, faces = grid_surface(np.array(heights).reshape(4, 4), 1e-3)
    touch = first_touch_m(Ball(radius), nodes, faces, np.array([x, y]))
    if touch == -np.inf:
        # Beside the surface: even as seen from above, every face is out of reach.
        flat = nodes * [1, 1, 0]
        assert point_triangle_distances(np.array([x, y, 0.0]), flat[faces]).min() > radius - 1e-9
        return
    distance = point_triangle_distances(np.array([x, y, touch]), nodes[faces]).min()
    assert distance == pytest.approx(radius, abs=1e-9)
    higher = point_triangle_distances(np.array([x, y, touch + 1e-5]), nodes[faces]).min()
    assert higher > radius


def barycentric(count: int) -> np.ndarray:
    i, j = np.meshgrid(np.arange(count + 1), np.arange(count + 1), indexing="ij")
    keep = i + j <= count
    return np.stack([i[keep], j[keep], count - i[keep] - j[keep]], axis=1) / count


@given(data=st.data())
def test_mesh_against_dense_sampling(data):
    """No sample of the surface lies above the indenter at first touch, and one nearly touches."""
    coordinate = st.floats(-1.0, 1.0)
    heights = data.draw(st.lists(coordinate, min_size=9, max_size=9))
    lowest = data.draw(st.tuples(st.floats(-0.2, 0.2), st.floats(-0.6, -0.2)))
    at = np.array(data.draw(st.tuples(coordinate, coordinate))) * 1e-3
    nodes, faces = grid_surface(np.array(heights).reshape(3, 3) * 0.5e-3, 1.5e-3)
    tip = np.array([[*lowest, 0.0], [-1, -1, 0.5], [1, -1, 0.5], [0, 1, 0.5]]) * 1e-3
    shape = TriangleMesh(tip, np.array([[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3]]))
    touch = first_touch_m(shape, nodes, faces, at)

    corners = shape.vertices_m[shape.faces[:3]] + [*at, touch]
    points = np.einsum("sw,fwi->fsi", barycentric(60), corners).reshape(-1, 3)
    inside = np.abs(points[:, :2]).max(axis=1) <= 1.5e-3
    points = points[inside]
    above = np.full(len(points), -np.inf)
    for a, b, c in nodes[faces]:
        weights = np.linalg.solve(
            np.array([[a[0], b[0], c[0]], [a[1], b[1], c[1]], [1, 1, 1]]),
            np.vstack([points[:, :2].T, np.ones(len(points))]),
        )
        over = (weights >= -1e-9).all(axis=0)
        above[over] = np.maximum(above[over], (np.array([a[2], b[2], c[2]]) @ weights)[over])
    gap = points[:, 2] - above
    assert gap.min() > -1e-9
    # Slopes are at most 1.5 and 1, and some sample lies within 0.03 mm of the touch.
    assert gap.min() < 2.5 * 0.03e-3


@pytest.mark.parametrize("text", ["sphere:1", "cylinder:1", "box:2x2"])
@pytest.mark.parametrize("at_mm", [(7.01, 0.0), (0.0, -7.01), (100.0, 100.0)])
def test_beside_the_surface(text, at_mm):
    nodes, faces = grid_surface(np.zeros((5, 5)), 3e-3)
    shape = parse_indenter(text).shape
    assert first_touch_m(shape, nodes, faces, np.array(at_mm) * 1e-3) == -np.inf
    assert first_touch_m(shape, nodes, faces, np.array([6.9e-3, 0.0])) > -1e-3
