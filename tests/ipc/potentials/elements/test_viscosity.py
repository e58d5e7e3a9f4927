# SPDX-License-Identifier: Apache-2.0
"""Damping: derivatives, what it must not resist, and the decay it must give."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from taccel_lab.geometry import TetMesh
from taccel_lab.ipc.elasticity.principal import PSD_CLAMP, PSD_NONE
from taccel_lab.ipc.potentials.elements.viscosity import ViscousPotential
from taccel_lab.model import Model
from taccel_lab.scene import (
    Ball,
    Element,
    KinematicBody,
    Material,
    Scene,
    SoftBody,
    TimeStepping,
)
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.state import initial_state
from tests.ipc.derivatives import assert_derivatives, assert_momenta_are_kept
from tests.support.blocks import block_mesh, everywhere, pose
from tests.support.turns import random_turns, strained
from tests.verification.elements import ElementForces

SIZE = (2e-3, 2e-3, 1e-3)
YOUNG, NU, TAU, DT = 1e5, 0.4, 0.03, 0.01
MESH = block_mesh((1, 1, 1), SIZE, jitter=0.2)
FINER = block_mesh((2, 2, 1), SIZE, jitter=0.2)
KINDS = list(Element)


def damped(
    element: Element = Element.LINEAR,
    env_count: int = 1,
    tau: float = TAU,
    density: float = 1000.0,
    mesh: TetMesh = MESH,
) -> Model:
    material = Material(YOUNG, NU, density, damping_time_s=tau)
    time = TimeStepping(quasi_static=False, dt_s=DT)
    return Scene(SoftBody(mesh, material, element=element), (), env_count, time).finalize()


def viscous(model: Model, start: np.ndarray) -> ElementForces:
    """The damping alone of a step that began at ``start`` [node, 3]."""
    part = ViscousPotential(model, model.elastic[0])
    made = ElementForces(model, [part])
    part.begin_step(made.nodal(np.repeat(start[None], model.env_count, axis=0)))
    return made


def moved(model: Model, seed: int, amount: float = 5e-5) -> np.ndarray:
    return strained(model.rest_positions.numpy()[0], seed, amount)


@pytest.mark.parametrize("element", KINDS)
def test_gradient_and_hessian_are_the_derivatives(element: Element) -> None:
    count = 6 * damped(element).node_count
    model = damped(element, count)
    x, made = moved(model, 1), viscous(model, moved(model, 2))
    matrix = made.hessian(np.repeat(x[None], count, axis=0), PSD_NONE)[0]
    assert_derivatives(x, made.free, 1e-8, made.energy, made.gradient, matrix, (1e-3, 0))


@pytest.mark.parametrize("element", KINDS)
def test_projected_matrix_is_positive(element: Element) -> None:
    model = damped(element, mesh=FINER)
    made = viscous(model, moved(model, 2))
    crushed = 0.4 * moved(model, 1)[None]
    matrix = made.hessian(crushed, PSD_NONE)[0]
    scale = np.abs(matrix).max()
    assert np.linalg.eigvalsh(matrix)[0] < -1e-2 * scale
    lifted = made.hessian(crushed, PSD_CLAMP)[0]
    assert np.linalg.eigvalsh(lifted)[0] > 0
    assert np.linalg.eigvalsh(lifted - matrix)[0] > -1e-12 * scale


@pytest.mark.parametrize("element", KINDS)
def test_rigid_motion_is_free_and_momenta_are_kept(element: Element) -> None:
    model = damped(element)
    start, other = moved(model, 3), moved(model, 4)
    made = viscous(model, start)
    turn = random_turns(5, 1)[0]
    rigid = (start @ turn.T + [1e-2, 0, 2e-2])[None]
    forces = made.gradient(other[None])[0]
    scale = np.abs(forces).sum()
    assert made.energy(rigid)[0] < 1e-20
    assert np.abs(made.gradient(rigid)).max() < 1e-11 * scale
    assert_momenta_are_kept(other, forces)


@pytest.mark.parametrize("element", KINDS)
def test_small_strains_see_rayleigh_damping(element: Element) -> None:
    """Force tau / dt K (x - x_n)."""
    model = damped(element)
    rest = model.rest_positions.numpy()[0]
    made, elastic = viscous(model, rest), ElementForces(model)
    change = np.zeros_like(rest)
    change[made.free] = np.random.default_rng(6).normal(size=(len(made.free), 3)) * 1e-11
    stiffness = elastic.hessian(rest[None], PSD_NONE)[0]
    expected = TAU / DT * stiffness @ change[made.free].ravel()
    found = made.gradient((rest + change)[None])[0][made.free].ravel()
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())


def test_environments_may_take_steps_of_their_own_length() -> None:
    """Half the time, twice the stress; the other environment is as before."""
    model = damped(env_count=2)
    x = np.repeat(moved(model, 1)[None], 2, axis=0)
    made = viscous(model, moved(model, 2))
    before = made.gradient(x)
    part = made.parts[0]
    assert isinstance(part, ViscousPotential)
    start = made.nodal(np.repeat(moved(model, 2)[None], 2, axis=0))
    part.begin_step(start, wp.array([DT, DT / 2], dtype=wp.float64))
    np.testing.assert_allclose(made.gradient(x)[0], before[0], rtol=1e-14)
    np.testing.assert_allclose(made.gradient(x)[1], 2 * before[1], rtol=1e-14)


def test_only_damped_bodies_are_in_a_damped_group() -> None:
    bodies = [
        SoftBody(MESH, Material(YOUNG, NU, damping_time_s=tau), name=str(i), element=Element.LINEAR)
        for i, tau in enumerate((0.1, 0.0, 0.3))
    ]
    model = Scene(bodies, time=TimeStepping(quasi_static=False, dt_s=DT)).finalize()
    assert [(g.damped, [b for b, _, _ in g.bodies]) for g in model.elastic] == [
        (True, [0, 2]),
        (False, [1]),
    ]
    times = model.elastic[0].damping_times.numpy()
    np.testing.assert_array_equal(times, np.repeat([0.1, 0.3], MESH.tet_count))


def test_strain_creeps_back_at_the_damping_time() -> None:
    """Without mass K (x + tau v) = 0: implicit Euler shrinks a strain by 1 + dt / tau a step."""
    model = damped(density=1.0, mesh=FINER)
    solver = SolverIPC(model, SolverConfig(absolute_tolerance_n=1e-12))
    state = initial_state(model, np.zeros((1, 0, 7)))
    rest = FINER.nodes_m
    height = rest[:, 2:] - rest[:, 2].min()
    state.positions = wp.array((rest + 1e-6 * height)[None], dtype=wp.vec3d)
    # The first steps choose the free shape, in which all strains then shrink together.
    sizes = []
    for _ in range(6):
        report = solver.step(state)
        assert report.converged.all(), report.summary()
        sizes.append(np.abs(state.positions.numpy()[0] - rest).max())
    ratios = np.array(sizes[1:]) / np.array(sizes[:-1])
    np.testing.assert_allclose(ratios, 1 / (1 + DT / TAU), rtol=1e-3)


# With friction the settled force remembers the path, which damping changes.
@pytest.mark.parametrize(("friction", "tolerance"), [(0.0, 1e-3), (0.4, 0.03)])
def test_a_damped_press_converges(friction: float, tolerance: float) -> None:
    mesh = block_mesh((5, 5, 3), (5e-3, 5e-3, 2.4e-3), jitter=0.15)
    forces = []
    for tau in (0.0, 0.06):
        soft = SoftBody(mesh, Material(YOUNG, NU, damping_time_s=tau), element=Element.LINEAR)
        time = TimeStepping(quasi_static=False, dt_s=DT)
        model = Scene(soft, (KinematicBody(Ball(1.5e-3), friction),), time=time).finalize()
        solver = SolverIPC(model)
        state = initial_state(model, everywhere(1, pose(0, 0, 1.55e-3)))
        for x, z in ((0, 1.45e-3), (0, 1.3e-3), (1e-4, 1.3e-3)):
            report = solver.step(state, everywhere(1, pose(x, 0, z)))
            assert report.converged.all(), report.summary()
        forces.append(solver.contact_gradient.numpy()[0, : mesh.node_count, 2].sum())
        for _ in range(60):
            report = solver.step(state)
            assert report.converged.all(), report.summary()
        forces.append(solver.contact_gradient.numpy()[0, : mesh.node_count, 2].sum())
    undamped, settled, damped_force, damped_settled = forces
    # It resists the motion, and nothing once that is over.
    assert damped_force > 1.2 * undamped
    assert damped_settled == pytest.approx(settled, rel=tolerance)
