# SPDX-License-Identifier: Apache-2.0
"""Bisection keeps the shape, the labels and the angles, and ends where the size is met."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.cad.mesh.quality_measures import dihedral_angles_deg
from taccel_lab.errors import InputError
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.geometry.bisection import bisected
from taccel_lab.geometry.block import block_mesh


def shaken(seed: int) -> TetMesh:
    """A block whose inner nodes are somewhere else, in two layers."""
    mesh = block_mesh((4, 3, 3), (4e-3, 3e-3, 3e-3))
    inner = np.setdiff1d(np.arange(mesh.node_count), np.unique(mesh.faces))
    nodes = mesh.nodes_m.copy()
    nodes[inner] += np.random.default_rng(seed).uniform(-1e-4, 1e-4, (len(inner), 3))
    layers = (nodes[mesh.tets].mean(axis=1)[:, 2] > -1e-3).astype(np.int32)
    return TetMesh(nodes, mesh.tets, mesh.faces, mesh.face_regions, layers)


def area_m2(mesh: TetMesh, region: Region) -> float:
    a, b, c = mesh.nodes_m[mesh.region_faces(region)].swapaxes(0, 1)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


@settings(max_examples=15)
@given(
    seed=st.integers(0, 9),
    place=st.tuples(*[st.floats(-2e-3, 2e-3)] * 2),
    size=st.floats(1.5e-4, 5e-4),
)
def test_a_finer_mesh_is_the_same_body(seed: int, place: tuple[float, float], size: float) -> None:
    mesh = shaken(seed)

    def sizes(points: np.ndarray) -> np.ndarray:
        return size + 0.6 * np.linalg.norm(points - (*place, 0.0), axis=1)

    fine = bisected(mesh, sizes)
    # Every face lies between two tets or on the surface: no hanging nodes.
    corners = np.sort(fine.tets[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]], axis=-1)
    faces, uses = np.unique(corners.reshape(-1, 3), axis=0, return_counts=True)
    assert uses.max() == 2
    surface = np.sort(fine.faces, axis=1)
    assert {tuple(f) for f in faces[uses == 1]} == {tuple(f) for f in surface}
    assert np.isclose(fine.volumes_m3().sum(), mesh.volumes_m3().sum(), rtol=1e-12)
    for region in Region:
        assert np.isclose(area_m2(fine, region), area_m2(mesh, region), rtol=1e-12)
    for layer in (0, 1):
        before, after = (m.volumes_m3()[m.tet_layers == layer].sum() for m in (mesh, fine))
        assert np.isclose(after, before, rtol=1e-12)
    ends = fine.nodes_m[fine.tets[:, [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]]]
    longest = np.linalg.norm(ends[:, :, 0] - ends[:, :, 1], axis=-1).max(axis=1)
    assert (longest <= sizes(fine.nodes_m[fine.tets].mean(axis=1))).all()
    # Rivara: not below half of the smallest angle; in practice a third of what was there.
    least = [dihedral_angles_deg(m.nodes_m, m.tets).min() for m in (mesh, fine)]
    assert least[1] > 0.3 * least[0]


def test_what_is_fine_enough_stays() -> None:
    mesh = shaken(1)
    same = bisected(mesh, lambda points: np.full(len(points), 1.0))
    assert np.array_equal(same.nodes_m, mesh.nodes_m)
    assert np.array_equal(same.tets, mesh.tets)


def test_sizes_that_would_take_millions_are_refused() -> None:
    with pytest.raises(InputError, match="more than 1,000 tets"):
        bisected(shaken(1), lambda points: np.full(len(points), 1e-5), most_tets=1000)
