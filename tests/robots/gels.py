# SPDX-License-Identifier: Apache-2.0
"""Gels on the links of our robots, and scenes that must converge."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from taccel_lab.geometry.block import block_mesh
from taccel_lab.model import Model
from taccel_lab.robots import DrivenRobot, Robot, named, on_seat
from taccel_lab.scene import AffineBody, Element, Material, Plane, Scene, SoftBody, TimeStepping
from taccel_lab.solvers import SolverConfig, SolverIPC
from taccel_lab.state import State, initial_state

PAD = block_mesh((4, 4, 2), (8e-3, 8e-3, 3e-3), jitter=0.1)
GEL = SoftBody(PAD, Material(1e5, 0.45), friction_coefficient=0.8, element=Element.LINEAR)
IDENTITY = np.array([0, 0, 0, 0, 0, 0, 1.0])
G = 9.81


def with_pads(robot: Robot, gel: SoftBody = GEL) -> Robot:
    """A gel on each finger of our gripper or hand."""
    seats = {"finger_left": "left", "finger_right": "right"}
    if "pad_1" in robot.link_names:
        seats = {f"pad_{k}": f"pad {k}" for k in (1, 2, 3)}
    for link, name in seats.items():
        robot = robot.mount(link, gel, on_seat(PAD), name)
    return robot


def padded_hand() -> Robot:
    return with_pads(named("three_finger_hand"))


def moving(dt_s: float, gravity: float = 0.0) -> TimeStepping:
    return TimeStepping(quasi_static=False, dt_s=dt_s, gravity_m_s2=(0, 0, -gravity))


def driven_scene(
    driven: DrivenRobot,
    time: TimeStepping,
    bodies: Sequence[AffineBody] = (),
    planes: Sequence[Plane] = (),
    envs: int = 1,
) -> Scene:
    """A driven robot and what is beside it."""
    return Scene(
        driven.soft_bodies,
        driven.kinematic_bodies,
        envs,
        time,
        affine_bodies=[*driven.affine_bodies, *bodies],
        joints=driven.joints,
        planes=list(planes),
    )


class Run:
    """A model on its way; each step must converge."""

    def __init__(self, scene: Scene, poses: np.ndarray, **config: Any) -> None:
        self.model: Model = scene.finalize()
        self.solver = SolverIPC(self.model, SolverConfig(**config) if config else None)
        self.state: State = initial_state(self.model, poses)

    def step(self, control: Any, steps: int = 1) -> np.ndarray:
        """Residuals of the last step [N], [env]."""
        for _ in range(steps):
            report = self.solver.step(self.state, control)
            assert report.converged.all(), report.summary()
        return report.residual_n

    def coordinates(self, driven: DrivenRobot) -> np.ndarray:
        """Of the robot's joints, [env, dof]."""
        assert self.solver.joints is not None
        return driven.coordinates(self.solver.joints.coordinates.numpy())

    def efforts(self) -> np.ndarray:
        """Of the first environment's drives, [joint]."""
        assert self.solver.joints is not None
        return self.solver.joints.efforts.numpy()[0]
