# SPDX-License-Identifier: Apache-2.0
"""Overlaps told by name, and those that the device finds: against known places and ipctk."""

from __future__ import annotations

from dataclasses import replace

import ipctk
import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.errors import InputError
from taccel_lab.ipc.contact.overlap_search import OverlapSearch, require_separated
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
    sphere_mesh,
)
from taccel_lab.state import State, initial_state
from tests.support.blocks import block_mesh, bumpy_body, everywhere, pose, scene
from tests.support.intersection import Intersection, IntersectionKind, find_intersections
from tests.verification.curved_tets import CURVED, curved

MESH = block_mesh((4, 4, 2), (4e-3, 4e-3, 2e-3), jitter=0.2)
SOFT = Material(1e5, 0.4, 1000.0)
FREE = np.zeros(0, dtype=np.int64)
DYNAMIC = TimeStepping(quasi_static=False)
CROSSING, INSIDE = IntersectionKind.CROSSING, IntersectionKind.INSIDE
INVERTED = IntersectionKind.INVERTED_TET
SHAPES = {
    "ball": Ball(1e-3),
    "box": box_mesh((1e-3, 1e-3, 1e-3)),
    "large box": box_mesh((9e-3, 9e-3, 9e-3)),
    "sphere": sphere_mesh(0.3e-3, 1e-4),
}


def named(found: list) -> set[tuple[str, str, str]]:
    return {(item.kind.value, item.first, item.second) for item in found if item.kind != INVERTED}


def kinds(found: list[Intersection]) -> list[IntersectionKind]:
    return [item.kind for item in found]


def seen(model: Model, state: State, mask: np.ndarray | None = None) -> list[list[Intersection]]:
    """Overlaps by the referee; the device names the same, but inverted tets, where asked."""
    found = find_intersections(model, state)
    wanted = np.ones(model.env_count, dtype=bool) if mask is None else mask
    search = OverlapSearch(model)
    mask = wp.array(wanted.astype(np.int32), dtype=wp.int32)
    search.mark(state.positions, mask)
    overlapping = mask.numpy() != 0
    for env, told in enumerate(search.describe(state)):
        expected = named(found[env]) if wanted[env] else set()
        assert named(told) == expected and overlapping[env] == bool(expected)
    return found


def intersections(shape: TriangleMesh | Ball, *poses: np.ndarray) -> list[list[Intersection]]:
    model = scene(MESH, KinematicBody(shape), env_count=len(poses)).finalize()
    return seen(model, initial_state(model, np.stack(poses)[:, None]))


def moved(state: State, node: int, by: tuple[float, float, float], env: int = 0) -> State:
    x = state.positions.numpy()
    x[env, node] += by
    state.positions.assign(x)
    return state


PLACES = st.tuples(*[st.floats(-2.5e-3, 2.5e-3)] * 2, st.floats(-2.5e-3, 1.5e-3))
TURNS = st.tuples(*[st.floats(-1, 1)] * 3, st.floats(0, 180))


@pytest.mark.thorough(cases=("large box", "sphere"))
@pytest.mark.parametrize("name", SHAPES)
@given(places=st.lists(PLACES, min_size=4, max_size=4), turn=TURNS)
@settings(max_examples=15, deadline=None)
def test_any_place_of_a_body_in_or_around_a_gel(
    name: str, places: list[tuple[float, float, float]], turn: tuple[float, float, float, float]
) -> None:
    axis = turn[:3] if np.linalg.norm(turn[:3]) > 0.1 else (0.0, 0.0, 1.0)
    intersections(SHAPES[name], *(pose(*place, axis, turn[3]) for place in places))


@pytest.mark.parametrize(
    ("shape", "reach"),
    [(SHAPES["ball"], 1e-3), (SHAPES["box"], 0.5e-3), (box_mesh((9e-3, 9e-3, 1e-3)), 0.5e-3)],
)
def test_a_body_just_above_and_just_below_the_surface(
    shape: TriangleMesh | Ball, reach: float
) -> None:
    heights = (reach + 1e-9, reach - 1e-9)
    above, below = intersections(shape, *(pose(1e-4, 2e-4, z) for z in heights))
    assert above == [] and below == [Intersection(CROSSING, "indenter", "gel")]


