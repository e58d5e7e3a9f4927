# SPDX-License-Identifier: Apache-2.0
"""Energies of inertia and of external loads, their gradients and matrices."""

from __future__ import annotations

import math

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from taccel_lab.geometry.block import block_mesh
from taccel_lab.ipc.potentials.external import ExternalLoad, pressure_forces, traction_forces
from taccel_lab.ipc.potentials.inertia import InertiaPotential
from taccel_lab.model import Model
from taccel_lab.scene import AffineBody, Scene, TimeStepping, box_mesh, sphere_mesh
from taccel_lab.solvers import SolverConfig
from taccel_lab.state import StepHistory
from tests.ipc.derivatives import assert_derivatives
from tests.support.blocks import scene
from tests.verification.assembly import Assembly

DT, GRAVITY = 0.01, np.array([0.0, 1.0, -9.81])
SIZE = (2e-3, 3e-3, 1e-3)
MESH = block_mesh((2, 1, 1), SIZE, jitter=0.2)
NODES = MESH.node_count


def dynamic_model(env_count: int) -> Model:
    stepping = TimeStepping(quasi_static=False, dt_s=DT, gravity_m_s2=tuple(GRAVITY))
    return scene(MESH, env_count=env_count, density=1200, time=stepping).finalize()


def nodal(value: np.ndarray) -> wp.array:
    return wp.array(np.ascontiguousarray(value), dtype=wp.vec3d)


def ints(*values: int) -> wp.array:
    return wp.array(values, dtype=wp.int32)


class Past:
    """Random states now and one step ago, the same in all environments."""

    def __init__(self, env_count: int) -> None:
        self.v, way, self.v_old = np.random.default_rng(0).normal(size=(3, NODES, 3))
        self.x, self.x_old = MESH.nodes_m, MESH.nodes_m - DT * way
        self.many = (env_count, 1, 1)

    def arrays(self) -> tuple[wp.array, wp.array]:
        return nodal(np.tile(self.x, self.many)), nodal(np.tile(self.v, self.many))

    def history(self, model: Model, dts: np.ndarray) -> StepHistory:
        history = StepHistory.empty(model)
        history.positions.assign(np.tile(self.x_old, self.many))
        history.velocities.assign(np.tile(self.v_old, self.many))
        history.dts.assign(dts)
        return history


@pytest.mark.parametrize("order", [1, 2])
def test_inertia_matches_its_formula_and_differences(order: int) -> None:
    model, past, g = dynamic_model(6 * NODES), Past(6 * NODES), GRAVITY
    assembly = Assembly(model, SolverConfig(), np.zeros((6 * NODES, 0, 7)))
    inertia, active = InertiaPotential(model), assembly.active
    if order == 1:
        inertia.begin_step(*past.arrays())
        span, expected_at = DT, past.x + DT * past.v + DT**2 * g
    else:
        inertia.begin_step(*past.arrays(), history=past.history(model, np.full(6 * NODES, DT)))
        # The textbook coefficients of constant steps: 4/3, -1/3, 2/3.
        span = 2 / 3 * DT
        speed = (4 * past.v - past.v_old) / 3
        expected_at = (4 * past.x - past.x_old) / 3 + span * speed + span**2 * g
    x = past.x + np.random.default_rng(1).normal(size=(NODES, 3)) * 1e-3
    free, masses = assembly.free, model.masses.numpy()[0]
    assert masses.sum() == pytest.approx(1200 * np.prod(SIZE), rel=1e-12)

    def energy(batch: np.ndarray) -> np.ndarray:
        return inertia.energy(active, assembly.nodal(batch))

    def gradient(batch: np.ndarray) -> np.ndarray:
        inertia.add_gradient(active, assembly.nodal(batch), out := assembly.nodal())
        return out.numpy()

    expected = 0.5 * (masses[free] * ((x - expected_at)[free] ** 2).sum(axis=1)).sum() / span**2
    at_x, system = np.tile(x, past.many), assembly.system()
    assert energy(at_x)[0] == pytest.approx(expected, rel=1e-12)
    inertia.add_hessian(active, assembly.nodal(at_x), system)
    matrix = assembly.dense(system.values)[0]
    np.testing.assert_allclose(matrix, np.diag(np.repeat(masses[free] / span**2, 3)), rtol=1e-13)
    assert_derivatives(x, 1e-7, energy, gradient, matrix, free, (1e-6, 0), (1e-7, 1e-7))


