# SPDX-License-Identifier: Apache-2.0
"""External loads: energy and gradient, the work of a torque, tractions and pressures."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from taccel_lab.geometry.block import block_mesh
from taccel_lab.ipc.potentials.external import ExternalLoad, pressure_forces, traction_forces
from taccel_lab.model import Model
from taccel_lab.scene import AffineBody, Scene, TimeStepping, box_mesh, sphere_mesh

DYNAMIC = TimeStepping(quasi_static=False)
RNG = np.random.default_rng(0)


def two_objects(env_count: int = 1) -> Model:
    bodies = (AffineBody(box_mesh((1e-2, 2e-2, 3e-2))), AffineBody(sphere_mesh(5e-3, 3e-3)))
    return Scene(affine_bodies=bodies, env_count=env_count, time=DYNAMIC).finalize()


def nodal(value: np.ndarray) -> wp.array:
    return wp.array(np.ascontiguousarray(value), dtype=wp.vec3d)


def rotation(vector: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(vector).as_matrix()


def placed_controls(model: Model, turn: np.ndarray) -> np.ndarray:
    """Node positions [1, node, 3] with both bodies turned by a rotation vector."""
    x = model.rest_positions.numpy().copy()
    for first in model.affine.control_starts.numpy():
        x[0, first + 1 : first + 4] = x[0, first + 1 : first + 4] @ rotation(turn).T
    return x


def test_a_wrench_does_the_work_of_force_and_torque() -> None:
    model = two_objects()
    load = ExternalLoad(model)
    wrenches = RNG.normal(size=(1, 2, 6))
    start = placed_controls(model, np.array([0.3, -0.7, 1.1]))
    none = nodal(np.zeros_like(start))
    load.begin_step(nodal(start), none, nodal(wrenches.reshape(1, 2, 2, 3)))
    active = wp.full(1, 1, dtype=wp.int32)
    step = 1e-6
    for body, first in enumerate(model.affine.control_starts.numpy()):
        for axis in range(3):
            turned = []
            for sign in (1, -1):
                x = start.copy()
                spin = rotation(sign * step * np.eye(3)[axis])
                x[0, first + 1 : first + 4] = x[0, first + 1 : first + 4] @ spin.T
                turned.append(load.energy(active, nodal(x))[0])
            torque = -(turned[0] - turned[1]) / (2 * step)
            assert torque == pytest.approx(wrenches[0, body, 3 + axis], rel=1e-8)
            x = start.copy()
            x[0, first, axis] += 0.25
            work = -load.energy(active, nodal(x))[0]
            assert work == pytest.approx(0.25 * wrenches[0, body, axis], rel=1e-12)
        # No work on stretching along the axes.
        x = start.copy()
        x[0, first + 1 : first + 4] *= np.array([[1.5], [0.8], [1.1]])
        assert abs(load.energy(active, nodal(x))[0]) < 1e-14


def test_gradient_is_minus_the_force_and_matches_the_energy() -> None:
    model = two_objects(env_count=2)
    load = ExternalLoad(model)
    forces = RNG.normal(size=(2, model.node_count, 3))
    start = np.repeat(placed_controls(model, np.zeros(3)), 2, axis=0)
    load.begin_step(nodal(start), nodal(forces), nodal(np.zeros((2, 2, 2, 3))))
    active = wp.array([1, 0], dtype=wp.int32)
    gradient = nodal(np.ones(start.shape))
    load.add_gradient(active, nodal(start), gradient)
    np.testing.assert_array_equal(gradient.numpy()[0], 1 - forces[0])
    np.testing.assert_array_equal(gradient.numpy()[1], 1.0)
    moved = start + RNG.normal(size=start.shape)
    expected = -(forces[0] * (moved - start)[0]).sum()
    energy = load.energy(active, nodal(moved))
    assert energy[0] == pytest.approx(expected, rel=1e-12)
    assert energy[1] == 0


def test_traction_and_pressure() -> None:
    mesh = block_mesh((3, 3, 2), (3e-3, 2e-3, 1e-3), jitter=0.2)
    x = np.stack([mesh.nodes_m, mesh.nodes_m * [2, 1, 1]])
    top = mesh.region_faces(1)
    forces = traction_forces(x, top, np.array([10.0, -20.0, 50.0]))
    area = 3e-3 * 2e-3
    np.testing.assert_allclose(forces[0].sum(axis=0), area * np.array([10, -20, 50]), rtol=1e-12)
    np.testing.assert_allclose(forces[1].sum(axis=0), 2 * forces[0].sum(axis=0), rtol=1e-12)
    assert not forces[:, x[0, :, 2] < -1e-9].any()
    # A pressure on the top pushes down; on a closed surface it has no resultant and no moment.
    down = pressure_forces(x, top, 1e3)
    np.testing.assert_allclose(down[0].sum(axis=0), [0, 0, -1e3 * area], rtol=1e-12, atol=1e-18)
    around = pressure_forces(x, mesh.faces, 1e3)
    np.testing.assert_allclose(around.sum(axis=1), 0, atol=1e-17)
    np.testing.assert_allclose(np.cross(x, around).sum(axis=1), 0, atol=1e-19)
