# SPDX-License-Identifier: Apache-2.0
"""A free cube between two gels on prescribed jaws, which squeeze it and carry it away.

Two pads of 8 x 8 x 3 mm (E 0.1 MPa, nu 0.45, 300 linear tets) close on a cube of 6 mm and 0.26 g by
0.3 mm each in 10 ms, and move it by 0.5 mm across and 0.5 mm up in the next 10 ms, under gravity.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import warp as wp

from taccel_lab.geometry.block import block_mesh
from taccel_lab.outputs import Outputs
from taccel_lab.scene import (
    AffineBody,
    Element,
    KinematicBody,
    Material,
    Scene,
    SoftBody,
    TimeStepping,
    box_mesh,
)
from taccel_lab.solvers import Control, SolverConfig, SolverIPC
from taccel_lab.state import initial_state

newton = pytest.importorskip("newton", reason="newton is not installed")

from taccel_lab.newton_bridge.solver_gel import BodyGel, Coupling, SolverGel  # noqa: E402

MESH = block_mesh((5, 5, 2), (8e-3, 8e-3, 3e-3))
PAD = SoftBody(
    MESH, Material(1e5, 0.45), friction_coefficient=0.8, element=Element.LINEAR, name="pad"
)
EDGE, DENSITY, FRICTION = 6e-3, 1200.0, 0.8
MASS = DENSITY * EDGE**3
GRAVITY = np.array([0.0, 0.0, -9.81])
CONFIG = SolverConfig(dhat_m=5e-5, relative_tolerance=1e-6)
CLOSE_S, END_S = 0.01, 0.02
HALF = np.sqrt(0.5)


def jaws(time_s: float) -> np.ndarray:
    """Poses of both jaws, [2, 7]."""
    squeeze = 3e-4 * min(time_s / CLOSE_S, 1.0)
    shift = 5e-4 * max(time_s - CLOSE_S, 0.0) / (END_S - CLOSE_S)
    x = EDGE / 2 + 6e-5 - squeeze
    return np.array(
        [[shift - x, 0, shift, 0, HALF, 0, HALF], [shift + x, 0, shift, 0, -HALF, 0, HALF]]
    )


@dataclass(frozen=True)
class Run:
    """Of each step: the cube's centre [m] and velocity [m/s], forces of gels on it [N], forces on
    both gels [N]."""

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
        """Of one gel over the run [N s]."""
        return float(np.abs(self.on_gels[:, 0, 0]).sum() * self.dt_s)


def monolithic(dt_s: float, end_s: float = END_S) -> Run:
    """Ours alone, in double precision."""
    scene = Scene(
        [replace(PAD, name=side, mount=f"{side} jaw") for side in ("left", "right")],
        [KinematicBody(None, name=f"{side} jaw") for side in ("left", "right")],
        affine_bodies=AffineBody(
            box_mesh((EDGE, EDGE, EDGE)), DENSITY, name="cube", friction_coefficient=FRICTION
        ),
        time=TimeStepping(quasi_static=False, dt_s=dt_s, gravity_m_s2=tuple(GRAVITY.tolist())),
    )
    model = scene.finalize("cpu")
    solver = SolverIPC(model, CONFIG)
    outputs = Outputs(solver)
    state = initial_state(model, jaws(0.0)[None])
    first = model.affine.first_control
    rows = []
    for step in range(1, round(end_s / dt_s) + 1):
        report = solver.step(state, Control(target_poses=jaws(step * dt_s)[None]))
        assert report.converged.all(), report.summary()
        outputs.update(state)
        totals = outputs.contact_wrenches().totals().numpy()[0]
        totals = (totals + outputs.friction_wrenches().totals().numpy()[0])[:, :3]
        rows.append(
            (state.positions.numpy()[0, first].copy(), state.velocities.numpy()[0, first].copy())
            + (totals[2], totals[:2])
        )
    return Run(dt_s, *(np.array(column) for column in zip(*rows, strict=True)))


def cube_builder(density: float = DENSITY) -> object:
    """Two kinematic jaws and a free cube."""
    builder = newton.ModelBuilder()
    for side, pose in zip(("left", "right"), jaws(0.0), strict=True):
        builder.add_body(xform=wp.transform(*pose.tolist()), is_kinematic=True, label=side)
    cube = builder.add_body(label="cube")
    cfg = newton.ModelBuilder.ShapeConfig(density=density, mu=FRICTION)
    builder.add_shape_box(cube, hx=EDGE / 2, hy=EDGE / 2, hz=EDGE / 2, cfg=cfg)
    return builder


def cube_model() -> object:
    """They as newton's model."""
    return cube_builder().finalize(device="cpu")  # type: ignore[attr-defined]


def squeezing(solver: SolverGel, states: list, steps: int, dt_s: float = 1e-3) -> Iterator[Any]:
    """The state after each step in which the jaws go their way."""
    for step in range(1, steps + 1):
        before, after = states
        poses = before.body_q.numpy()
        poses[:2] = jaws(step * dt_s)
        before.body_q.assign(poses)
        solver.step(before, after, None, None, dt_s)
        yield after
        states = [after, before]


def coupled(dt_s: float, coupling: Coupling, end_s: float = END_S) -> Run:
    """The same in newton, whose own solver moves what is not inside."""
    model = cube_model()
    solver = SolverGel(
        model,
        [BodyGel(side, PAD, name=f"{side} pad") for side in ("left", "right")],
        ["cube"],
        rigid=newton.solvers.SolverSemiImplicit(model, angular_damping=0.0),
        coupling=coupling,
        config=CONFIG,
    )
    states = [model.state(), model.state()]  # type: ignore[attr-defined]
    solver.reset(states[0])
    rows = []
    for after in squeezing(solver, states, round(end_s / dt_s), dt_s):
        rows.append(
            (after.body_q.numpy()[2, :3].copy(), after.body_qd.numpy()[2, :3].copy())
            + (solver.wrenches[2, :3].copy(), solver.wrenches[:2, :3].copy())
        )
    return Run(dt_s, *(np.array(column, dtype=np.float64) for column in zip(*rows, strict=True)))
