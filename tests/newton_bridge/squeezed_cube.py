# SPDX-License-Identifier: Apache-2.0
"""A free cube between two gels on prescribed jaws, which squeeze it and carry it away.

Two pads of 8 x 8 x 3 mm (E 0.1 MPa, nu 0.45, 300 linear tets) close on a cube of 6 mm and 0.26 g by
0.3 mm each in 10 ms, and move it by 0.5 mm across and 0.5 mm up in the next 10 ms, under gravity.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import warp as wp

from taccel_lab.geometry.block import block_mesh
from taccel_lab.outputs import Outputs
from taccel_lab.scene import AffineBody, KinematicBody, Material, Scene, TimeStepping, box_mesh
from taccel_lab.solvers import SolverConfig
from tests.support.scene_steps import Stepped, linear

newton = pytest.importorskip("newton", reason="newton is not installed")

from taccel_lab.newton_bridge.solver_gel import BodyGel, Coupling, SolverGel  # noqa: E402

PAD = linear(
    block_mesh((5, 5, 2), (8e-3, 8e-3, 3e-3)),
    Material(1e5, 0.45),
    friction_coefficient=0.8,
    name="pad",
)
SIDES = ("left", "right")
GELS = [BodyGel(side, PAD, name=f"{side} pad") for side in SIDES]
EDGE, DENSITY, FRICTION = 6e-3, 1200.0, 0.8
MASS = DENSITY * EDGE**3
GRAVITY = np.array([0.0, 0.0, -9.81])
CONFIG = SolverConfig(dhat_m=5e-5, relative_tolerance=1e-6)
CLOSE_S, END_S = 0.01, 0.02
HALF = np.sqrt(0.5)


def jaws(time_s: float) -> np.ndarray:
    squeeze = 3e-4 * min(time_s / CLOSE_S, 1.0)
    shift = 5e-4 * max(time_s - CLOSE_S, 0.0) / (END_S - CLOSE_S)
    x = EDGE / 2 + 6e-5 - squeeze
    return np.array(
        [[shift - x, 0, shift, 0, HALF, 0, HALF], [shift + x, 0, shift, 0, -HALF, 0, HALF]]
    )


@dataclass(frozen=True)
class Run:
    """Of each step: the cube's place and velocity, forces of gels on it and on both gels."""

    dt_s: float
    positions: np.ndarray
    velocities: np.ndarray
    forces: np.ndarray
    on_gels: np.ndarray

    def imbalance(self) -> np.ndarray:
        """Change of the cube's momentum beyond the impulse of gels and weight [N s], [step, 3]."""
        before = np.concatenate([np.zeros((1, 3)), self.velocities[:-1]])
        impulse = (self.forces + MASS * GRAVITY) * self.dt_s
        return MASS * (self.velocities - before) - impulse

    def grip_impulse(self) -> float:
        return float(np.abs(self.on_gels[:, 0, 0]).sum() * self.dt_s)


def run_of(dt_s: float, rows: list[tuple[np.ndarray, ...]]) -> Run:
    return Run(dt_s, *(np.array(column, dtype=np.float64) for column in zip(*rows, strict=True)))


def monolithic(dt_s: float, end_s: float = END_S) -> Run:
    shape = box_mesh((EDGE, EDGE, EDGE))
    scene = Scene(
        [replace(PAD, name=side, mount=f"{side} jaw") for side in SIDES],
        [KinematicBody(None, name=f"{side} jaw") for side in SIDES],
        affine_bodies=AffineBody(shape, DENSITY, name="cube", friction_coefficient=FRICTION),
        time=TimeStepping(quasi_static=False, dt_s=dt_s, gravity_m_s2=tuple(GRAVITY.tolist())),
    )
    run = Stepped(scene, jaws(0.0)[None], config=CONFIG)
    outputs, first = Outputs(run.solver), run.model.affine.first_control
    rows = []
    for step in range(1, round(end_s / dt_s) + 1):
        run.step(jaws(step * dt_s)[None])
        outputs.update(run.state)
        totals = outputs.contact_wrenches().totals().numpy()[0]
        totals = (totals + outputs.friction_wrenches().totals().numpy()[0])[:, :3]
        speed = run.state.velocities.numpy()[0, first].copy()
        rows.append((run.x()[first], speed, totals[2], totals[:2]))
    return run_of(dt_s, rows)


def cube_builder(density: float = DENSITY) -> Any:
    builder = newton.ModelBuilder()
    for side, pose in zip(SIDES, jaws(0.0), strict=True):
        builder.add_body(xform=wp.transform(*pose.tolist()), is_kinematic=True, label=side)
    cube = builder.add_body(label="cube")
    cfg = newton.ModelBuilder.ShapeConfig(density=density, mu=FRICTION)
    builder.add_shape_box(cube, hx=EDGE / 2, hy=EDGE / 2, hz=EDGE / 2, cfg=cfg)
    return builder


def cube_model() -> Any:
    return cube_builder().finalize(device="cpu")


class Simulation:
    """A model of newton that is stepped with gels; ``state`` is the latest."""

    def __init__(
        self, model: Any, gels: list[BodyGel] = GELS, touched: Any = ("cube",), **options: Any
    ) -> None:
        self.model, self.time_s = model, 0.0
        self.solver = SolverGel(model, gels, touched, config=CONFIG, **options)
        self.state, self._next = model.state(), model.state()

    def step(self, dt_s: float = 1e-3, control: Any = None) -> None:
        self.solver.step(self.state, self._next, control, None, dt_s)
        self.state, self._next = self._next, self.state
        self.time_s += dt_s

    def poses(self) -> np.ndarray:
        return self.state.body_q.numpy().copy()

    def squeeze(self, steps: int = 1, dt_s: float = 1e-3) -> None:
        """Steps in which the jaws go their way."""
        for _ in range(steps):
            poses = self.poses()
            poses[:2] = jaws(self.time_s + dt_s)
            self.state.body_q.assign(poses)
            self.step(dt_s)


def free_bodies(model: Any) -> Any:
    return newton.solvers.SolverSemiImplicit(model, angular_damping=0.0)


def coupled(dt_s: float, coupling: Coupling, end_s: float = END_S) -> Run:
    """The same in newton, whose own solver moves what is not inside."""
    model = cube_model()
    run = Simulation(model, rigid=free_bodies(model), coupling=coupling)
    run.solver.reset(run.state)
    rows = []
    for _ in range(round(end_s / dt_s)):
        run.squeeze(1, dt_s)
        speed, wrenches = run.state.body_qd.numpy()[2, :3].copy(), run.solver.wrenches
        rows.append((run.poses()[2, :3], speed, wrenches[2, :3].copy(), wrenches[:2, :3].copy()))
    return run_of(dt_s, rows)
