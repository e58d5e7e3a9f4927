# SPDX-License-Identifier: Apache-2.0
"""Momenta of bodies that turn rigidly, against those of a rigid body; tractions of a block."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from taccel_lab.geometry.block import block_mesh
from taccel_lab.ipc.potentials.external import pressure_forces, traction_forces
from taccel_lab.outputs.momentum import MomentumReader
from taccel_lab.outputs.surface_load import SurfaceLoadReader
from taccel_lab.scene import AffineBody, Ball, KinematicBody, Scene, box_mesh
from tests.support.blocks import pose
from tests.support.scene_steps import Stepped, in_time, linear

DYNAMIC = in_time(1e-2, 0.0)
SIZE = (1e-2, 2e-2, 3e-2)
SPIN = np.array([3.0, -5.0, 7.0])
SPEED = np.array([0.2, -0.1, 0.4])


def test_an_affine_body_turns_like_a_rigid_one() -> None:
    place = pose(0.1, -0.2, 0.3, (1, 2, 3), 40.0)
    body = AffineBody(
        box_mesh(SIZE),
        density_kg_m3=2000,
        initial_pose=place,
        initial_velocity_m_s=tuple(SPEED),
        initial_spin_rad_s=tuple(SPIN),
    )
    run = Stepped(Scene(affine_bodies=body, env_count=2, time=DYNAMIC))
    solid, state = run.model.affine.properties[0], run.state
    turn = Rotation.from_quat(place[3:]).as_matrix()
    inertia = turn @ solid.inertia_kg_m2 @ turn.T
    center = np.array([0.05, 0.0, -0.1])
    momentum = MomentumReader(run.model).read(state.positions, state.velocities, tuple(center))
    mass = 2000 * np.prod(SIZE)
    linear = mass * SPEED
    angular = inertia @ SPIN + np.cross(place[:3] - center, linear)
    for env in range(2):
        np.testing.assert_allclose(momentum.linear.numpy()[env, 0], linear, rtol=1e-12)
        np.testing.assert_allclose(momentum.angular.numpy()[env, 0], angular, rtol=1e-11)
        kinetic = 0.5 * mass * SPEED @ SPEED + 0.5 * SPIN @ inertia @ SPIN
        assert momentum.kinetic_energy.numpy()[env, 0] == pytest.approx(kinetic, rel=1e-12)


def test_a_soft_body_sums_its_lumped_masses_and_a_kinematic_one_has_none() -> None:
    mesh = block_mesh((2, 2, 2), SIZE, jitter=0.2)
    soft = linear(mesh, bonded_nodes=np.array([], dtype=int))
    ball = KinematicBody(Ball(1e-3))
    run = Stepped(Scene(soft, ball, time=DYNAMIC), pose(0, 0, 0.1))
    model, state, x = run.model, run.state, run.x()
    velocities = np.cross(SPIN, x) + SPEED
    state.velocities.assign(velocities[None])
    momentum = MomentumReader(model).read(state.positions, state.velocities)
    masses = model.masses.numpy()[0, : mesh.node_count]
    assert masses.sum() == pytest.approx(1000 * np.prod(SIZE), rel=1e-12)
    soft_x, soft_v = x[: mesh.node_count], velocities[: mesh.node_count]
    expected = (masses[:, None] * np.cross(soft_x, soft_v)).sum(axis=0)
    np.testing.assert_allclose(momentum.linear.numpy()[0, 0], masses @ soft_v, rtol=1e-12)
    np.testing.assert_allclose(momentum.angular.numpy()[0, 0], expected, rtol=1e-12)
    assert not momentum.linear.numpy()[0, 1].any()
    assert momentum.kinetic_energy.numpy()[0, 1] == 0


def test_tractions_times_areas_are_the_forces() -> None:
    mesh = block_mesh((4, 4, 2), SIZE, jitter=0.2)
    model = Scene(linear(mesh)).finalize()
    x = (mesh.nodes_m * [1.2, 1.0, 0.9])[None]
    top = mesh.region_faces(1)
    normal, drag = pressure_forces(x, top, 2e3), traction_forces(x, top, np.array([500.0, 0, 0]))
    positions, pushing, dragging = (wp.array(v, dtype=wp.vec3d) for v in (x, normal, drag))
    load = SurfaceLoadReader(model).read(positions, pushing, dragging)
    areas, nodes = load.areas.numpy()[0], np.unique(top)
    np.testing.assert_allclose(load.tractions.numpy()[0] * areas[:, None], (normal + drag)[0])
    # The rim counts with the top that is touched, not with the sides.
    assert areas[nodes].sum() == pytest.approx(SIZE[0] * 1.2 * SIZE[1], rel=1e-12)
    np.testing.assert_allclose(load.pressures.numpy()[0, nodes], 2e3, rtol=1e-12)
    np.testing.assert_allclose(load.tractions.numpy()[0, nodes], [[500, 0, -2e3]] * len(nodes))
    inner = nodes[(np.abs(mesh.nodes_m[nodes, :2]) < np.array(SIZE[:2]) / 2 - 1e-9).all(axis=1)]
    np.testing.assert_allclose(load.normals.numpy()[0, inner], [[0, 0, 1]] * len(inner), atol=1e-12)
    free = np.setdiff1d(np.unique(mesh.faces), nodes)
    assert not load.pressures.numpy()[0, free].any()
