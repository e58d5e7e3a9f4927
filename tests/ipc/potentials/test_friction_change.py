# SPDX-License-Identifier: Apache-2.0
"""The derivative of friction that is frozen anew everywhere, against finite differences."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from taccel_lab.ipc.potentials.friction_change import add_friction_change
from taccel_lab.scene import Ball, KinematicBody, TriangleMesh, box_mesh
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.state import initial_state
from tests.support.blocks import block_mesh, bumpy_body, everywhere, pose, scene
from tests.verification.assembly import Assembly

DHAT, EPS, MU = 3e-4, 2e-5, 0.7
MESH = block_mesh((2, 2, 1), (2e-3, 2e-3, 1e-3), jitter=0.2, seed=4)
BODIES: dict[str, tuple[TriangleMesh | Ball, np.ndarray]] = {
    # Edges and corners of it lie on faces and edges of the gel, and nodes of the gel on its edges.
    "bumpy": (bumpy_body(1, 0.8e-3), pose(1e-4, -2e-4, 0.88e-3, (1, 2, 3), 40)),
    "edge": (box_mesh((1e-3, 1e-3, 1e-3)), pose(1e-4, 2e-4, 0.95e-3, (1, 1, 0.2), 45)),
    "ball": (Ball(1.5e-3), pose(2e-4, -1e-4, 1.5e-3 + 0.3 * DHAT)),
}
DIRECTIONS = 6


class Moved:
    """A gel that has slid against a body, with two environments for each direction."""

    def __init__(self, name: str, size: float) -> None:
        shape, placed = BODIES[name]
        count = 2 * DIRECTIONS
        model = scene(MESH, KinematicBody(shape, MU), env_count=count).finalize()
        before = everywhere(count, placed)
        config = SolverConfig(dhat_m=DHAT, friction_eps_m=EPS)
        self.assembly = Assembly(model, config, before)
        start = initial_state(model, before).positions.numpy()
        self.start = self.assembly.nodal(start)
        rng = np.random.default_rng(2)
        self.x = start[0] + rng.uniform(-size, size, start[0].shape)
        self.ways = rng.uniform(-1.0, 1.0, (DIRECTIONS, *start[0].shape))
        assert self.assembly.collide(np.repeat(self.x[None], count, axis=0)) > 0
        assert self.assembly.solver.friction is not None
        self.friction = self.assembly.solver.friction
        dts = wp.full(count, model.scene.time.dt_s, dtype=wp.float64)
        self.friction.begin_step(wp.full(count, 1, dtype=wp.int32), dts, dts)

    def probe(self, step: float) -> wp.array:
        """Each direction there and back."""
        signs = np.tile([1.0, -1.0], DIRECTIONS)[:, None, None]
        return self.assembly.nodal(self.x + step * signs * np.repeat(self.ways, 2, axis=0))

    def motion(self, positions: wp.array):
        poses = self.assembly.poses
        return self.friction.motion(positions, self.start, poses, poses)

    def freeze(self, positions: wp.array) -> None:
        self.friction.lag(self.assembly.active, positions, self.start)

    def difference(self, step: float) -> np.ndarray:
        """Central differences of friction as it is frozen, [direction, node, 3]."""
        out = self.assembly.nodal()
        self.friction.add_gradient(self.assembly.active, self.motion(self.probe(step)), out)
        forces = out.numpy()
        return (forces[::2] - forces[1::2]) / (2 * step)


@pytest.mark.parametrize("size", [0.2 * EPS, 5 * EPS])
@pytest.mark.parametrize("name", BODIES)
def test_the_change_is_what_the_frozen_hessian_leaves_out(name: str, size: float) -> None:
    case, step = Moved(name, size), 1e-10
    case.freeze(case.probe(step))
    whole = case.difference(step)
    here = case.probe(0.0)
    case.freeze(here)
    mu_lambdas = case.friction.frozen.mu_lambdas
    signed = mu_lambdas.numpy().copy()
    mu_lambdas.assign(np.maximum(signed, 0.0))
    frozen = case.difference(1e-9)
    mu_lambdas.assign(signed)
    ways = case.assembly.nodal(np.repeat(case.ways, 2, axis=0))
    found = case.assembly.nodal()
    sharpness = wp.full(2 * DIRECTIONS, 1.0, dtype=wp.float64)
    active, motion = case.assembly.active, case.motion(here)
    add_friction_change(case.friction, active, motion, sharpness, ways, found)
    left_out = whole - frozen
    scale = np.abs(left_out).max()
    assert scale > 0.01 * np.abs(whole).max()
    np.testing.assert_allclose(found.numpy()[::2], left_out, atol=1e-3 * scale)
