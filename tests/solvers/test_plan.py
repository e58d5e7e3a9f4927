# SPDX-License-Identifier: Apache-2.0
"""What a scene does not need is not built, not launched, not compiled; the plan says so."""

from __future__ import annotations

import subprocess
import sys

import pytest

from taccel_lab.bodies.material import MaxwellBranch
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
)
from taccel_lab.solvers import SolverIPC
from taccel_lab.state import initial_state
from tests.support.blocks import block_mesh, pose

MESH = block_mesh((2, 2, 1), (2e-3, 2e-3, 1e-3))
GEL = Material(1e5, 0.4)
DYNAMIC = TimeStepping(quasi_static=False, dt_s=1e-2)
ALWAYS = {"unknowns", "linear solver", "captured graph"}


def parts(scene: Scene) -> set[str]:
    """Optional parts that are on."""
    plan = SolverIPC(scene.finalize()).plan
    return {entry.part for entry in plan.entries if entry.on} - ALWAYS


CUBE = AffineBody(box_mesh((1e-3,) * 3), initial_pose=pose(0, 0, 6e-4))


@pytest.mark.parametrize(
    ("scene", "expected"),
    [
        (Scene(SoftBody(MESH, GEL, element=Element.LINEAR)), {"elasticity"}),
        (
            Scene(SoftBody(MESH, GEL, element=Element.LINEAR), KinematicBody(Ball(1e-3))),
            {"elasticity", "prescribed motion", "search of balls"},
        ),
        (
            Scene(
                SoftBody(MESH, GEL, element=Element.LINEAR),
                KinematicBody(box_mesh((1e-3,) * 3), 0.5),
            ),
            {"elasticity", "prescribed motion", "search in body frames", "friction"},
        ),
        (
            Scene(SoftBody(MESH, GEL, self_contact=True, element=Element.LINEAR)),
            {"elasticity", "search among soft bodies", "self-contact"},
        ),
        (
            Scene(
                SoftBody(
                    MESH,
                    Material(1e5, 0.4, branches=(MaxwellBranch(0.5, 0.01),)),
                    element=Element.LINEAR,
                ),
                planes=Plane(),
                time=DYNAMIC,
            ),
            {"elasticity", "relaxation", "inertia", "planes"},
        ),
        (Scene(affine_bodies=CUBE, time=DYNAMIC), {"inertia", "affine bodies"}),
        (
            Scene(affine_bodies=[CUBE, CUBE], time=DYNAMIC),
            {"inertia", "affine bodies", "search in body frames"},
        ),
    ],
)
def test_only_what_the_scene_needs_is_on(scene: Scene, expected: set[str]) -> None:
    assert parts(scene) == expected


def test_the_plan_reads_like_a_table() -> None:
    scene = Scene(SoftBody(MESH, GEL, element=Element.LINEAR), KinematicBody(Ball(1e-3)))
    solver = SolverIPC(scene.finalize())
    lines = solver.plan.describe().splitlines()
    assert len(lines) == len(solver.plan.entries)
    assert "1 body and 9 bonded nodes carry no unknowns" in solver.plan.describe()
    assert not solver.plan.is_on("friction") and solver.plan.is_on("elasticity")
    with pytest.raises(KeyError, match="parts are unknowns"):
        solver.plan.is_on("gravity")


def test_a_load_joins_the_plan_when_it_is_set() -> None:
    model = Scene(SoftBody(MESH, GEL, element=Element.LINEAR)).finalize()
    solver, state = SolverIPC(model), initial_state(model)
    solver.step(state)
    assert not solver.plan.is_on("external loads")
    state.load(model)
    solver.step(state)
    assert solver.plan.is_on("external loads")


CODE = """
import sys
import warp as wp
from taccel_lab.scene import *
from taccel_lab.solvers import SolverIPC
from taccel_lab.state import initial_state
from tests.support.blocks import block_mesh, everywhere, pose
mesh = block_mesh((2, 2, 1), (2e-3, 2e-3, 1e-3))
model = Scene(SoftBody(mesh, Material(1e5, 0.4)), KinematicBody(Ball(1e-3))).finalize()
solver, state = SolverIPC(model), initial_state(model, everywhere(1, pose(0, 0, 1.02e-3)))
report = solver.step(state, everywhere(1, pose(0, 0, 0.95e-3)))
assert report.converged.all() and report.contact_force_n[0] > 0
loaded = [m.name for m in wp._src.context.user_modules.values() if m.execs]
print("LOADED", *sorted(loaded))
"""


@pytest.mark.thorough
def test_modules_that_nobody_launches_are_not_compiled() -> None:
    """A frictionless quasi-static press by a ball, in a fresh process."""
    run = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=True)
    line = next(line for line in run.stdout.splitlines() if line.startswith("LOADED"))
    loaded = " ".join(line.split()[1:])
    for needed in (
        "broad_phase.candidates",
        "quadratic_kernels.neo_hookean",
        "linear.cpu",
        "potentials.contact",
    ):
        assert needed in loaded, needed
    for unused in (
        "friction",
        "inertia",
        "maxwell",
        "affine",
        "joints",
        "external",
        "stiff_targets",
        "soft_targets",
        "linear_kernels",
        "mooney",
        "pcg",
    ):
        assert unused not in loaded, f"{unused} was compiled for nothing"
