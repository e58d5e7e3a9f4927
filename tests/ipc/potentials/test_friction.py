# SPDX-License-Identifier: Apache-2.0
"""Lagged friction against finite differences, Coulomb's law, rolling and spinning; what brought two
bodies together is no sliding."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
import warp as wp

from taccel_lab.geometry import TetMesh
from taccel_lab.ipc.potentials.friction import step_motion
from taccel_lab.presses import parse_indenter
from taccel_lab.scene import Ball, KinematicBody, TriangleMesh, box_mesh
from taccel_lab.solvers import SolverConfig
from taccel_lab.state import initial_state
from tests.ipc.derivatives import assert_derivatives, assert_semidefinite
from tests.support.blocks import block_mesh, bumpy_body, everywhere, pose, scene
from tests.verification.assembly import Assembly

EPS, MU = 2e-5, 0.7
COARSE = SolverConfig(dhat_m=3e-4, friction_eps_m=EPS)
MESH = block_mesh((2, 2, 1), (2e-3, 2e-3, 1e-3), jitter=0.2, seed=4)
GEL = slice(0, MESH.node_count)
RADIUS = 1.5e-3
BODIES: dict[str, tuple[TriangleMesh | Ball, np.ndarray]] = {
    "bumpy": (bumpy_body(1, 0.8e-3), pose(1e-4, -2e-4, 0.88e-3, (1, 2, 3), 40)),
    # The gel lies under one triangle of the plate, away from its diagonal.
    "plate": (box_mesh((12e-3, 12e-3, 1e-3)), pose(4e-3, -1e-3, 0.6e-3)),
    "ball": (Ball(RADIUS), pose(2e-4, -1e-4, RADIUS + 0.3 * 3e-4)),
    # It lies on faces and edges of the gel, and nodes of the gel on it.
    "edge": (box_mesh((1e-3, 1e-3, 1e-3)), pose(1e-4, 2e-4, 0.95e-3, (1, 1, 0.2), 45)),
}


class Rubbing:
    """A gel frozen against a body that came from another pose; an environment for each probe."""

    def __init__(
        self,
        shape: TriangleMesh | Ball,
        before: np.ndarray,
        after: np.ndarray,
        count: int = 0,
        mesh: TetMesh = MESH,
        config: SolverConfig = COARSE,
    ) -> None:
        body_count = 1 if isinstance(shape, Ball) else len(shape.vertices_m)
        self.count = count or 6 * (mesh.node_count + body_count)
        model = scene(mesh, KinematicBody(shape, MU), env_count=self.count).finalize()
        starts, ends = everywhere(self.count, before), everywhere(self.count, after)
        self.assembly = Assembly(model, config, ends)
        self.active = self.assembly.active
        self.poses = wp.array(starts, dtype=wp.transformd)
        self.end_poses = self.assembly.poses
        self.start = initial_state(model, starts).positions.numpy()
        self.now = initial_state(model, ends).positions.numpy()
        assert self.assembly.collide(self.now) > 0 and self.assembly.solver.friction
        self.friction = self.assembly.solver.friction
        dts = wp.full(self.count, model.scene.time.dt_s, dtype=wp.float64)
        self.friction.begin_step(self.active, dts, dts)
        self.freeze(self.now)

    def freeze(self, positions: np.ndarray) -> None:
        x, start = self.assembly.nodal(positions), self.assembly.nodal(self.start)
        self.friction.lag(self.active, x, start)

    def motion(self, positions: np.ndarray):
        x, start = self.assembly.nodal(positions), self.assembly.nodal(self.start)
        return step_motion(self.friction.model, x, start, self.end_poses, self.poses)

    def energy(self, positions: np.ndarray) -> np.ndarray:
        return self.friction.energy(self.active, self.motion(positions))

    def gradient(self, positions: np.ndarray) -> np.ndarray:
        out = self.assembly.nodal()
        self.friction.add_gradient(self.active, self.motion(positions), out)
        return out.numpy()

    def at(self, x: np.ndarray) -> np.ndarray:
        return self.gradient(self.same(x))[0]

    def same(self, x: np.ndarray) -> np.ndarray:
        return np.repeat(x[None], self.count, axis=0)

    def slid(self, size: float) -> np.ndarray:
        x = self.start[0]
        return x + np.random.default_rng(2).uniform(-size, size, x.shape)


@lru_cache
def rubbing(name: str, turn_deg: float, count: int = 0) -> Rubbing:
    shape, placed = BODIES[name]
    turned = pose(*placed[:3], (1, 2, 2), turn_deg) if turn_deg else placed
    return Rubbing(shape, placed, turned, count)


# Sliding below and above eps, where friction is static and where it is sliding, and both at once.
@pytest.mark.parametrize("size", [0.2 * EPS, EPS, 5 * EPS])
@pytest.mark.parametrize(("name", "turn"), [("bumpy", 0.0), ("ball", 0.0), ("ball", 0.5)])
def test_gradient_and_hessian_are_the_derivatives(name: str, turn: float, size: float) -> None:
    case = rubbing(name, turn)
    x, assembly, mu_lambdas = case.slid(size), case.assembly, case.friction.frozen.mu_lambdas
    # The matrix leaves out subtracted duplicates, so that it stays positive.
    signed = mu_lambdas.numpy().copy()
    assert (signed < 0).any() == (name == "bumpy")
    mu_lambdas.assign(np.maximum(signed, 0.0))
    motion = np.zeros_like(x)
    motion[MESH.node_count :] = np.random.default_rng(1).normal(size=(len(x) - MESH.node_count, 3))
    system = assembly.system(case.same(motion))
    case.friction.add_hessian(case.active, case.motion(case.same(x)), system)
    matrix, rhs = assembly.dense(system.values)[0], system.rhs.numpy()[0]
    least, within = (1e-5, 1e-1), (3e-6, 1e-5)
    change = assert_derivatives(
        x, 1e-9, case.energy, case.gradient, matrix, assembly.free, least, within
    )
    mu_lambdas.assign(signed)
    expected = -np.einsum("ni,nifj->fj", motion, change)
    np.testing.assert_allclose(rhs, expected, atol=1e-5 * np.abs(expected).max())
    assert_semidefinite(matrix)


def test_a_flat_slide_has_coulomb_friction() -> None:
    case = rubbing("plate", 0.0)
    normal = np.linalg.norm(case.assembly.contact_gradient(case.start)[0, GEL].sum(axis=0))
    direction = np.array([0.6, -0.8, 0.0])
    x = case.start[0].copy()
    x[GEL] += 3 * EPS * direction
    assert normal > 1e-3
    drag = case.at(x)[GEL].sum(axis=0)
    np.testing.assert_allclose(drag, MU * normal * direction, atol=1e-10 * MU * normal)


@pytest.mark.parametrize("name", ["bumpy", "plate", "ball"])
def test_friction_on_gel_and_body_balance(name: str) -> None:
    case = rubbing(name, 0.0)
    gradient = case.at(case.slid(EPS))
    on_gel, on_body = gradient[GEL].sum(axis=0), gradient[MESH.node_count :].sum(axis=0)
    scale = np.abs(gradient).sum()
    assert np.linalg.norm(on_gel) > 1e-3 * scale
    np.testing.assert_allclose(on_gel, -on_body, atol=1e-14 * scale)
    # Nothing slides when all move together.
    together = case.at(case.start[0] + [1e-4, -2e-4, 5e-5])
    assert name == "ball" or np.abs(together).max() < 1e-9 * np.abs(gradient).max()


def test_a_rolling_ball_does_not_drag_and_a_spinning_one_does() -> None:
    case, (_, placed) = rubbing("ball", 0.0, 1), BODIES["ball"]
    ends, turn = case.end_poses, np.deg2rad(0.05)

    def drag(shift_m: float, deg: float) -> np.ndarray:
        """Friction force on the gel [N] after the ball has moved along x and turned about y."""
        moved = pose(placed[0] + shift_m, *placed[1:3], (0, 1, 0), deg)
        case.end_poses = wp.array(everywhere(1, moved), dtype=wp.transformd)
        x = case.start[0].copy()
        x[MESH.node_count :, 0] += shift_m
        return -case.at(x)[GEL].sum(axis=0)

    # Turning about +y moves the lowest point of the ball towards -x.
    rolling, spinning = drag(RADIUS * turn, 0.05), drag(0.0, 0.05)
    sliding = drag(-RADIUS * turn, 0.0)
    case.end_poses = ends
    assert RADIUS * turn < EPS, "static friction is proportional to sliding"
    assert spinning[0] < 0
    # All faces in reach count, so that the drag is not that of the lowest point alone.
    np.testing.assert_allclose(spinning, sliding, rtol=0.15, atol=0.05 * abs(sliding[0]))
    assert np.linalg.norm(rolling) < 0.15 * np.linalg.norm(sliding)


def friction_over_normal(shape: TriangleMesh, aside: float) -> np.ndarray:
    """Friction over mu times the normal force after a body came straight down, and aside [um]."""
    low = float(shape.vertices_m[:, 2].min())
    before, after = pose(0, 0, 60e-6 - low), pose(1e-6 * aside, 0, 5e-6 - low)
    flat = block_mesh((2, 2, 1), (2e-3, 2e-3, 1e-3))
    case = Rubbing(shape, before, after, 1, flat, SolverConfig(dhat_m=1e-5, friction_eps_m=1e-6))
    gel = slice(0, flat.node_count)
    normal = np.linalg.norm(case.assembly.contact_gradient(case.now)[0, gel], axis=1).sum()
    return -case.at(case.now[0])[gel].sum(axis=0) / (MU * normal)


def test_a_body_that_comes_straight_down_has_slid_by_what_it_went_aside() -> None:
    """Against the tilted normals of a blade the 55 um of its way down would be sliding of 3 um."""
    blade, expected = parse_indenter("edge:90x4").shape, 0.3 * (2 - 0.3)
    assert isinstance(blade, TriangleMesh)
    for sign in (1, -1):
        assert friction_over_normal(blade, sign * 0.3)[0] == pytest.approx(sign * expected, rel=0.1)
    plate = friction_over_normal(box_mesh((6e-3, 6e-3, 1e-3)), 0.3)
    assert plate == pytest.approx([expected, 0, 0], abs=1e-3)


def test_friction_does_not_jump_where_a_node_slides_over_a_rim() -> None:
    """The plate comes 0.5 um nearer, and 20 um aside: nodes under it end right below its rim."""
    plate, flat = box_mesh((6e-3, 6e-3, 1e-3)), block_mesh((2, 2, 1), (2e-3, 2e-3, 1e-3))
    height = 0.5e-3 + 2e-5
    config, forces = SolverConfig(dhat_m=3e-4, friction_eps_m=10 * EPS), []
    for beyond in (-1e-8, 1e-8):
        before, after = (
            pose(-3e-3 - beyond + 2e-5, 1e-4, height + 5e-7),
            pose(-3e-3 - beyond, 1e-4, height),
        )
        case = Rubbing(plate, before, after, 1, flat, config)
        forces.append(case.at(case.now[0])[: flat.node_count].sum(axis=0))
    assert np.linalg.norm(forces[0]) > 0
    np.testing.assert_allclose(*forces, rtol=0, atol=3e-3 * np.linalg.norm(forces[0]))
