# SPDX-License-Identifier: Apache-2.0
"""Scenes and starts: what cannot be solved is refused with bodies, ids and environment."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.benchmarks.stress.gaps import SurfacePairs, edge_edge_distances
from taccel_lab.bodies.crossings import point_triangle_distances
from taccel_lab.errors import InputError
from taccel_lab.geometry import TetMesh
from taccel_lab.geometry.block import block_mesh
from taccel_lab.ipc.contact.overlap_search import find_overlaps
from taccel_lab.model import Model
from taccel_lab.scene import (
    AffineBody,
    Ball,
    Element,
    KinematicBody,
    Material,
    Plane,
    Scene,
    SoftBody,
    Surface,
    TimeStepping,
    TriangleMesh,
    box_mesh,
)
from taccel_lab.scene.scene import check_scene
from taccel_lab.state import State, initial_state
from tests.support.blocks import everywhere, pose

GEL = SoftBody(
    block_mesh((3, 3, 2), (3e-3, 3e-3, 2e-3), jitter=0.2),
    Material(1e5, 0.45),
    element=Element.LINEAR,
)
DYNAMIC = TimeStepping(quasi_static=False)


def box_at(z: float, name: str, side: float = 1e-3, **surface: float) -> AffineBody:
    return AffineBody(
        box_mesh((side, side, side)),
        name=name,
        initial_pose=pose(0, 0, z, (1, 2, 3), 20.0),
        surface=Surface(**surface),  # pyright: ignore[reportArgumentType]
    )


def started(*bodies: AffineBody, env_count: int = 1, ball_z: float = 9e-3) -> tuple[Model, State]:
    scene = Scene(
        GEL,
        KinematicBody(Ball(1e-3), name="ball"),
        env_count,
        DYNAMIC,
        affine_bodies=bodies,
        planes=Plane(point_m=(0, 0, -8e-3), name="floor"),
    )
    model = scene.finalize()
    return model, initial_state(model, everywhere(env_count, pose(0, 0, ball_z)))


def test_good_scenes_pass() -> None:
    model, state = started(box_at(2e-3, "cube"), box_at(4e-3, "lid"))
    check_scene(model.scene)
    present = np.ones(len(model.bodies), dtype=bool)
    gaps = SurfacePairs(model).nearer_than(state.positions.numpy()[0], present, 1e-7).gaps_m
    assert not find_overlaps(model, state)[0] and not len(gaps)


def test_each_body_is_checked_and_named() -> None:
    good = box_mesh((1e-3, 1e-3, 1e-3))
    flipped = good.faces.copy()
    flipped[2] = flipped[2, ::-1]
    pin = KinematicBody(TriangleMesh(good.vertices_m, flipped), name="pin")
    with pytest.raises(InputError, match=r"body 1 \('pin'\): neighbouring faces.*differently"):
        check_scene(Scene(GEL, pin))
    lost = TriangleMesh(np.vstack([good.vertices_m, [0, 0, 1]]), good.faces)
    with pytest.raises(InputError, match=r"body 1 \('pin'\): 1 vertices belong to no face"):
        check_scene(Scene(GEL, KinematicBody(lost, name="pin")))
    mesh = GEL.mesh
    big = TetMesh(mesh.nodes_m * 1e4, mesh.tets, mesh.faces, mesh.face_regions)
    with pytest.raises(InputError, match=r"body 0 \('gel'\) is 30 m across.*millimetres"):
        check_scene(Scene(SoftBody(big, GEL.material, element=Element.LINEAR)))
    sheet = KinematicBody(TriangleMesh(good.vertices_m, good.faces[2:]), name="sheet")
    check_scene(Scene(GEL, sheet))


def test_thickness_and_planes() -> None:
    model, state = started(box_at(2e-3, "cube", thickness_m=1e-4))
    floor = 8e-3 - 2e-3
    gaps = SurfacePairs(model).nearer_than(
        state.positions.numpy()[0], np.ones(4, dtype=bool), floor + 1e-4
    )
    plane = gaps.kinds == 2
    x = state.positions.numpy()[0]
    low = x[: model.soft_count, 2].min() + 8e-3
    assert gaps.gaps_m[plane].min() == pytest.approx(low, rel=1e-12)
    assert "plane node" in gaps.where(int(np.flatnonzero(plane)[0]))
    cube = gaps.gaps_m[(gaps.bodies == [0, 1]).all(axis=1) | (gaps.bodies == [1, 0]).all(axis=1)]
    vertices = x[model.bodies[1].node_slice]
    assert cube.min() == pytest.approx(vertices[:, 2].min() - 1e-4, rel=1e-9)


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
    np.testing.assert_allclose(edge_edge_distances(a, b), expected, rtol=1e-7)
