# SPDX-License-Identifier: Apache-2.0
"""Scenes and starts: what cannot be solved is refused with bodies, ids and environment."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.benchmarks.stress.gaps import SurfacePairs, closest_on_edges
from taccel_lab.bodies.crossings import point_triangle_distances
from taccel_lab.errors import InputError
from taccel_lab.geometry import TetMesh
from taccel_lab.geometry.block import block_mesh
from taccel_lab.ipc.contact.overlap_search import find_overlaps
from taccel_lab.scene import (
    AffineBody,
    Ball,
    KinematicBody,
    Material,
    Plane,
    Scene,
    Surface,
    TriangleMesh,
    box_mesh,
)
from taccel_lab.scene.scene import check_scene
from tests.support.blocks import pose
from tests.support.scene_steps import Stepped, in_time, linear

CUBE = box_mesh((1e-3, 1e-3, 1e-3))
GEL = linear(block_mesh((3, 3, 2), (3e-3, 3e-3, 2e-3), jitter=0.2), Material(1e5, 0.45))


def box_at(z: float, name: str, **surface: Any) -> AffineBody:
    place = pose(0, 0, z, (1, 2, 3), 20.0)
    return AffineBody(CUBE, name=name, initial_pose=place, surface=Surface(**surface))


def started(*bodies: AffineBody) -> Stepped:
    ball, floor = KinematicBody(Ball(1e-3), name="ball"), Plane((0, 0, -8e-3), name="floor")
    time = in_time(1e-2, 0.0)
    scene = Scene(GEL, ball, time=time, affine_bodies=bodies, planes=floor)
    return Stepped(scene, pose(0, 0, 9e-3))


def test_good_scenes_pass() -> None:
    run = started(box_at(2e-3, "cube"), box_at(4e-3, "lid"))
    check_scene(run.model.scene)
    present = np.ones(len(run.model.bodies), dtype=bool)
    gaps = SurfacePairs(run.model).nearer_than(run.x(), present, 1e-7).gaps_m
    assert not find_overlaps(run.model, run.state)[0] and not len(gaps)


def with_pin(shape: TriangleMesh) -> Scene:
    return Scene(GEL, KinematicBody(shape, name="pin"))


def test_each_body_is_checked_and_named() -> None:
    flipped, mesh = CUBE.faces.copy(), GEL.mesh
    flipped[2] = flipped[2, ::-1]
    turned = TriangleMesh(CUBE.vertices_m, flipped)
    lost = TriangleMesh(np.vstack([CUBE.vertices_m, [0, 0, 1]]), CUBE.faces)
    big = TetMesh(mesh.nodes_m * 1e4, mesh.tets, mesh.faces, mesh.face_regions)
    for scene, words in (
        (with_pin(turned), r"body 1 \('pin'\): neighbouring faces.*differently"),
        (with_pin(lost), r"body 1 \('pin'\): 1 vertices belong to no face"),
        (Scene(linear(big)), r"body 0 \('gel'\) is 30 m across.*millimetres"),
    ):
        with pytest.raises(InputError, match=words):
            check_scene(scene)
    check_scene(with_pin(TriangleMesh(CUBE.vertices_m, CUBE.faces[2:])))


def test_thickness_and_planes() -> None:
    run = started(box_at(2e-3, "cube", thickness_m=1e-4))
    gaps = SurfacePairs(run.model).nearer_than(run.x(), np.ones(4, dtype=bool), 6e-3 + 1e-4)
    plane = gaps.kinds == 2
    low = run.x(0)[:, 2].min() + 8e-3
    assert gaps.gaps_m[plane].min() == pytest.approx(low, rel=1e-12)
    assert "plane node" in gaps.where(int(np.flatnonzero(plane)[0]))
    cube = gaps.gaps_m[(np.sort(gaps.bodies, axis=1) == [0, 1]).all(axis=1)]
    assert cube.min() == pytest.approx(run.x(1)[:, 2].min() - 1e-4, rel=1e-9)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_distances_agree_with_ipctk(seed: int) -> None:
    import ipctk

    rng = np.random.default_rng(seed)
    points, triangles = rng.normal(size=(20, 3)), rng.normal(size=(20, 3, 3))
    expected = [
        ipctk.point_triangle_distance(p, *t) ** 0.5 for p, t in zip(points, triangles, strict=True)
    ]
    np.testing.assert_allclose(point_triangle_distances(points, triangles), expected, rtol=1e-9)
    a, b = rng.normal(size=(20, 2, 3)), rng.normal(size=(20, 2, 3))
    b[::4] = a[::4] + rng.normal(size=(5, 1, 3))
    expected = [ipctk.edge_edge_distance(*p, *q) ** 0.5 for p, q in zip(a, b, strict=True)]
    np.testing.assert_allclose(closest_on_edges(a, b)[2], expected, rtol=1e-7)
