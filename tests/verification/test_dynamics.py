# SPDX-License-Identifier: Apache-2.0
"""Implicit Euler against closed forms: free fall, rest, sticking and sliding on a slope."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from taccel_lab.geometry import Region, TetMesh
from taccel_lab.ipc.intersection import find_intersections
from taccel_lab.model import Model
from taccel_lab.scene import KinematicBody, TimeStepping, box_mesh
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.solvers.report import StepReport
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.state import State, initial_state
from tests.support.blocks import block_mesh, everywhere, pose, scene

G = 9.81
SIDE = 4e-3
DT = 2e-3
DHAT = 1e-5
EPS = 1e-6
NOT_BONDED = np.array([], dtype=np.int64)


def free_block() -> TetMesh:
    """A cube all of whose faces can touch something."""
    mesh = block_mesh((2, 2, 2), (SIDE, SIDE, SIDE))
    return TetMesh(mesh.nodes_m, mesh.tets, mesh.faces, np.full(len(mesh.faces), int(Region.SIDE)))


@dataclass
class Run:
    """A block on its way; forces on it in units of its weight."""

    model: Model
    solver: SolverIPC
    state: State

    @property
    def positions(self) -> np.ndarray:
        return self.state.positions.numpy()[0, : self.model.soft_count]

    @property
    def velocity(self) -> np.ndarray:
        masses = self.model.masses.numpy()[0, : self.model.soft_count]
        velocities = self.state.velocities.numpy()[0, : self.model.soft_count]
        return masses @ velocities / masses.sum()

    def step(self) -> StepReport:
        report = self.solver.step(self.state)
        assert report.converged.all(), report.summary()
        assert find_intersections(self.model, self.state) == [[]]
        return report

    def force(self, which: str) -> np.ndarray:
        gradient = getattr(self.solver, f"{which}_gradient").numpy()[0, : self.model.soft_count]
        weight = self.model.masses.numpy()[0].sum() * G
        return -gradient.sum(axis=0) / weight


def block_on_floor(slope: float, mu: float, height: float) -> Run:
    """A stiff block ``height`` [m] over a floor; gravity leans by the angle atan(slope)."""
    angle = np.arctan(slope)
    gravity = (G * np.sin(angle), 0.0, -G * np.cos(angle))
    stepping = TimeStepping(quasi_static=False, dt_s=DT, gravity_m_s2=gravity)
    # The block is over one triangle of the floor, away from the floor's diagonal.
    floor = KinematicBody(box_mesh((0.2, 0.2, 0.02)), mu, name="floor")
    made = scene(
        free_block(), floor, young_pa=1e6, poisson=0.3, time=stepping, bonded=NOT_BONDED
    ).finalize()
    config = SolverConfig(
        dhat_m=DHAT,
        friction_speed_m_s=EPS / DT,
        relative_tolerance=1e-5,
        absolute_tolerance_n=1e-10,
    )
    placed = everywhere(1, pose(0.05, -0.01, -0.01 - SIDE - height))
    return Run(made, SolverIPC(made, config), initial_state(made, placed))


def test_free_fall_is_the_sum_of_implicit_euler() -> None:
    """v_n = n dt g and x_n = dt^2 g n (n + 1) / 2, exactly, and the block stays as it is."""
    gravity = np.array([1.0, -2.0, -G])
    stepping = TimeStepping(quasi_static=False, dt_s=0.01, gravity_m_s2=tuple(gravity))
    model = scene(free_block(), time=stepping, bonded=NOT_BONDED).finalize()
    run = Run(
        model,
        SolverIPC(model, SolverConfig(absolute_tolerance_n=1e-13)),
        initial_state(model, np.zeros((1, 0, 7))),
    )
    start = run.positions.copy()
    for n in range(1, 6):
        run.step()
        velocities = run.state.velocities.numpy()[0]
        expected = np.broadcast_to(n * 0.01 * gravity, velocities.shape)
        np.testing.assert_allclose(velocities, expected, rtol=1e-9)
        fall = 0.01**2 * gravity * n * (n + 1) / 2
        np.testing.assert_allclose(
            run.positions - start, np.broadcast_to(fall, start.shape), rtol=1e-9
        )


def test_momentum_is_kept_without_outer_forces() -> None:
    """A spinning, vibrating block: linear momentum exactly, energy never grows."""
    stepping = TimeStepping(quasi_static=False, dt_s=1e-3)
    model = scene(free_block(), time=stepping, bonded=NOT_BONDED).finalize()
    run = Run(
        model,
        SolverIPC(model, SolverConfig(absolute_tolerance_n=3e-9)),
        initial_state(model, np.zeros((1, 0, 7))),
    )
    rng = np.random.default_rng(0)
    spin = np.cross([20.0, 0, 40.0], run.positions - run.positions.mean(axis=0))
    run.state.velocities.assign((spin + rng.normal(size=spin.shape) * 0.02 + [0.1, 0, 0])[None])
    masses = model.masses.numpy()[0]
    start = run.velocity.copy()

    def energy() -> float:
        speed_sq = (run.state.velocities.numpy()[0] ** 2).sum(axis=1)
        elastic = run.solver.elastic[0].energy(run.solver.active, run.state.positions)[0]
        return 0.5 * masses @ speed_sq + elastic

    last = energy()
    for _ in range(10):
        run.solver.active.fill_(1)
        run.step()
        run.solver.active.fill_(1)
        np.testing.assert_allclose(run.velocity, start, rtol=0, atol=1e-6)
        now = energy()
        assert now <= last * (1 + 1e-9)
        last = now


def test_a_falling_block_comes_to_rest_on_the_floor() -> None:
    run = block_on_floor(slope=0.0, mu=0.0, height=2e-3)
    seen_flying = False
    for _ in range(40):
        run.step()
        seen_flying |= not run.force("contact").any()
    assert seen_flying
    assert np.abs(run.velocity).max() < 1e-8
    np.testing.assert_allclose(run.force("contact"), [0, 0, 1], atol=1e-4)
    gap = run.positions[:, 2].min() - (-SIDE - 2e-3)
    assert 0.5 * DHAT < gap < DHAT


@pytest.mark.parametrize("slope", [0.2, 0.4, 0.49])
def test_a_block_sticks_below_the_friction_angle(slope: float) -> None:
    """It creeps by less than eps a step, and friction holds its weight: m g sin(angle)."""
    mu = 0.5
    run = block_on_floor(slope, mu, height=0.5 * DHAT)
    for _ in range(20):
        run.step()
    before = run.positions.copy()
    run.step()
    creep = np.linalg.norm((run.positions - before)[:, :2], axis=1)
    assert creep.max() <= 1.1 * EPS
    # Static friction is mu N (2 y - y^2) at a creep of y eps.
    assert creep.mean() == pytest.approx((1 - np.sqrt(1 - slope / mu)) * EPS, rel=1e-3)
    angle = np.arctan(slope)
    friction, normal = run.force("friction"), run.force("contact")
    assert friction[0] == pytest.approx(-np.sin(angle), rel=1e-3)
    assert normal[2] == pytest.approx(np.cos(angle), rel=1e-3)
    assert np.abs([*normal[:2], friction[1], friction[2]]).max() < 1e-5


@pytest.mark.parametrize(("slope", "mu"), [(0.51, 0.5), (0.6, 0.5), (0.3, 0.0), (1.0, 0.2)])
def test_a_block_slides_beyond_the_friction_angle(slope: float, mu: float) -> None:
    """a = g (sin - mu cos)."""
    run = block_on_floor(slope, mu, height=0.5 * DHAT)
    for _ in range(15):
        run.step()
    early = run.velocity
    for _ in range(5):
        run.step()
    angle = np.arctan(slope)
    acceleration = (run.velocity - early) / (5 * DT)
    expected = G * (np.sin(angle) - mu * np.cos(angle))
    assert acceleration[0] == pytest.approx(expected, rel=1e-3)
    assert np.abs(acceleration[1:]).max() < 1e-3 * G
    if mu > 0:
        assert -run.force("friction")[0] == pytest.approx(mu * np.cos(angle), rel=1e-3)
