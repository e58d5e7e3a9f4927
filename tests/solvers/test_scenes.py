# SPDX-License-Identifier: Apache-2.0
"""Scenes of several bodies: who meets whom, with which friction, in which environment; and what a
scene does not need is not built, not launched, not compiled."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from taccel_lab.scene import (
    AffineBody,
    Ball,
    KinematicBody,
    Material,
    MaxwellBranch,
    Plane,
    Scene,
    Surface,
    TimeStepping,
    box_mesh,
    sphere_mesh,
)
from taccel_lab.solvers import EnvStatus, SolverIPC
from tests.solvers.steps import begun, stepped
from tests.support.blocks import cube, everywhere, pose, soft_block
from tests.support.intersection import find_intersections

GEL = soft_block((3, 3, 1), (4e-3, 4e-3, 1.5e-3))
SIDE, G = 1e-3, 9.81


def dynamic(gravity: tuple[float, float, float] = (0.0, 0.0, -G)) -> TimeStepping:
    return TimeStepping(quasi_static=False, dt_s=5e-3, gravity_m_s2=gravity)


class Fall:
    def __init__(self, *bodies: AffineBody, steps: int = 20, **options) -> None:
        scene = Scene(affine_bodies=bodies, **{"time": dynamic(), "planes": Plane()} | options)
        tight = {"relative_tolerance": 1e-7, "absolute_tolerance_n": 1e-11}
        self.solver, self.state = begun(scene, **tight)
        for _ in range(steps):
            stepped(self.solver, self.state)
            assert not any(find_intersections(self.solver.model, self.state))

    def middle(self, name: str) -> np.ndarray:
        model = self.solver.model
        nodes = model.bodies[model.body_id(name)].node_slice
        return self.state.positions.numpy()[:, nodes].mean(axis=1)


def test_one_description_may_stand_for_two_bodies_that_meet() -> None:
    ball = AffineBody(sphere_mesh(SIDE, SIDE), name="ball")
    made = replace(ball, initial_pose=np.stack([pose(0, 0, 1.1e-3), pose(0, 0, 1.2e-3)]))
    fall = Fall(made, replace(ball, name="upper", initial_pose=pose(0, 0, 3.3e-3)), env_count=2)
    assert ((fall.middle("upper") - fall.middle("ball"))[:, 2] > 1.9 * SIDE).all()
    assert (0, 1) in Scene(affine_bodies=[ball, ball], time=dynamic()).finalize().contact_plan.pairs


def test_layers_decide_who_meets() -> None:
    """Two cubes fall; the one on another layer falls through the floor that stops the first."""
    ghost = Surface(layer=2, collides_with=2)
    fall = Fall(
        cube(SIDE, pose(0, 0, 6e-4), "stopped"),
        cube(SIDE, pose(2e-4, 0, 6e-4), "ghost", surface=ghost),
        steps=12,
    )
    assert fall.middle("stopped")[0, 2] > 0.5 * SIDE and fall.middle("ghost")[0, 2] < -SIDE


def test_friction_of_a_pair_comes_before_that_of_its_bodies() -> None:
    """On a slope of 0.3, one cube is given friction 0.1 with the floor, the other keeps 0.5."""
    angle = np.arctan(0.3)
    fall = Fall(
        cube(SIDE, pose(0, 0, 0.51e-3), "slides", friction_coefficient=0.5),
        cube(SIDE, pose(0, 2e-3, 0.51e-3), "sticks", friction_coefficient=0.5),
        planes=Plane(friction_coefficient=0.5, name="floor"),
        time=dynamic((G * np.sin(angle), 0.0, -G * np.cos(angle))),
        pair_friction={("floor", "slides"): 0.1},
    )
    expected = 0.5 * G * (np.sin(angle) - 0.1 * np.cos(angle)) * (20 * 5e-3) ** 2
    assert fall.middle("slides")[0, 0] == pytest.approx(expected, rel=0.15)
    assert abs(fall.middle("sticks")[0, 0]) < 3e-5


def test_coefficients_combine_by_the_harmonic_mean() -> None:
    for first, second, expected in (
        (None, None, 0.0), (None, 0.4, 0.4), (1.0, 0.2, 1 / 3), (0.0, 0.7, 0.0), (0.0, 0.0, 0.0),
    ):  # fmt: skip
        scene = Scene(replace(GEL, friction_coefficient=first), KinematicBody(Ball(1e-3), second))
        for bodies in (scene.bodies, scene.bodies[::-1]):
            assert scene.friction_between(*bodies) == pytest.approx(expected)


def test_thickness_keeps_bodies_apart() -> None:
    thick = cube(SIDE, pose(0, 0, 1e-3), surface=Surface(thickness_m=2e-4))
    fall = Fall(thick, planes=Plane(surface=Surface(thickness_m=1e-4)))
    gap = fall.middle("cube")[0, 2] - SIDE / 2
    assert 3e-4 < gap < 3e-4 + 1.01 * fall.solver.config.dhat_m


def test_too_many_contacts_are_flagged_in_their_environment() -> None:
    start, target = (
        np.stack([pose(0, 0, z)[None] for z in heights])
        for heights in ((1.3e-3, 1.02e-3), (1.2e-3, 0.6e-3))
    )
    solver, state = begun(Scene(GEL, KinematicBody(Ball(1e-3)), 2), start, max_collisions=3)
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
    stepped(SolverIPC(solver.model), state, target)


# The plan -----------------------------------------------------------------------------------------

SMALL = soft_block((2, 2, 1), (2e-3, 2e-3, 1e-3))
DAMPED = replace(SMALL, material=Material(1e5, 0.4, branches=(MaxwellBranch(0.5, 0.01),)))
CUBE = cube(1e-3, pose(0, 0, 6e-4))
BOX = KinematicBody(box_mesh((1e-3,) * 3), 0.5)
PRESS = Scene(SMALL, KinematicBody(Ball(1e-3)))
ALWAYS = {"unknowns", "linear solver", "captured graph"}


@pytest.mark.parametrize(
    ("scene", "expected"),
    [
        (Scene(SMALL), {"elasticity"}),
        (PRESS, {"elasticity", "prescribed motion", "search of balls"}),
        (
            Scene(SMALL, BOX),
            {"elasticity", "prescribed motion", "search in body frames", "friction"},
        ),
        (
            Scene(replace(SMALL, self_contact=True)),
            {"elasticity", "search among soft bodies", "self-contact"},
        ),
        (
            Scene(DAMPED, planes=Plane(), time=dynamic()),
            {"elasticity", "relaxation", "inertia", "planes"},
        ),
        (Scene(affine_bodies=CUBE, time=dynamic()), {"inertia", "affine bodies"}),
        (
            Scene(affine_bodies=[CUBE, CUBE], time=dynamic()),
            {"inertia", "affine bodies", "search in body frames"},
        ),
    ],
)
def test_only_what_the_scene_needs_is_on(scene: Scene, expected: set[str]) -> None:
    assert {entry.part for entry in begun(scene)[0].plan.entries if entry.on} - ALWAYS == expected


def test_the_plan_reads_like_a_table_which_loads_join_when_they_are_set() -> None:
    solver, state = begun(PRESS)
    plan = solver.plan
    assert len(plan.describe().splitlines()) == len(plan.entries)
    assert "1 body and 9 bonded nodes carry no unknowns" in plan.describe()
    assert not plan.is_on("friction") and plan.is_on("elasticity")
    with pytest.raises(KeyError, match="parts are unknowns"):
        plan.is_on("gravity")
    # Poses that nobody gives have a default.
    np.testing.assert_array_equal(
        state.poses.numpy().reshape(1, 1, 7), everywhere(1, pose(0, 0, 0))
    )
    solver, state = begun(Scene(SMALL))
    solver.step(state)
    assert not solver.plan.is_on("external loads")
    state.load(solver.model)
    solver.step(state)
    assert solver.plan.is_on("external loads")


CODE = """
import warp as wp
from tests.solvers.steps import begun, stepped
from taccel_lab.scene import Element
from tests.solvers.test_scenes import PRESS, everywhere, pose, replace
gel = replace(PRESS.soft_bodies[0], element=Element.QUADRATIC)
solver, state = begun(replace(PRESS, soft_bodies=gel), everywhere(1, pose(0, 0, 1.02e-3)))
assert stepped(solver, state, everywhere(1, pose(0, 0, 0.95e-3))).contact_force_n[0] > 0
print("LOADED", *sorted(m.name for m in wp._src.context.user_modules.values() if m.execs))
"""
NEEDED = ("broad_phase.candidates", "quadratic_kernels.neo_hookean", "linear.cpu")
UNUSED = ("friction", "inertia", "maxwell", "affine", "joints", "external", "stiff_targets")
UNUSED += ("soft_targets", "linear_kernels", "mooney", "pcg")


@pytest.mark.thorough
def test_modules_that_nobody_launches_are_not_compiled() -> None:
    run = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=True)
    (loaded,) = (line for line in run.stdout.splitlines() if line.startswith("LOADED"))
    assert [name for name in (*NEEDED, "potentials.contact") if name not in loaded] == []
    assert [name for name in UNUSED if name in loaded] == [], "compiled for nothing"
