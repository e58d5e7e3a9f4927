# SPDX-License-Identifier: Apache-2.0
"""Sections against the closed form of a box cut by a plane."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.geometry import QuadraticMesh, TetMesh
from taccel_lab.geometry.block import block_mesh
from taccel_lab.geometry.tet_mesh import tet_volumes
from taccel_lab.scene import Element, Material, SoftBody
from taccel_lab.viewer.section import Surface, clip_faces, cut_tets, linear_tets

SIZE = np.array([0.03, 0.02, 0.01])
component = st.floats(0.05, 1.0).flatmap(lambda v: st.sampled_from([v, -v]))


def section_area(normal: np.ndarray, offset: float, size: np.ndarray) -> float:
    """Area of the plane ``normal . x = offset`` in the box [0, size], no component of ``normal``
    being 0: the derivative of the volume below it, by inclusion and exclusion of its corners."""
    flipped = np.where(normal < 0, size, 0.0)
    n, c = np.abs(normal), offset - float(normal @ flipped)
    total = 0.0
    for corner in itertools.product((0, 1), repeat=3):
        reach = max(c - float((n * size) @ np.array(corner)), 0.0)
        total += (-1) ** sum(corner) * reach**2
    return float(np.linalg.norm(n) * total / (2 * n.prod()))


def vector_area(surface: Surface) -> np.ndarray:
    a, b, c = (surface.points[surface.faces[:, i]] for i in range(3))
    return np.cross(b - a, c - a).sum(axis=0) / 2


@given(
    normal=st.tuples(component, component, component),
    share=st.floats(0.02, 0.98),
    jitter=st.floats(0.0, 0.3),
)
def test_the_section_of_a_box_has_its_area(
    normal: tuple[float, float, float], share: float, jitter: float
) -> None:
    mesh = block_mesh((4, 3, 2), (SIZE[0], SIZE[1], SIZE[2]), jitter, seed=1)
    nodes = mesh.nodes_m - mesh.nodes_m.min(axis=0)
    n = np.array(normal)
    along = nodes @ n
    offset = along.min() + share * np.ptp(along)
    point = n * offset / (n @ n)
    values = nodes @ [1.0, 2.0, 3.0] + 4
    cut = cut_tets(nodes, mesh.tets, values, point, n)
    assert cut.area() == pytest.approx(section_area(n, offset, SIZE), rel=1e-9, abs=1e-15)
    # On the plane, facing what is taken away, with the field's own values.
    assert np.abs(cut.points @ n - offset).max() < 1e-12
    assert vector_area(cut) @ n == pytest.approx(cut.area() * np.linalg.norm(n), rel=1e-9)
    np.testing.assert_allclose(cut.values, cut.points @ [1.0, 2.0, 3.0] + 4, rtol=1e-12)
    # With what is left of the skin it closes.
    skin = clip_faces(nodes, mesh.faces.astype(np.int64), values, point, n)
    np.testing.assert_allclose(vector_area(skin) + vector_area(cut), 0, atol=1e-16)
    assert (skin.points @ n).max() <= offset + 1e-12


def test_a_plane_beside_the_box_cuts_nothing_and_takes_all_or_nothing() -> None:
    mesh = block_mesh((2, 2, 2), (1.0, 1.0, 1.0))
    nodes, values = mesh.nodes_m, mesh.nodes_m[:, 2]
    up, faces = np.array([0.0, 0.0, 1.0]), mesh.faces.astype(np.int64)
    above, below = np.array([0.0, 0.0, 5.0]), np.array([0.0, 0.0, -5.0])
    for point in (above, below):
        assert len(cut_tets(nodes, mesh.tets, values, point, up).faces) == 0
    assert clip_faces(nodes, faces, values, above, up).area() == pytest.approx(6.0)
    assert len(clip_faces(nodes, faces, values, below, up).faces) == 0


def test_ten_node_tets_fall_into_eight_of_the_same_volume() -> None:
    mesh = block_mesh((2, 2, 1), (1.0, 1.0, 0.5), jitter=0.2, seed=3)
    body = SoftBody(mesh, Material(1e5, 0.45), element=Element.QUADRATIC)
    whole: TetMesh | QuadraticMesh = body.nodal_mesh
    parts = linear_tets(whole.tets)
    volumes = tet_volumes(whole.nodes_m, parts)
    assert len(parts) == 8 * len(whole.tets)
    assert (volumes > 0).all()
    assert volumes.sum() == pytest.approx(0.5, rel=1e-12)
