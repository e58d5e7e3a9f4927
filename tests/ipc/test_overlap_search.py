# SPDX-License-Identifier: Apache-2.0
"""The device's search for overlapping starts against the referee in numpy."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.bodies.bodies import Surface
from taccel_lab.ipc.intersection import IntersectionKind, find_intersections
from taccel_lab.ipc.overlap_search import OverlapSearch
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
    TimeStepping,
    box_mesh,
    sphere_mesh,
)
from taccel_lab.state import State, initial_state
from tests.support.blocks import block_mesh, pose, scene

MESH = block_mesh((4, 4, 2), (4e-3, 4e-3, 2e-3), jitter=0.2)
SHAPES = {
    "ball": Ball(1e-3),
    "box": box_mesh((1e-3, 1e-3, 1e-3)),
    "large box": box_mesh((9e-3, 9e-3, 9e-3)),
    "sphere": sphere_mesh(0.3e-3, 1e-4),
}


def found(model: Model, state: State, mask: np.ndarray | None = None) -> list[bool]:
    """Environments that the search finds."""
    wanted = np.ones(model.env_count, dtype=bool) if mask is None else mask
    chosen = wp.array(wanted.astype(np.int32), dtype=wp.int32)
    return (OverlapSearch(model).find(state, chosen).numpy() != 0).tolist()


def wanted(model: Model, state: State) -> list[bool]:
    """The same by the referee."""
    return [
        any(item.kind is not IntersectionKind.INVERTED_TET for item in items)
        for items in find_intersections(model, state)
    ]


PLACES = st.tuples(*[st.floats(-2.5e-3, 2.5e-3)] * 2, st.floats(-2.5e-3, 1.5e-3))
TURNS = st.tuples(*[st.floats(-1, 1)] * 3, st.floats(0, 180))


@pytest.mark.parametrize("name", SHAPES)
@given(places=st.lists(PLACES, min_size=4, max_size=4), turn=TURNS)
@settings(max_examples=15, deadline=None)
def test_any_place_of_a_body_in_or_around_a_gel(
    name: str, places: list[tuple[float, float, float]], turn: tuple[float, float, float, float]
) -> None:
    axis = turn[:3] if np.linalg.norm(turn[:3]) > 0.1 else (0.0, 0.0, 1.0)
    poses = np.stack([pose(*place, axis, turn[3]) for place in places])[:, None]
    model = scene(MESH, KinematicBody(SHAPES[name]), env_count=len(poses)).finalize()
    state = initial_state(model, poses)
    assert found(model, state) == wanted(model, state)


@pytest.mark.parametrize(("name", "reach"), [("ball", 1e-3), ("box", 0.5e-3)])
def test_a_nanometre_decides(name: str, reach: float) -> None:
    poses = np.stack([pose(1e-4, 2e-4, reach + 1e-9), pose(1e-4, 2e-4, reach - 1e-9)])[:, None]
    model = scene(MESH, KinematicBody(SHAPES[name]), env_count=2).finalize()
    assert found(model, initial_state(model, poses)) == [False, True]


def test_a_body_that_is_inside_as_a_whole_and_one_around_all() -> None:
    for name in ("sphere", "ball", "large box"):
        small = Ball(0.3e-3) if name == "ball" else SHAPES[name]
        model = scene(MESH, KinematicBody(small), env_count=2).finalize()
        poses = np.stack([pose(1e-4, 0, -1e-3), pose(0, 0, 2e-2)])[:, None]
        assert found(model, initial_state(model, poses)) == [True, False], name


def cubes(env_count: int, present: tuple[int, ...] | None = None) -> Model:
    """Two free cubes, a plane and a gel, all of which may touch."""
    cube = box_mesh((2e-3, 2e-3, 2e-3))
    here = Surface(environments=present)
    bodies = [
        AffineBody(cube, name="first", initial_pose=pose(0, 0, 5e-3), surface=here),
        AffineBody(cube, name="second", initial_pose=pose(6e-3, 0, 5e-3)),
    ]
    gel = SoftBody(
        MESH, Material(1e5, 0.4), element=Element.LINEAR, initial_pose=pose(0, 0, 2.5e-3)
    )
    time = TimeStepping(quasi_static=False)
    return Scene(gel, (), env_count, time, affine_bodies=bodies, planes=[Plane()]).finalize()


def shifted(model: Model, state: State, env: int, name: str, way: np.ndarray) -> None:
    x = state.positions.numpy()
    x[env, model.bodies[model.body_id(name)].node_slice] += way
    state.positions.assign(x)


def test_stiff_bodies_and_planes() -> None:
    model = cubes(5)
    state = initial_state(model)
    shifted(model, state, 1, "second", np.array([-4.5e-3, 3e-4, 2e-4]))
    shifted(model, state, 2, "second", np.array([0, 0, -4.5e-3]))
    shifted(model, state, 3, "gel", np.array([0, 0, -1e-3]))
    assert found(model, state) == wanted(model, state) == [False, True, True, True, False]
    mask = np.array([True, False, True, False, True])
    assert found(model, state, mask) == [False, False, True, False, False]


def test_bodies_that_are_absent_and_places_that_are_not_finite() -> None:
    model = cubes(3, present=(1, 2))
    state = initial_state(model)
    for env in range(3):
        shifted(model, state, env, "second", np.array([-4.5e-3, 3e-4, 2e-4]))
    x = state.positions.numpy()
    x[2, 0] = np.nan
    state.positions.assign(x)
    assert found(model, state) == [False, True, False]


def test_a_surface_that_crosses_itself() -> None:
    gel = SoftBody(
        MESH,
        Material(1e5, 0.4),
        element=Element.LINEAR,
        self_contact=True,
    )
    model = Scene(gel, (), 2).finalize()
    state = initial_state(model)
    top = int(MESH.nodes_m[:, 2].argmax())
    x = state.positions.numpy()
    x[1, top, 2] -= 3e-3
    state.positions.assign(x)
    assert found(model, state) == wanted(model, state) == [False, True]


def test_a_curved_face_may_reach_into_a_ball_by_its_inset() -> None:
    gel = SoftBody(MESH, Material(1e5, 0.4), element=Element.QUADRATIC)
    heights = 1e-3 + np.linspace(-4e-5, 1e-6, 12)
    model = Scene(gel, KinematicBody(Ball(1e-3)), len(heights)).finalize()
    state = initial_state(model, np.stack([pose(2e-4, 3e-4, z) for z in heights])[:, None])
    expected = wanted(model, state)
    assert found(model, state) == expected
    assert any(expected) and not all(expected)
