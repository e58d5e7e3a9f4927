# SPDX-License-Identifier: Apache-2.0
"""The referee of intersections against bodies placed where the answer is known."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.errors import InputError
from taccel_lab.ipc.intersection import (
    Intersection,
    IntersectionKind,
    find_intersections,
    point_face_distances,
    require_separated,
)
from taccel_lab.scene import Ball, KinematicBody, TriangleMesh, box_mesh, sphere_mesh
from taccel_lab.state import initial_state
from tests.verification.blocks import block_mesh, bumpy_body, everywhere, pose, scene

MESH = block_mesh((4, 4, 2), (4e-3, 4e-3, 2e-3), jitter=0.2)


def intersections(shape: TriangleMesh | Ball, *poses: np.ndarray) -> list[list[Intersection]]:
    """Overlaps of one body in as many environments as there are poses."""
    model = scene(MESH, KinematicBody(shape), env_count=len(poses)).finalize()
    return find_intersections(model, initial_state(model, np.stack(poses)[:, None]))


def kinds(found: list[Intersection]) -> list[IntersectionKind]:
    return [item.kind for item in found]


@pytest.mark.parametrize(
    ("shape", "reach"),
    [
        (Ball(1e-3), 1e-3),
        (box_mesh((1e-3, 1e-3, 1e-3)), 0.5e-3),
        (box_mesh((9e-3, 9e-3, 1e-3)), 0.5e-3),
    ],
)
def test_a_body_just_above_and_just_below_the_surface(
    shape: TriangleMesh | Ball, reach: float
) -> None:
    above, below = intersections(
        shape, pose(1e-4, 2e-4, reach + 1e-9), pose(1e-4, 2e-4, reach - 1e-9)
    )
    assert above == []
    assert kinds(below) == [IntersectionKind.CROSSING]
    assert below[0].body == "indenter" and below[0].count > 0
    assert np.abs(below[0].point_m[:2]).max() < 5e-3


def test_bodies_that_do_not_cross_but_contain() -> None:
    (swallowed,) = intersections(sphere_mesh(0.3e-3, 1e-4), pose(1e-4, 0, -1e-3))
    assert kinds(swallowed) == [IntersectionKind.BODY_INSIDE_GEL]
    (ball,) = intersections(Ball(0.3e-3), pose(1e-4, 0, -1e-3))
    assert kinds(ball) == [IntersectionKind.BODY_INSIDE_GEL]
    (around,) = intersections(box_mesh((9e-3, 9e-3, 9e-3)), pose(0, 0, -1e-3, (1, 0, 0), 20))
    assert kinds(around) == [IntersectionKind.GEL_INSIDE_BODY]
    (hollow,) = intersections(Ball(9e-3), pose(0, 0, -1e-3))
    assert kinds(hollow) == [IntersectionKind.CROSSING]


def test_a_needle_between_the_nodes_is_seen() -> None:
    needle = TriangleMesh(
        np.array([[0, 0, -1e-4], [1e-6, 0, 1e-3], [-1e-6, 1e-6, 1e-3], [0, -1e-6, 1e-3]]),
        np.array([[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3]]),
    )
    (found,) = intersections(needle, pose(3.1e-4, 2.7e-4, 0))
    assert kinds(found) == [IntersectionKind.CROSSING]


def test_inverted_tets_are_found() -> None:
    model = scene(MESH, KinematicBody(Ball(1e-3)), env_count=2).finalize()
    state = initial_state(model, everywhere(2, pose(0, 0, 5e-3)))
    x = state.positions.numpy()
    x[1, 62] -= [0, 0, 1.5e-3]
    state.positions.assign(x)
    first, second = find_intersections(model, state)
    assert first == []
    assert kinds(second) == [IntersectionKind.INVERTED_TET]
    with pytest.raises(InputError, match="inverted in environment 1"):
        require_separated(model, state)


@settings(max_examples=30)
@given(
    seed=st.integers(0, 1000),
    x=st.floats(-2e-3, 2e-3),
    z=st.floats(-1e-3, 3e-3),
    angle=st.floats(0, 180),
)
def test_crossings_agree_with_ipctk(seed: int, x: float, z: float, angle: float) -> None:
    import ipctk

    body = bumpy_body(seed, 1e-3, 0.5)
    placed = pose(x, 0.3e-3, z, (1, -2, 3), angle)
    model = scene(MESH, KinematicBody(body)).finalize()
    state = initial_state(model, placed[None, None])
    (found,) = find_intersections(model, state)
    both = np.concatenate([MESH.faces, body.faces + model.soft_count])
    collision_mesh = ipctk.CollisionMesh(state.positions.numpy()[0], ipctk.edges(both), both)
    expected = ipctk.has_intersections(collision_mesh, state.positions.numpy()[0])
    assert (IntersectionKind.CROSSING in kinds(found)) == expected


def test_distances_of_a_point_from_triangles_agree_with_ipctk() -> None:
    import ipctk

    rng = np.random.default_rng(0)
    point, triangles = rng.normal(size=3), rng.normal(size=(500, 3, 3))
    expected = [ipctk.point_triangle_distance(point, *t) ** 0.5 for t in triangles]
    np.testing.assert_allclose(point_face_distances(point, triangles), expected, rtol=1e-9)


@pytest.mark.parametrize("shape", [Ball(1e-3), box_mesh((2e-3, 2e-3, 2e-3))])
def test_a_bad_start_is_refused_with_its_place(shape: TriangleMesh | Ball) -> None:
    model = scene(MESH, KinematicBody(shape, name="pin"), env_count=2).finalize()
    good, bad = pose(0, 0, 1.1e-3), pose(1e-3, 0, 0.9e-3)
    require_separated(model, initial_state(model, np.stack([good, good])[:, None]))
    state = initial_state(model, np.stack([good, bad])[:, None])
    with pytest.raises(InputError, match=r"'pin' starts inside the gel in environment 1.*gap"):
        require_separated(model, state)


def test_a_thousand_gel_faces_against_five_thousand_in_a_second() -> None:
    mesh = block_mesh((22, 22, 2), (8e-3, 8e-3, 3e-3))
    body = sphere_mesh(2e-3, 1.2e-4)
    assert len(mesh.faces) > 1000 and len(body.faces) > 5000
    model = scene(mesh, KinematicBody(body), env_count=4).finalize()
    state = initial_state(model, everywhere(4, pose(0, 0, 2.005e-3)))
    started = time.perf_counter()
    assert find_intersections(model, state) == [[]] * 4
    assert time.perf_counter() - started < 4
