# SPDX-License-Identifier: Apache-2.0
"""Which edges of a triangle mesh are facets of a curve and which are the object's."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from taccel_lab.bodies.primitives import box_mesh, cylinder_mesh, sphere_mesh
from taccel_lab.geometry.shading_normals import corner_normals, split_at_creases
from taccel_lab.presses import parse_indenter


def _tool(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corners of the faces of a tool, their flat normals and those that shading takes."""
    return _shaded(parse_indenter(name).shape)


def _shaded(mesh: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    vertices, faces = mesh.vertices_m, mesh.faces
    return vertices[faces], _flat(vertices, faces), corner_normals(vertices, faces)


def _degrees(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    cosine = (one * other).sum(axis=-1)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def _flat(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    a, b, c = np.moveaxis(vertices[triangles], 1, 0)
    normal = np.cross(b - a, c - a)
    return (normal / np.linalg.norm(normal, axis=1, keepdims=True))[:, None]


def test_a_faceted_ball_is_round():
    corners, flat, normals = _shaded(sphere_mesh(3e-3, 0.5e-3))
    radial = corners / np.linalg.norm(corners, axis=-1, keepdims=True)
    assert _degrees(flat, radial).max() > 3
    assert _degrees(normals, radial).max() < 1


@pytest.mark.parametrize("name", ["edge:84x6", "edge:160x6", "grating:1x4x6"])
def test_flanks_stay_flat(name):
    """Also those of an edge as blunt as 160 degrees: its flanks are no chords of a curve."""
    _, flat, normals = _tool(name)
    assert _degrees(flat, normals).max() < 1e-3


def test_a_cylinder_is_round_and_its_ends_are_flat():
    corners, flat, normals = _shaded(cylinder_mesh(2e-3, 4e-3))
    ends = np.abs(flat[:, 0, 2]) > 0.9
    assert _degrees(flat[ends], normals[ends]).max() < 1e-3
    around = corners[~ends][..., :2]
    radial = around / np.linalg.norm(around, axis=-1, keepdims=True)
    assert _degrees(normals[~ends][..., :2], radial).max() < 0.5
    assert np.abs(normals[~ends][..., 2]).max() < 1e-6


def test_a_flat_side_beside_a_fillet_stays_flat():
    """Flanks 4 mm long run into a tip of 12 facets, 0.1 mm in radius."""
    corners, flat, normals = _tool("edge:90x6x0.1")
    a, b, c = np.moveaxis(corners, 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    flanks = (np.abs(np.abs(flat[:, 0, 0]) - np.sqrt(0.5)) < 1e-3) & (area > 1e-6)
    assert flanks.sum() == 4
    assert _degrees(flat[flanks], normals[flanks]).max() < 0.1
    # The facets of the tip themselves turn into each other.
    tip = (area < 1e-6) & (np.abs(flat[:, 0, 1]) < 1e-6) & (flat[:, 0, 2] < 0)
    assert _degrees(flat[tip], normals[tip]).max() > 2


def test_triangles_that_turn_against_each_other_still_meet():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.05]]) * 1e-3
    normals = corner_normals(points, np.array([[0, 1, 2], [1, 3, 2]]))
    assert np.allclose(normals[0, 1], normals[1, 0]) and np.allclose(normals[0, 2], normals[1, 2])
    assert np.allclose(normals[0, 0], [0, 0, 1])


def test_a_box_is_split_at_its_edges_and_a_ball_nowhere():
    box = box_mesh((1e-2, 2e-2, 3e-2))
    copied, faces = split_at_creases(box.vertices_m, box.faces)
    assert len(copied) == 24
    # Renderers average at vertices: on a split box that average is the flat normal.
    np.testing.assert_array_equal(copied[faces], box.faces)
    flat = _flat(box.vertices_m, box.faces)[:, 0]
    for vertex in range(24):
        around = flat[(faces == vertex).any(axis=1)]
        assert _degrees(around, around[:1]).max() < 1e-5
    ball = sphere_mesh(3e-3, 0.5e-3)
    assert len(split_at_creases(ball.vertices_m, ball.faces)[0]) == len(ball.vertices_m)
