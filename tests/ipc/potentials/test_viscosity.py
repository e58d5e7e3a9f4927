# SPDX-License-Identifier: Apache-2.0
"""Damping: derivatives, what it must not resist, and the decay it must give."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.ipc.elasticity.principal import PSD_ABS, PSD_CLAMP, PSD_NONE
from taccel_lab.ipc.potentials.viscosity import ViscousPotential
from taccel_lab.scene import (
    Ball,
    KinematicBody,
    Material,
    MaterialField,
    Scene,
    SoftBody,
    TimeStepping,
)
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.state import initial_state
from tests.verification.assembly import Assembly, central_difference, coordinate_probe
from tests.verification.blocks import block_mesh, everywhere, pose

SIZE = (2e-3, 2e-3, 1e-3)
YOUNG, NU, TAU, DT = 1e5, 0.4, 0.03, 0.01
MESH = block_mesh((2, 2, 1), SIZE, jitter=0.2)


def damped(
    env_count: int = 1, tau: float = TAU, density: float = 1000.0, free: bool = False
) -> Assembly:
    material = Material(YOUNG, NU, density, damping_time_s=tau)
    body = SoftBody(MESH, material, np.zeros(0, dtype=np.int64) if free else None)
    made = Scene(body, (), env_count, TimeStepping(quasi_static=False, dt_s=DT))
    return Assembly(made.finalize(), SolverConfig(), np.zeros((env_count, 0, 7)))


def viscosity(assembly: Assembly, start: np.ndarray) -> ViscousPotential:
    made = assembly.solver.viscosity
    assert made is not None
    made.begin_step(assembly.nodal(np.repeat(start[None], assembly.model.env_count, axis=0)))
    return made


def gradient(assembly: Assembly, made: ViscousPotential, positions: np.ndarray) -> np.ndarray:
    out = assembly.nodal()
    made.add_gradient(assembly.active, assembly.nodal(positions), out)
    return out.numpy()


def hessian(
    assembly: Assembly, made: ViscousPotential, positions: np.ndarray, mode: int
) -> np.ndarray:
    values = assembly.solver.linear.values
    values.zero_()
    made.add_hessian(assembly.active, assembly.nodal(positions), values, mode)
    return assembly.dense(values)[0]


def moved(seed: int, amount: float = 1e-4) -> np.ndarray:
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    return (MESH.nodes_m * [1.1, 0.95, 0.9]) @ turn.T + rng.uniform(
        -amount, amount, MESH.nodes_m.shape
    )


def test_gradient_and_hessian_are_the_derivatives() -> None:
    x, step = moved(1), 1e-8
    probes = coordinate_probe(x, np.arange(len(x)), step)
    assembly = damped(len(probes))
    made = viscosity(assembly, moved(2))
    same = np.repeat(x[None], len(probes), axis=0)
    found = gradient(assembly, made, same)[0]
    energies = made.energy(assembly.active, assembly.nodal(probes))
    scale = np.abs(found).max()
    assert scale > 1e-3
    slope = central_difference(energies, step).reshape(-1, 3)
    np.testing.assert_allclose(found, slope, atol=1e-6 * scale)

    free = assembly.free
    matrix = hessian(assembly, made, same, PSD_NONE)
    change = central_difference(gradient(assembly, made, probes), step)
    change = change.reshape(len(x), 3, len(x), 3)[free][:, :, free].reshape(matrix.shape)
    np.testing.assert_allclose(matrix, change, atol=1e-6 * np.abs(matrix).max())


@pytest.mark.parametrize("mode", [PSD_CLAMP, PSD_ABS])
def test_projected_matrix_is_positive(mode: int) -> None:
    assembly = damped()
    made = viscosity(assembly, moved(2))
    crushed = 0.4 * moved(1)[None]
    matrix = hessian(assembly, made, crushed, PSD_NONE)
    scale = np.abs(matrix).max()
    assert np.linalg.eigvalsh(matrix)[0] < -1e-2 * scale
    lifted = hessian(assembly, made, crushed, mode)
    assert np.linalg.eigvalsh(lifted)[0] > 0
    assert np.linalg.eigvalsh(lifted - matrix)[0] > -1e-12 * scale


def test_rigid_motion_is_free_and_momenta_are_kept() -> None:
    assembly = damped()
    start, other = moved(3), moved(4)
    made = viscosity(assembly, start)
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    rigid = (start @ turn.T + [1e-2, 0, 2e-2])[None]
    forces = gradient(assembly, made, other[None])[0]
    scale = np.abs(forces).sum()
    assert made.energy(assembly.active, assembly.nodal(rigid))[0] < 1e-20
    assert np.abs(gradient(assembly, made, rigid)).max() < 1e-11 * scale
    np.testing.assert_allclose(forces.sum(axis=0), 0, atol=1e-13 * scale)
    moment = np.cross(other, forces).sum(axis=0)
    np.testing.assert_allclose(moment, 0, atol=1e-13 * scale * np.abs(other).max())


def test_small_strains_see_rayleigh_damping() -> None:
    """Force tau / dt K (x - x_n)."""
    assembly = damped()
    rest = MESH.nodes_m
    made = viscosity(assembly, rest)
    change = np.zeros_like(rest)
    change[assembly.free] = np.random.default_rng(6).normal(size=(len(assembly.free), 3)) * 1e-11
    stiffness = assembly.elastic_hessian(rest[None], PSD_NONE)[0]
    expected = TAU / DT * stiffness @ change[assembly.free].ravel()
    found = gradient(assembly, made, (rest + change)[None])[0][assembly.free].ravel()
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())


def test_strain_creeps_back_at_the_damping_time() -> None:
    """Without mass K (x + tau v) = 0: implicit Euler shrinks a strain by 1 + dt / tau a step."""
    assembly = damped(density=1.0)
    model = assembly.model
    solver = SolverIPC(model, SolverConfig(absolute_tolerance_n=1e-12))
    state = initial_state(model, np.zeros((1, 0, 7)))
    rest = MESH.nodes_m
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


def test_damping_takes_energy_out_of_a_vibration() -> None:
    def amplitude(tau: float) -> float:
        model = damped(tau=tau).model
        solver = SolverIPC(model, SolverConfig(absolute_tolerance_n=1e-9))
        state = initial_state(model, np.zeros((1, 0, 7)))
        state.velocities = wp.array(
            np.where(MESH.nodes_m[:, 2:] > -1e-9, [1e-2, 0, 0], 0)[None], dtype=wp.vec3d
        )
        report = solver.step(state)
        assert report.converged.all()
        return float(np.abs(state.positions.numpy()[0] - MESH.nodes_m).max())

    assert amplitude(0.05) < 0.5 * amplitude(0.0)


# With friction the settled force remembers the path, which damping changes.
@pytest.mark.parametrize(("friction", "tolerance"), [(0.0, 1e-3), (0.4, 0.03)])
def test_a_damped_press_converges(friction: float, tolerance: float) -> None:
    mesh = block_mesh((5, 5, 3), (5e-3, 5e-3, 2.4e-3), jitter=0.15)
    forces = []
    for tau in (0.0, 0.05):
        soft = SoftBody(mesh, Material(YOUNG, NU, damping_time_s=tau))
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


def test_without_damping_nothing_is_built() -> None:
    assert damped(tau=0.0).solver.viscosity is None


@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf"), 1e5])
@pytest.mark.parametrize("kind", [Material, MaterialField])
def test_bad_damping_is_refused(kind: type, value: float) -> None:
    with pytest.raises(InputError, match="damping_time_s must lie in"):
        kind(YOUNG, NU, damping_time_s=value)


def test_quasi_static_damping_is_refused() -> None:
    with pytest.raises(InputError, match="damping_time_s needs quasi_static=False"):
        Scene(SoftBody(MESH, Material(YOUNG, NU, damping_time_s=0.1)))