NEEDLE = TriangleMesh(
    np.array([[0, 0, -1e-4], [1e-6, 0, 1e-3], [-1e-6, 1e-6, 1e-3], [0, -1e-6, 1e-3]]),
    np.array([[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3]]),
)


@pytest.mark.parametrize(
    ("shape", "place", "kind"),
    [
        (SHAPES["sphere"], pose(1e-4, 0, -1e-3), INSIDE),
        (Ball(0.3e-3), pose(1e-4, 0, -1e-3), INSIDE),
        (SHAPES["large box"], pose(0, 0, -1e-3, (1, 0, 0), 20), INSIDE),
        (Ball(9e-3), pose(0, 0, -1e-3), CROSSING),
        (NEEDLE, pose(3.1e-4, 2.7e-4, 0), CROSSING),
    ],
)
def test_bodies_that_contain_one_another_and_a_needle(
    shape: TriangleMesh | Ball, place: np.ndarray, kind: IntersectionKind
) -> None:
    assert kinds(intersections(shape, place)[0]) == [kind]


@pytest.mark.thorough
@settings(max_examples=30)
@given(
    seed=st.integers(0, 1000),
    x=st.floats(-2e-3, 2e-3),
    z=st.floats(-1e-3, 3e-3),
    angle=st.floats(0, 180),
)
def test_crossings_agree_with_ipctk(seed: int, x: float, z: float, angle: float) -> None:
    body = bumpy_body(seed, 1e-3, 0.5)
    model = scene(MESH, KinematicBody(body)).finalize()
    state = initial_state(model, pose(x, 0.3e-3, z, (1, -2, 3), angle)[None, None])
    (found,) = seen(model, state)
    both, nodes = np.concatenate([MESH.faces, body.faces + model.soft_count]), state.positions
    collision_mesh = ipctk.CollisionMesh(nodes.numpy()[0], ipctk.edges(both), both)
    assert (CROSSING in kinds(found)) == ipctk.has_intersections(collision_mesh, nodes.numpy()[0])


@pytest.mark.parametrize("shape", [SHAPES["ball"], box_mesh((2e-3, 2e-3, 2e-3))])
def test_a_bad_start_is_refused_with_its_place(shape: TriangleMesh | Ball) -> None:
    model = scene(MESH, KinematicBody(shape, name="pin"), env_count=2).finalize()
    good, bad = pose(0, 0, 1.1e-3), pose(1e-3, 0, 0.9e-3)
    require_separated(model, initial_state(model, np.stack([good, good])[:, None]))
    with pytest.raises(InputError, match=r"'pin' starts inside 'gel' in environment 1.*gap"):
        require_separated(model, initial_state(model, np.stack([good, bad])[:, None]))


def test_any_two_bodies() -> None:
    mesh = block_mesh((2, 2, 1), (2e-3, 2e-3, 1e-3))
    left = SoftBody(mesh, SOFT, FREE, name="left", element=Element.LINEAR)
    stiff = [
        AffineBody(SHAPES["box"], name="cube", initial_pose=pose(0, 5e-3, 0)),
        AffineBody(sphere_mesh(0.2e-3, 1e-4), name="pea", initial_pose=pose(0, 0, 5e-3)),
    ]
    made = Scene(
        [left, replace(left, name="right", initial_pose=pose(3e-3, 0, 0))],
        KinematicBody(Ball(0.5e-3), name="ball"),
        affine_bodies=stiff,
        planes=Plane((0, 0, -2e-3), name="floor"),
        time=DYNAMIC,
    )

    def overlaps(made: Scene, **shifts: list[float]) -> set[tuple[str, str, str]]:
        model = made.finalize()
        state = initial_state(model)
        x = state.positions.numpy()
        for name, shift in ({"ball": [9e-3] * 3} | shifts).items():
            x[:, model.bodies[model.body_id(name)].node_slice] += shift
        state.positions.assign(x)
        return named(seen(model, state)[0])

    assert overlaps(made) == set()
    assert overlaps(made, right=[-1.5e-3, 0, 0]) == {("crossing", "right", "left")}
    assert overlaps(made, cube=[0, -3.8e-3, 0]) == {("crossing", "cube", "left")}
    assert overlaps(made, pea=[0, 5e-3, -5e-3]) == {("inside", "pea", "cube")}
    assert overlaps(made, pea=[0, 0, -5.5e-3]) == {("inside", "pea", "left")}
    assert overlaps(made, cube=[0, 0, -1.6e-3]) == {("below a plane", "cube", "floor")}
    assert overlaps(made, left=[0, 0, -1.1e-3]) == {("below a plane", "left", "floor")}
    assert overlaps(made, ball=[0, 5e-3, 0.9e-3]) == {("crossing", "ball", "cube")}
    # Layers that never touch, and bodies that are not there.
    for surface in (Surface(2, 2), Surface(environments=())):
        apart = replace(made, affine_bodies=[replace(body, surface=surface) for body in stiff])
        assert overlaps(apart, cube=[0, -3.8e-3, 0]) == set()


