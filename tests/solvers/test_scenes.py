# SPDX-License-Identifier: Apache-2.0
"""Scenes of several bodies: who meets whom, with which friction, in which environment."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

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
    box_mesh,
    sphere_mesh,
)
from taccel_lab.solvers import EnvStatus, SolverConfig, SolverIPC
from taccel_lab.state import State, initial_state
from tests.support.blocks import block_mesh, everywhere, pose
from tests.support.intersection import find_intersections

GEL = Material(1e5, 0.4)
MESH = block_mesh((3, 3, 1), (4e-3, 4e-3, 1.5e-3), jitter=0.1)
SIDE = 1e-3
G = 9.81


def dynamic(gravity: tuple[float, float, float] = (0.0, 0.0, -G)) -> TimeStepping:
    return TimeStepping(quasi_static=False, dt_s=5e-3, gravity_m_s2=gravity)


def cube(name: str, at: np.ndarray, **settings) -> AffineBody:
    return AffineBody(box_mesh((SIDE,) * 3), name=name, initial_pose=at, **settings)


def run(scene: Scene, steps: int, poses: np.ndarray | None = None) -> tuple[SolverIPC, State]:
    model = scene.finalize()
    config = SolverConfig(relative_tolerance=1e-7, absolute_tolerance_n=1e-11)
    solver, state = SolverIPC(model, config), initial_state(model, poses)
    for _ in range(steps):
        report = solver.step(state)
        assert report.converged.all(), report.summary()
        assert not any(find_intersections(model, state))
    return solver, state


def heights(solver: SolverIPC, state: State, name: str) -> np.ndarray:
    """Mean height of a body's nodes in each environment [m]."""
    nodes = solver.model.bodies[solver.model.body_id(name)].node_slice
    return state.positions.numpy()[:, nodes, 2].mean(axis=1)


def test_one_description_may_stand_for_two_bodies_that_meet() -> None:
    ball = AffineBody(sphere_mesh(SIDE, SIDE), name="ball")
    made = replace(ball, initial_pose=np.stack([pose(0, 0, 1.1e-3), pose(0, 0, 1.2e-3)]))
    upper = replace(ball, name="upper", initial_pose=pose(0, 0, 3.3e-3))
    scene = Scene(affine_bodies=[made, upper], planes=Plane(), env_count=2, time=dynamic())
    solver, state = run(scene, 20)
    assert (heights(solver, state, "upper") - heights(solver, state, "ball") > 1.9 * SIDE).all()
    same = Scene(affine_bodies=[ball, ball], time=dynamic())
    assert (0, 1) in same.finalize().contact_plan.pairs


def test_layers_decide_who_meets() -> None:
    """Two cubes fall; the one on another layer falls through the floor that stops the first."""
    stopped = cube("stopped", pose(0, 0, 6e-4))
    ghost = cube("ghost", pose(2e-4, 0, 6e-4), surface=Surface(layer=2, collides_with=2))
    solver, state = run(Scene(affine_bodies=[stopped, ghost], planes=Plane(), time=dynamic()), 12)
    assert heights(solver, state, "stopped")[0] > 0.5 * SIDE
    assert heights(solver, state, "ghost")[0] < -SIDE


def test_friction_of_a_pair_comes_before_that_of_its_bodies() -> None:
    """On a slope of 0.3, one cube is given friction 0.1 with the floor, the other keeps 0.5."""
    angle = np.arctan(0.3)
    cubes = [
        cube("slides", pose(0, 0, 0.51e-3), friction_coefficient=0.5),
        cube("sticks", pose(0, 2e-3, 0.51e-3), friction_coefficient=0.5),
    ]
    scene = Scene(
        affine_bodies=cubes,
        planes=Plane(friction_coefficient=0.5, name="floor"),
        time=dynamic((G * np.sin(angle), 0.0, -G * np.cos(angle))),
        pair_friction={("floor", "slides"): 0.1},
    )
    solver, state = run(scene, 20)
    x = state.positions.numpy()[0]
    nodes = [solver.model.bodies[i].node_slice for i in range(2)]
    slid, stuck = (x[n, 0].mean() for n in nodes)
    time = 20 * 5e-3
    expected = 0.5 * G * (np.sin(angle) - 0.1 * np.cos(angle)) * time**2
    assert slid == pytest.approx(expected, rel=0.15)
    assert abs(stuck) < 3e-5


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [(None, None, 0.0), (None, 0.4, 0.4), (1.0, 0.2, 1 / 3), (0.0, 0.7, 0.0), (0.0, 0.0, 0.0)],
)
def test_coefficients_combine_by_the_harmonic_mean(
    first: float | None, second: float | None, expected: float
) -> None:
    scene = Scene(
        SoftBody(MESH, GEL, friction_coefficient=first, element=Element.LINEAR),
        KinematicBody(Ball(1e-3), second),
    )
    assert scene.friction_between(*scene.bodies) == pytest.approx(expected)
    assert scene.friction_between(*scene.bodies[::-1]) == pytest.approx(expected)


def test_thickness_keeps_bodies_apart() -> None:
    thick = cube("cube", pose(0, 0, 1e-3), surface=Surface(thickness_m=2e-4))
    floor = Plane(surface=Surface(thickness_m=1e-4))
    solver, state = run(Scene(affine_bodies=thick, planes=floor, time=dynamic()), 20)
    gap = heights(solver, state, "cube")[0] - SIDE / 2
    assert 3e-4 < gap < 3e-4 + 1.01 * solver.config.dhat_m


def test_too_many_contacts_are_flagged_in_their_environment() -> None:
    model = Scene(
        SoftBody(MESH, GEL, element=Element.LINEAR), KinematicBody(Ball(1e-3)), env_count=2
    ).finalize()
    start = np.stack([pose(0, 0, 1.3e-3)[None], pose(0, 0, 1.02e-3)[None]])
    target = np.stack([pose(0, 0, 1.2e-3)[None], pose(0, 0, 0.6e-3)[None]])
    solver, state = SolverIPC(model, SolverConfig(max_collisions=3)), initial_state(model, start)
    before = state.positions.numpy().copy()
    report = solver.step(state, target)
    assert report.status.tolist() == [EnvStatus.CONVERGED, EnvStatus.CONTACT_OVERFLOW]
    assert report.failures() == {"CONTACT_OVERFLOW": [1]}
    assert "CONTACT_OVERFLOW: [1]" in report.summary()
    header, first, second = report.describe().splitlines()
    assert first.split()[:2] == ["0", "CONVERGED"] and second.split()[1] == "CONTACT_OVERFLOW"
    assert len(header) == len(first) == len(second)
    assert float(first.split()[6]) == pytest.approx(report.residual_n[0], rel=1e-2)
    assert report.describe([1]).splitlines() == [header, second]
    np.testing.assert_array_equal(state.positions.numpy()[1], before[1])
    plenty = SolverIPC(model)
    assert plenty.step(state, target).converged.all()


def test_unused_kinematic_poses_have_a_default() -> None:
    model = Scene(
        SoftBody(MESH, GEL, element=Element.LINEAR), KinematicBody(None, name="frame"), env_count=2
    ).finalize()
    state = initial_state(model)
    np.testing.assert_array_equal(
        state.poses.numpy().reshape(2, 1, 7), everywhere(2, pose(0, 0, 0))
    )
