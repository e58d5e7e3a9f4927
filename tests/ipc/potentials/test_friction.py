# SPDX-License-Identifier: Apache-2.0
"""Friction against finite differences, Coulomb's law, rolling and spinning."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
import warp as wp

from taccel_lab.ipc.potentials.friction import step_motion
from taccel_lab.ipc.potentials.friction_change import add_friction_change
from taccel_lab.scene import Ball, KinematicBody, TriangleMesh, box_mesh
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.state import initial_state
from tests.ipc.derivatives import assert_derivatives
from tests.support.blocks import block_mesh, bumpy_body, everywhere, pose, scene
from tests.verification.assembly import Assembly

DHAT, EPS, MU = 3e-4, 2e-5, 0.7
STEP = 1e-9
MESH = block_mesh((2, 2, 1), (2e-3, 2e-3, 1e-3), jitter=0.2, seed=4)
RADIUS = 1.5e-3
BODIES: dict[str, tuple[TriangleMesh | Ball, np.ndarray]] = {
    "bumpy": (bumpy_body(1, 0.8e-3), pose(1e-4, -2e-4, 0.88e-3, (1, 2, 3), 40)),
    # The gel lies under one triangle of the plate, away from its diagonal.
    "plate": (box_mesh((12e-3, 12e-3, 1e-3)), pose(4e-3, -1e-3, 0.6e-3)),
    "ball": (Ball(RADIUS), pose(2e-4, -1e-4, RADIUS + 0.3 * DHAT)),
    # It lies on faces and edges of the gel, and nodes of the gel on it.
    "edge": (box_mesh((1e-3, 1e-3, 1e-3)), pose(1e-4, 2e-4, 0.95e-3, (1, 1, 0.2), 45)),
}


class Rubbing:
    """A gel frozen against a body, then moved; an environment for each probe of a coordinate, or
    as many as there are to be."""

    def __init__(self, name: str, turn_deg: float = 0.0, count: int = 0) -> None:
        shape, placed = BODIES[name]
        body_count = 1 if isinstance(shape, Ball) else len(shape.vertices_m)
        count = count or 6 * (MESH.node_count + body_count)
        model = scene(MESH, KinematicBody(shape, MU), env_count=count).finalize()
        before = everywhere(count, placed)
        config = SolverConfig(dhat_m=DHAT, friction_eps_m=EPS)
        self.assembly = Assembly(model, config, before)
        self.start = initial_state(model, before).positions.numpy()
        turned = pose(*placed[:3], (1, 2, 2), turn_deg) if turn_deg else placed
        self.poses = self.assembly.poses
        self.end_poses = wp.array(everywhere(count, turned), dtype=wp.transformd)
        assert self.assembly.collide(self.start) > 0
        assert self.assembly.solver.friction is not None
        self.friction = self.assembly.solver.friction
        dts = wp.full(count, model.scene.time.dt_s, dtype=wp.float64)
        self.friction.begin_step(wp.full(count, 1, dtype=wp.int32), dts, dts)
        self.freeze(self.start)

    def freeze(self, positions: np.ndarray) -> None:
        x, start = self.assembly.nodal(positions), self.assembly.nodal(self.start)
        self.friction.lag(self.assembly.active, x, start)

    def motion(self, positions: np.ndarray):
        return step_motion(
            self.friction.model,
            self.assembly.nodal(positions),
            self.assembly.nodal(self.start),
            self.end_poses,
            self.poses,
        )

    def energy(self, positions: np.ndarray) -> np.ndarray:
        return self.friction.energy(self.assembly.active, self.motion(positions))

    def gradient(self, positions: np.ndarray) -> np.ndarray:
        out = self.assembly.nodal()
        self.friction.add_gradient(self.assembly.active, self.motion(positions), out)
        return out.numpy()

    def same(self, x: np.ndarray) -> np.ndarray:
        return np.repeat(x[None], len(self.start), axis=0)


@lru_cache
def rubbing(name: str, turn_deg: float = 0.0) -> Rubbing:
    return Rubbing(name, turn_deg)


def slid(case: Rubbing, size: float) -> np.ndarray:
    """Positions after random sliding of about ``size`` [m]."""
    x = case.start[0]
    return x + np.random.default_rng(2).uniform(-size, size, x.shape)


# Sliding below and above eps, where friction is static and where it is sliding, and both at once.
@pytest.mark.parametrize("size", [0.2 * EPS, EPS, 5 * EPS])
@pytest.mark.parametrize(("name", "turn"), [("bumpy", 0.0), ("ball", 0.0), ("ball", 0.5)])
def test_gradient_and_hessian_are_the_derivatives(name: str, turn: float, size: float) -> None:
    case = rubbing(name, turn)
    x = slid(case, size)
    # The matrix leaves out subtracted duplicates, so that it stays positive.
    assembly, friction = case.assembly, case.friction
    signed = friction.frozen.mu_lambdas.numpy().copy()
    assert (signed < 0).any() == (name == "bumpy")
    friction.frozen.mu_lambdas.assign(np.maximum(signed, 0.0))
    motion = np.zeros_like(x)
    motion[MESH.node_count :] = np.random.default_rng(1).normal(size=(len(x) - MESH.node_count, 3))
    system = assembly.system(case.same(motion))
    friction.add_hessian(assembly.active, case.motion(case.same(x)), system)
    matrix, rhs = assembly.dense(system.values)[0], system.rhs.numpy()[0]
    least, within = (1e-5, 1e-1), (3e-6, 1e-5)
    change = assert_derivatives(
        x, assembly.free, STEP, case.energy, case.gradient, matrix, least, within
    )
    friction.frozen.mu_lambdas.assign(signed)
    expected = -np.einsum("ni,nifj->fj", motion, change)
    np.testing.assert_allclose(rhs, expected, atol=1e-5 * np.abs(expected).max())
    assert np.linalg.eigvalsh(matrix)[0] > -1e-12 * np.abs(matrix).max()


def test_a_flat_slide_has_coulomb_friction() -> None:
    case = rubbing("plate")
    normal = case.assembly.contact_gradient(case.start)[0, : MESH.node_count].sum(axis=0)
    direction = np.array([0.6, -0.8, 0.0])
    x = case.start[0].copy()
    x[: MESH.node_count] += 3 * EPS * direction
    drag = case.gradient(case.same(x))[0, : MESH.node_count].sum(axis=0)
    assert np.linalg.norm(normal) > 1e-3
    expected = MU * np.linalg.norm(normal) * direction
    np.testing.assert_allclose(drag, expected, atol=1e-10 * np.linalg.norm(expected))


def test_nothing_slides_when_all_move_together() -> None:
    case = rubbing("bumpy")
    x = case.start[0] + [1e-4, -2e-4, 5e-5]
    scale = np.abs(case.gradient(case.same(slid(case, EPS)))[0]).max()
    assert np.abs(case.gradient(case.same(x))[0]).max() < 1e-9 * scale


@pytest.mark.parametrize("name", ["bumpy", "plate", "ball"])
def test_friction_on_gel_and_body_balance(name: str) -> None:
    case = rubbing(name)
    gradient = case.gradient(case.same(slid(case, EPS)))[0]
    on_gel, on_body = gradient[: MESH.node_count], gradient[MESH.node_count :]
    scale = np.abs(gradient).sum()
    assert np.linalg.norm(on_gel.sum(axis=0)) > 1e-3 * scale
    np.testing.assert_allclose(on_gel.sum(axis=0), -on_body.sum(axis=0), atol=1e-14 * scale)


def _drag_of_ball(shift: np.ndarray, axis: tuple[float, float, float], deg: float) -> np.ndarray:
    """Friction force on the gel [N] after a ball has moved and turned."""
    case = Rubbing("ball")
    placed = BODIES["ball"][1]
    moved = pose(*(placed[:3] + shift), axis, deg)
    case.end_poses = wp.array(everywhere(len(case.start), moved), dtype=wp.transformd)
    x = case.start[0].copy()
    x[MESH.node_count :] += shift
    return -case.gradient(case.same(x))[0, : MESH.node_count].sum(axis=0)


def test_a_rolling_ball_does_not_drag_and_a_spinning_one_does() -> None:
    deg = 0.05
    turn = np.deg2rad(deg)
    gap = 0.3 * DHAT
    # Turning about +y moves the lowest point of the ball towards -x.
    rolling = _drag_of_ball(np.array([RADIUS * turn, 0, 0]), (0, 1, 0), deg)
    spinning = _drag_of_ball(np.zeros(3), (0, 1, 0), deg)
    sliding = _drag_of_ball(np.array([-RADIUS * turn, 0, 0]), (0, 1, 0), 0.0)
    assert RADIUS * turn < EPS, "static friction is proportional to sliding"
    assert spinning[0] < 0
    # All faces in reach count, so that the drag is not that of the lowest point alone.
    np.testing.assert_allclose(spinning, sliding, rtol=0.15, atol=0.05 * abs(sliding[0]))
    assert np.linalg.norm(rolling) < 0.15 * np.linalg.norm(sliding), f"gap {gap}"


DIRECTIONS = 6


@pytest.mark.parametrize("size", [0.2 * EPS, 5 * EPS])
@pytest.mark.parametrize("name", ["bumpy", "edge", "ball"])
def test_frozen_anew_everywhere_it_changes_by_what_the_hessian_leaves_out(
    name: str, size: float
) -> None:
    case, step = Rubbing(name, count=2 * DIRECTIONS), 1e-10
    active, rng = case.assembly.active, np.random.default_rng(2)
    x = case.start[0] + rng.uniform(-size, size, case.start[0].shape)
    ways = np.repeat(rng.uniform(-1.0, 1.0, (DIRECTIONS, *x.shape)), 2, axis=0)
    signs = np.tile([1.0, -1.0], DIRECTIONS)[:, None, None]

    def difference(step: float) -> np.ndarray:
        """Along each direction, [direction, node, 3]."""
        forces = case.gradient(x + step * signs * ways)
        return (forces[::2] - forces[1::2]) / (2 * step)

    assert case.assembly.collide(case.same(x)) > 0
    case.freeze(x + step * signs * ways)
    whole = difference(step)
    case.freeze(case.same(x))
    mu_lambdas = case.friction.frozen.mu_lambdas
    signed = mu_lambdas.numpy().copy()
    mu_lambdas.assign(np.maximum(signed, 0.0))
    left_out = whole - difference(1e-9)
    mu_lambdas.assign(signed)
    found, sharpness = case.assembly.nodal(), wp.full(len(signs), 1.0, dtype=wp.float64)
    motion = case.motion(case.same(x))
    add_friction_change(case.friction, active, motion, sharpness, case.assembly.nodal(ways), found)
    scale = np.abs(left_out).max()
    assert scale > 0.01 * np.abs(whole).max()
    np.testing.assert_allclose(found.numpy()[::2], left_out, atol=1e-3 * scale)