def test_a_body_that_crosses_itself() -> None:
    mesh = block_mesh((6, 1, 1), (6e-3, 1e-3, 0.5e-3))
    strip = SoftBody(mesh, SOFT, FREE, self_contact=True, element=Element.LINEAR)
    model = Scene(strip, time=DYNAMIC).finalize()
    state = initial_state(model)
    x, y, z = state.positions.numpy()[0].T
    for degrees, expected in ((340, set()), (372, {("crossing itself", "gel", "gel")})):
        angle, radius = x / 6e-3 * np.deg2rad(degrees), 1.3e-3 - z
        bent = np.column_stack([radius * np.sin(angle), y, radius * np.cos(angle)])
        state.positions.assign(bent[None])
        assert named(seen(model, state)[0]) == expected


def test_masks_and_places_that_are_not_finite() -> None:
    """The device leaves alone what is not asked for, and what is no place at all."""
    model = scene(MESH, KinematicBody(Ball(1e-3)), env_count=3).finalize()
    state = initial_state(model, everywhere(3, pose(0, 0, 0.5e-3)))
    assert all(seen(model, state, np.array([True, False, True])))
    moved(state, 0, (np.nan, 0, 0), env=2)
    mask = wp.full(3, 1, dtype=wp.int32)
    OverlapSearch(model).mark(state.positions, mask)
    found = mask.numpy()
    assert found.tolist() == [1, 1, 0]


def test_a_curved_face_may_reach_into_a_ball_by_its_inset() -> None:
    gel = SoftBody(MESH, SOFT, element=Element.QUADRATIC)
    heights = 1e-3 + np.linspace(-4e-5, 1e-6, 12)
    model = Scene(gel, KinematicBody(Ball(1e-3)), len(heights)).finalize()
    state = initial_state(model, np.stack([pose(2e-4, 3e-4, z) for z in heights])[:, None])
    found = seen(model, state)
    assert any(found) and not all(found)


def test_inverted_tets_are_found() -> None:
    model = scene(MESH, KinematicBody(Ball(1e-3)), env_count=2).finalize()
    state = moved(initial_state(model, everywhere(2, pose(0, 0, 5e-3))), 62, (0, 0, -1.5e-3), 1)
    assert list(map(kinds, seen(model, state))) == [[], [INVERTED]]

    soft = SoftBody(MESH, SOFT, element=Element.QUADRATIC)
    bent = SoftBody(CURVED, SOFT, bonded_nodes=np.arange(4), element=Element.QUADRATIC)
    at_corner = np.zeros((soft.nodal_mesh.node_count, 3))
    first, second = soft.nodal_mesh.nodes_m[soft.nodal_mesh.edges[40]]
    at_corner[MESH.node_count + 40] = -0.3 * (second - first)
    for body, way in ((soft, at_corner), (bent, curved(bent))):
        model = Scene(body).finalize()
        state = initial_state(model)
        assert find_intersections(model, state) == [[]]
        state.positions.assign(state.positions.numpy() + way)
        assert kinds(find_intersections(model, state)[0]) == [INVERTED]
