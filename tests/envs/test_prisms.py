# SPDX-License-Identifier: Apache-2.0
"""Rollers, edges, gratings and pairs: closed, outward, of the right size, right way round."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.envs import parse_indenter
from taccel_lab.envs.prisms import edge_mesh
from taccel_lab.scene import TriangleMesh

sizes = st.floats(0.1, 10.0)


def mesh_of(text: str) -> TriangleMesh:
    shape = parse_indenter(text).shape
    assert isinstance(shape, TriangleMesh)
    return shape


def volume_mm3(mesh: TriangleMesh) -> float:
    a, b, c = (mesh.vertices_m[mesh.faces[:, k]] * 1e3 for k in range(3))
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6)


def assert_closed(mesh: TriangleMesh) -> None:
    """Each directed edge once, and its opposite once: closed, manifold, consistently wound."""
    edges = mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    directed = {tuple(edge) for edge in edges.tolist()}
    assert len(directed) == len(edges)
    assert all((b, a) in directed for a, b in directed)
    assert volume_mm3(mesh) > 0
    low, high = mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)
    assert (low + high)[:2] == pytest.approx(np.zeros(2), abs=1e-12)


@settings(max_examples=20)
@given(radius=sizes, length=sizes)
def test_roller(radius: float, length: float) -> None:
    mesh = mesh_of(f"roller:{radius!r}x{length!r}")
    assert_closed(mesh)
    assert volume_mm3(mesh) == pytest.approx(math.pi * radius**2 * length, rel=1e-3)
    assert np.ptp(mesh.vertices_m, axis=0) * 1e3 == pytest.approx(
        [2 * radius, length, 2 * radius], rel=1e-3
    )
    # A vertex lies at the very bottom, so that first touch is that of the true cylinder.
    assert mesh.vertices_m[:, 2].min() * 1e3 == pytest.approx(-radius, rel=1e-12)


@settings(max_examples=20)
@given(angle=st.floats(10, 170), length=sizes, radius=st.none() | st.floats(0.05, 0.2))
def test_edge(angle: float, length: float, radius: float | None) -> None:
    mesh = mesh_of(f"edge:{angle!r}x{length!r}" + (f"x{radius!r}" if radius else ""))
    assert_closed(mesh)
    assert np.ptp(mesh.vertices_m[:, 1]) * 1e3 == pytest.approx(length)
    section = np.unique(mesh.vertices_m[:, [0, 2]].round(12), axis=0) * 1e3
    top = section[section[:, 1] > section[:, 1].max() - 1e-9]
    right = section[section[:, 0] >= 0]
    right = right[np.argsort(right[:, 1])]
    flank = right[-1] - right[-2]
    assert math.degrees(math.atan2(flank[0], flank[1])) == pytest.approx(angle / 2, abs=1e-4)
    assert len(top) == 2
    # Convex, its lowest point on the axis.
    assert section[np.argmin(section[:, 1]), 0] == pytest.approx(0, abs=1e-9)


def test_a_rounded_edge_has_its_radius() -> None:
    mesh = edge_mesh(math.degrees(1.2), 5e-3, 0.1e-3)
    low = mesh.vertices_m[:, 2].min()
    tip = mesh.vertices_m[mesh.vertices_m[:, 2] < low + 0.03e-3]
    reach = np.hypot(tip[:, 0], tip[:, 2] - low - 0.1e-3)
    assert len(tip) > 6
    assert reach == pytest.approx(np.full(len(tip), 0.1e-3), rel=1e-6)


@settings(max_examples=20)
@given(pitch=st.floats(0.1, 3.0), ridges=st.integers(2, 12), length=sizes)
def test_grating(pitch: float, ridges: int, length: float) -> None:
    mesh = mesh_of(f"grating:{pitch!r}x{ridges}x{length!r}")
    assert_closed(mesh)
    vertices = mesh.vertices_m * 1e3
    low = vertices[:, 2].min()
    x = np.unique(vertices[vertices[:, 2] < low + 1e-9, 0].round(9))
    assert len(x) == 2 * ridges
    assert x[1::2] - x[::2] == pytest.approx(np.full(ridges, pitch / 2), abs=1e-8)
    assert np.diff(x[::2]) == pytest.approx(np.full(ridges - 1, pitch), abs=1e-8)
    plate = max(pitch, 1.0) * (ridges - 0.5) * pitch * length
    assert volume_mm3(mesh) == pytest.approx(plate + ridges * pitch**2 / 2 * length, rel=1e-9)


@settings(max_examples=20)
@given(radius=sizes, gap=sizes)
def test_pair(radius: float, gap: float) -> None:
    mesh = mesh_of(f"pair:{radius!r}x{gap!r}")
    assert_closed(mesh)
    vertices = mesh.vertices_m * 1e3
    right = vertices[vertices[:, 0] > 0]
    assert right[:, 0].min() == pytest.approx(gap / 2, rel=1e-6)
    tip = right[np.argmin(right[:, 2])]
    assert tip[:2] == pytest.approx([radius + gap / 2, 0.0], abs=1e-9)
    # The lower part is half of a sphere.
    centre = tip + [0, 0, radius]
    below = right[right[:, 2] < centre[2]]
    assert np.linalg.norm(below - centre, axis=1) == pytest.approx(
        np.full(len(below), radius), rel=1e-9
    )
