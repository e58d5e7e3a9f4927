# SPDX-License-Identifier: Apache-2.0
"""Solvers that step: a gel that is pressed and dragged, a mechanism; and what steps leave."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from taccel_lab.model import Model
from taccel_lab.scene import (
    AffineBody,
    KinematicBody,
    Material,
    MaxwellBranch,
    PositionDrive,
    PrismaticJoint,
    RevoluteJoint,
    Scene,
    TimeScheme,
    TimeStepping,
    box_mesh,
)
from taccel_lab.solvers import Control, SolverConfig, SolverIPC, StepReport
from taccel_lab.state import State, initial_state
from tests.support.blocks import everywhere, pose, soft_block
from tests.support.grasps import gel_above_a_table, hand_poses

ENVS = 3
EVERYONE = np.ones(ENVS, dtype=bool)
RELAXING = (MaxwellBranch(0.5, 8e-3), MaxwellBranch(0.2, 0.1))
DT_S = [0, 5e-3, 4e-3, 6e-3, 5e-3, 3e-3]
HAND = everywhere(ENVS, pose(0, 0, 0))
Begun = tuple[SolverIPC, State]


def begun(scene: Scene | Model, poses: np.ndarray | None = None, **options: Any) -> Begun:
    """A solver with ``options`` of its ``SolverConfig``, and the state at the start."""
    model = scene.finalize() if isinstance(scene, Scene) else scene
    return SolverIPC(model, SolverConfig(**options)), initial_state(model, poses)


def stepped(solver: SolverIPC, state: State, target: Any = None, **options: Any) -> StepReport:
    report = solver.step(state, target, **options)
    assert report.converged.all(), report.summary()
    return report


def left(solver: SolverIPC, state: State, env: Any = slice(None)) -> list[np.ndarray]:
    """Positions, velocities, contact and friction of (some) environments."""
    arrays = (state.positions, state.velocities, solver.contact_gradient, solver.friction_gradient)
    return [array.numpy()[env].copy() for array in arrays]


def assert_same(found: Iterable[np.ndarray], expected: Iterable[np.ndarray]) -> None:
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)


def poses(steps: np.ndarray | list[int] | int) -> np.ndarray:
    """Of the hand that presses and drags the gel, for the step of all or of each environment."""
    return hand_poses(
        (4e-5 * env * step, 1.3e-4 - (3e-5 + 2e-5 * env) * step)
        for env, step in enumerate(np.broadcast_to(steps, ENVS))
    )


def pressed(
    quasi_static: bool = True,
    scheme: TimeScheme = TimeScheme.EULER,
    branches: tuple[MaxwellBranch, ...] = (),
) -> Begun:
    time = TimeStepping(quasi_static=quasi_static, dt_s=5e-3, scheme=scheme)
    return begun(gel_above_a_table(time, ENVS, branches=branches), poses(0), dhat_m=1e-4)


def finger(scheme: TimeScheme = TimeScheme.EULER, **settings: object) -> Begun:
    """A finger on a hinge presses a gel; a bolt on a slide at it runs against its limits."""
    material = Material(1e5, 0.4, branches=RELAXING)
    gel = soft_block((3, 3, 2), (6e-3, 6e-3, 3e-3), material, friction_coefficient=0.3)
    finger, bolt = (
        AffineBody(box_mesh(size), name=name, initial_pose=pose(-2e-3, 0, z))
        for name, size, z in (("finger", (8e-3, 2e-3, 2e-3), 1.1e-3), ("bolt", (1e-3,) * 3, 3.5e-3))
    )
    hinge = RevoluteJoint(
        "finger", "hand", (-6e-3, 0, 1.1e-3), (0, 1, 0), name="hinge",
        drive=PositionDrive(2e-3, 1e-5),
    )  # fmt: skip
    slide = PrismaticJoint(
        "bolt", "finger", (-2e-3, 0, 3.5e-3), (1, 0, 0), name="slide", limits_mm=(-0.2, 0.2)
    )
    time = TimeStepping(
        quasi_static=False, dt_s=5e-3, scheme=scheme, gravity_m_s2=(0.0, 0.0, -9.81)
    )
    hand = KinematicBody(None, name="hand")
    scene = Scene(gel, hand, ENVS, time, affine_bodies=[finger, bolt], joints=[hinge, slide])
    return begun(scene, HAND, dhat_m=1e-4, **settings)


def asked(solver: SolverIPC, steps: np.ndarray | int, dt_s: float | None = None) -> Control:
    env = np.arange(ENVS)
    steps = np.broadcast_to(steps, ENVS)
    poses = HAND.copy()
    poses[:, 0, 0] = 3e-5 * steps * env
    wrenches = np.zeros((ENVS, 2, 2, 3))
    wrenches[:, 1, 0, 0] = 1e-4 * (-1.0) ** (steps + env)
    forces = np.zeros((ENVS, solver.model.node_count, 3))
    forces[:, solver.model.bodies[0].node_slice, 1] = 1e-5 * (steps * (env + 1))[:, None]
    targets = np.stack([0.05 * steps * (env + 1), 0.0 * env], axis=1)
    return Control(poses, targets, dt_s, forces, wrenches)
