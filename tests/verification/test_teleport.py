# SPDX-License-Identifier: Apache-2.0
"""Targets whose way leads through a body: pushed ahead or flagged, never tunnelled.

Each target itself is free of overlaps, so that only the way there tells.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from taccel_lab.bodies.crossings import crossing_pairs
from taccel_lab.geometry.block import block_mesh
from taccel_lab.ipc.gaps import SurfacePairs
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
    TriangleMesh,
    box_mesh,
)
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.solvers.report import StepReport
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.state import State, initial_state
from tests.support.blocks import everywhere, pose

GEL = SoftBody(
    block_mesh((4, 4, 2), (4e-3, 4e-3, 2e-3), jitter=0.15),
    Material(1e5, 0.4),
    element=Element.LINEAR,
)
HASTY = SolverConfig(max_newton_iterations=60, max_substep_halvings=2)


@dataclass
class Taken:
    """A step that was asked for, and how it ended."""

    state: State
    report: StepReport
    model_positions: np.ndarray

    @property
    def z(self) -> float:
        """Height of the kinematic body's origin."""
        return float(self.state.poses.numpy().reshape(7)[2])


def take(scene: Scene, start: np.ndarray, target: np.ndarray) -> Taken:
    """One step from a start without overlaps to a target; nothing may cross at its end."""
    model = scene.finalize()
    solver, state = SolverIPC(model, HASTY), initial_state(model, everywhere(1, start))
    report = solver.step(state, everywhere(1, target))
    surfaces = SurfacePairs(model)
    x = state.positions.numpy()[0]
    segments, triangles = surfaces.edges, surfaces.faces
    edges, faces = crossing_pairs(x[segments], x[triangles], segments, triangles)
    bodies = surfaces.node_bodies
    touch = surfaces.may_touch[bodies[segments[edges, 0]], bodies[triangles[faces, 0]]]
    assert not touch.any(), "bodies cross"
    present = np.ones(len(model.bodies), dtype=bool)
    assert (surfaces.nearer_than(x, present, 1e-5).gaps_m > 0).all()
    reached = np.abs(state.poses.numpy().reshape(7) - target).max() < 1e-12
    assert reached == bool(report.converged[0]), "it is there exactly when it says so"
    return Taken(state, report, x)


@pytest.mark.parametrize(
    "shape", [Ball(1e-3), box_mesh((1e-3, 1e-3, 1e-3)), box_mesh((1e-3, 1e-3, 1e-3)).faces]
)
def test_through_a_gel_on_its_back(shape: TriangleMesh | Ball | np.ndarray) -> None:
    """From above the gel to beyond its glued back, where nothing would overlap."""
    if isinstance(shape, np.ndarray):
        # A sheet without volume: the lower face of the box alone.
        shape = TriangleMesh(box_mesh((1e-3, 1e-3, 1e-3)).vertices_m[:4], shape[:2])
    scene = Scene(GEL, KinematicBody(shape))
    taken = take(scene, pose(1e-4, 2e-4, 1.2e-3), pose(1e-4, 2e-4, -8e-3))
    assert not taken.report.converged[0]
    assert taken.z == 1.2e-3


def test_a_bar_that_turns_through_the_gel() -> None:
    """Along its chord the bar would pass above, along its arc it goes through."""
    bar = box_mesh((7e-3, 1e-3, 1e-3))
    arm = TriangleMesh(bar.vertices_m + [4.5e-3, 0, 0], bar.faces)
    start, end = pose(0, 0, 3e-3, (0, 1, 0), 0.0), pose(0, 0, 3e-3, (0, 1, 0), 175.0)
    taken = take(Scene(GEL, KinematicBody(arm)), start, end)
    assert not taken.report.converged[0]


def cube(z: float) -> AffineBody:
    return AffineBody(box_mesh((1e-3, 1e-3, 1e-3)), 2000, initial_pose=pose(0, 0, z))


DYNAMIC = TimeStepping(quasi_static=False, dt_s=5e-3)


def test_a_free_body_is_pushed_ahead() -> None:
    """The pusher goes five times its own size through where the cube was."""
    pusher = KinematicBody(box_mesh((1.4e-3, 1.4e-3, 1e-3)), name="pusher")
    scene = Scene((), pusher, time=DYNAMIC, affine_bodies=cube(0.0))
    taken = take(scene, pose(0, 0, 1.3e-3), pose(0, 0, -5e-3))
    assert taken.report.converged[0], taken.report.summary()
    assert taken.model_positions[0, 2] < -5.9e-3


def test_a_body_between_a_pusher_and_the_floor() -> None:
    """It cannot give way: the pusher stops, and says so."""
    pusher = KinematicBody(box_mesh((1.4e-3, 1.4e-3, 1e-3)), name="pusher")
    floor = Plane((0, 0, -1e-3))
    scene = Scene((), pusher, time=DYNAMIC, affine_bodies=cube(0.0), planes=floor)
    taken = take(scene, pose(0, 0, 1.3e-3), pose(0, 0, -5e-3))
    assert not taken.report.converged[0]
    assert taken.model_positions[0, 2] > -1e-3


def test_a_free_body_that_flies_at_a_thin_sheet() -> None:
    """Twenty times its own size a step, at a sheet without volume."""
    corners = box_mesh((8e-3, 8e-3, 1e-3))
    sheet = KinematicBody(TriangleMesh(corners.vertices_m[:4], corners.faces[:2]), name="sheet")
    bullet = AffineBody(
        box_mesh((1e-3, 1e-3, 1e-3)),
        2000,
        initial_pose=pose(0.3e-3, 0.2e-3, 3e-3),
        initial_velocity_m_s=(0.0, 0.0, -4.0),
    )
    scene = Scene((), sheet, time=DYNAMIC, affine_bodies=bullet)
    taken = take(scene, pose(0, 0, 0), pose(0, 0, 0))
    assert taken.model_positions[0, 2] > -0.5e-3