def test_steps_differ_by_environment() -> None:
    """Environments: no past, a halved, an equal, a doubled step, and one that grew too much."""
    previous = np.array([0.0, 2 * DT, DT, DT / 2, DT / 2.5])
    ratio = np.array([0.0, 0.5, 1.0, 2.0, 0.0])
    model, past = dynamic_model(5), Past(5)
    inertia, history = InertiaPotential(model), past.history(model, previous)
    x, v = past.arrays()
    inertia.begin_step(x, v, wp.array(np.full(5, DT), dtype=wp.float64), history)
    span = DT * (1 + ratio) / (1 + 2 * ratio)
    np.testing.assert_allclose(inertia.spans.numpy(), span, rtol=1e-14)

    moved = np.random.default_rng(2).normal(size=(5, NODES, 3))
    inertia.end_step(ints(1, 1, 1, 1, 0), x, nodal(moved), v, history)
    carry = ratio**2 / (1 + 2 * ratio)
    anchors = past.x + carry[:, None, None] * (past.x - past.x_old)
    expected = (moved - anchors) / span[:, None, None]
    np.testing.assert_allclose(v.numpy()[:4], expected[:4], rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(v.numpy()[4], past.v)
    positions = [past.x] * 4 + [past.x_old]
    np.testing.assert_array_equal(history.positions.numpy(), positions)
    np.testing.assert_array_equal(history.velocities.numpy()[:4], [past.v] * 4)
    assert history.dts.numpy().tolist() == [DT] * 4 + [DT / 2.5]


def falling(steps: np.ndarray, bdf2: bool) -> float:
    """Final height error of a unit mass on a unit spring after the given steps, from (1, 0)."""
    model = dynamic_model(1)
    inertia = InertiaPotential(model)
    history = StepHistory.empty(model) if bdf2 else None
    node = int(model.free_nodes.numpy()[0])
    x = np.zeros((1, NODES, 3))
    x[0, node] = 1.0
    position, velocity = nodal(x), nodal(np.zeros_like(x))
    done, mass = ints(1), model.masses.numpy()[0, node]
    for dt in steps:
        start = wp.clone(position)
        inertia.begin_step(position, velocity, wp.array([dt], dtype=wp.float64), history)
        inertia.add_gradient(done, nodal(np.zeros_like(x)), out := nodal(np.zeros_like(x)))
        span = inertia.spans.numpy()[0]
        # m (x - x_tilde) / s^2 + m (x + g) = 0: the spring pulls to -g, where weight is in balance.
        prediction = -out.numpy()[0, node] * span**2 / mass
        moved = start.numpy().copy()
        moved[0, node] = (prediction - span**2 * GRAVITY) / (1 + span**2)
        position.assign(moved)
        inertia.end_step(done, start, position, velocity, history)
    return float(np.abs(position.numpy()[0, node] - math.cos(steps.sum())).max())


@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize(("bdf2", "order"), [(False, 1), (True, 2)])
def test_measured_order_on_a_spring(bdf2: bool, order: int, uneven: bool) -> None:
    """Halving all steps divides the error by 2^order, also where steps vary in length."""
    errors = []
    for count in (64, 128, 256):
        steps = np.ones(count)
        if uneven:
            steps[1::2] = 0.5
            steps[:2] = 1.0
        errors.append(falling(2.0 * steps / steps.sum(), bdf2))
    slopes = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    np.testing.assert_allclose(slopes, order, atol=0.1)


def test_mass_follows_the_rest_shape_of_each_environment() -> None:
    mesh = block_mesh((2, 1, 1), SIZE)
    rest = np.stack([mesh.nodes_m, mesh.nodes_m * [2, 1, 1]])
    stepping = TimeStepping(quasi_static=False)
    masses = scene(mesh, env_count=2, rest_m=rest, time=stepping).finalize().masses.numpy()
    np.testing.assert_allclose(masses[1], 2 * masses[0])


RNG = np.random.default_rng(0)


def two_objects(env_count: int = 1) -> Model:
    bodies = (AffineBody(box_mesh((1e-2, 2e-2, 3e-2))), AffineBody(sphere_mesh(5e-3, 3e-3)))
    time = TimeStepping(quasi_static=False)
    return Scene(affine_bodies=bodies, env_count=env_count, time=time).finalize()


def test_a_wrench_does_the_work_of_force_and_torque() -> None:
    model = two_objects()
    load, wrenches, step = ExternalLoad(model), RNG.normal(size=(1, 2, 6)), 1e-6
    rest, firsts = model.rest_positions.numpy(), model.affine.control_starts.numpy()

    def turned(x: np.ndarray, first: int, vector: np.ndarray) -> np.ndarray:
        x = x.copy()
        x[0, first + 1 : first + 4] @= Rotation.from_rotvec(vector).as_matrix().T
        return x

    start = rest
    for first in firsts:
        start = turned(start, first, np.array([0.3, -0.7, 1.1]))
    load.begin_step(nodal(start), nodal(0 * start), nodal(wrenches.reshape(1, 2, 2, 3)))

    def energy(x: np.ndarray) -> float:
        return load.energy(ints(1), nodal(x))[0]

    for body, first in enumerate(firsts):
        for axis, way in enumerate(np.eye(3)):
            ends = [energy(turned(start, first, sign * step * way)) for sign in (1, -1)]
            torque = (ends[1] - ends[0]) / (2 * step)
            assert torque == pytest.approx(wrenches[0, body, 3 + axis], rel=1e-8)
            x = start.copy()
            x[0, first, axis] += 0.25
            assert -energy(x) == pytest.approx(0.25 * wrenches[0, body, axis], rel=1e-12)
        # No work on stretching along the axes.
        x = start.copy()
        x[0, first + 1 : first + 4] *= np.array([[1.5], [0.8], [1.1]])
        assert abs(energy(x)) < 1e-14


def test_gradient_is_minus_the_force_and_matches_the_energy() -> None:
    model = two_objects(env_count=2)
    load, start = ExternalLoad(model), model.rest_positions.numpy()
    start = np.tile(start[:1], (2, 1, 1))
    forces, way = RNG.normal(size=(2, *start.shape))
    load.begin_step(nodal(start), nodal(forces), nodal(np.zeros((2, 2, 2, 3))))
    gradient, active = nodal(np.ones(start.shape)), ints(1, 0)
    load.add_gradient(active, nodal(start), gradient)
    np.testing.assert_array_equal(gradient.numpy(), [1 - forces[0], 0 * forces[1] + 1])
    energy = load.energy(active, nodal(start + way))
    assert energy[0] == pytest.approx(-(forces * way)[0].sum(), rel=1e-12) and energy[1] == 0


def test_traction_and_pressure() -> None:
    mesh = block_mesh((3, 3, 2), (3e-3, 2e-3, 1e-3), jitter=0.2)
    x = np.stack([mesh.nodes_m, mesh.nodes_m * [2, 1, 1]])
    top, area, traction = mesh.region_faces(1), 3e-3 * 2e-3, np.array([10.0, -20.0, 50.0])
    forces = traction_forces(x, top, traction)
    np.testing.assert_allclose(forces[0].sum(axis=0), area * traction, rtol=1e-12)
    np.testing.assert_allclose(forces[1].sum(axis=0), 2 * area * traction, rtol=1e-12)
    assert not forces[:, x[0, :, 2] < -1e-9].any()
    # A pressure on the top pushes down; on a closed surface it has no resultant and no moment.
    down = pressure_forces(x, top, 1e3)
    np.testing.assert_allclose(down[0].sum(axis=0), [0, 0, -1e3 * area], rtol=1e-12, atol=1e-18)
    around = pressure_forces(x, mesh.faces, 1e3)
    np.testing.assert_allclose(around.sum(axis=1), 0, atol=1e-17)
    np.testing.assert_allclose(np.cross(x, around).sum(axis=1), 0, atol=1e-19)
