# SPDX-License-Identifier: Apache-2.0
"""External forces and wrenches through whole steps, against closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from taccel_lab.geometry import Region
from taccel_lab.geometry.block import block_mesh
from taccel_lab.ipc.potentials.external import traction_forces
from taccel_lab.outputs import Outputs
from taccel_lab.scene import AffineBody, Element, Material, Scene, SoftBody, box_mesh
from tests.support.scene_steps import Stepped, in_time

DT = 2e-3
# Small enough that a step turns the box by less than 1e-3: a load keeps its direction in a step.
FORCE, TORQUE = np.array([3e-3, -2e-3, 5e-3]), np.array([2e-5, 1e-5, -3e-5])
SIZE = (1e-2, 2e-2, 3e-2)


def free_box(**placed: Any) -> Stepped:
    body = AffineBody(box_mesh(SIZE), 2000, **placed)
    return Stepped(Scene(affine_bodies=body, time=in_time(DT, 0.0)), absolute_tolerance_n=1e-12)


PLACE = np.array([0.1, 0.2, -0.1, *Rotation.from_rotvec([0.2, -0.5, 0.3]).as_quat()])


def momentum_after(steps: int, wrench: np.ndarray | None, nodal: np.ndarray | None) -> np.ndarray:
    """Linear and angular momentum about the centre of mass of the box, shape [6]."""
    run = free_box(initial_pose=PLACE)
    run.state.load(run.model, nodal, wrench)
    run.steps(steps)
    centre = tuple(run.x()[run.model.affine.first_control])
    momentum = Outputs(run.solver).update(run.state).momentum(centre)
    return np.concatenate([momentum.linear.numpy()[0, 0], momentum.angular.numpy()[0, 0]])


def test_a_wrench_changes_momentum_by_force_and_torque_times_time() -> None:
    wrench = np.stack([FORCE, TORQUE])[None, None]
    expected = np.array([FORCE, TORQUE]) * DT
    for steps, within in ((1, 1e-4), (10, 0.03)):
        force, torque = momentum_after(steps, wrench, None).reshape(2, 3) / steps
        np.testing.assert_allclose(force, expected[0], rtol=1e-10)
        np.testing.assert_allclose(torque, expected[1], atol=within * np.abs(expected[1]).max())


def test_a_force_on_a_vertex_is_the_force_and_its_torque() -> None:
    run = free_box(initial_pose=PLACE)
    vertex = run.model.bodies[0].nodes[0] + 5
    arm = run.x()[vertex] - run.x()[run.model.affine.first_control]
    forces = np.zeros((1, run.model.node_count, 3))
    forces[0, vertex] = FORCE
    on_vertex = momentum_after(1, None, forces)
    as_wrench = momentum_after(1, np.stack([FORCE, np.cross(arm, FORCE)])[None, None], None)
    assert np.linalg.norm(as_wrench[3:]) > 1e-8
    np.testing.assert_allclose(on_vertex[:3], as_wrench[:3], rtol=1e-10)
    np.testing.assert_allclose(
        on_vertex[3:], as_wrench[3:], atol=1e-3 * np.linalg.norm(as_wrench[3:])
    )


def test_a_torque_turns_a_body_like_a_rigid_one() -> None:
    """About a principal axis: angle = tau t^2 / (2 I), up to dt / t of implicit Euler."""
    run = free_box()
    inertia = run.model.affine.properties[0].inertia_kg_m2[2, 2]
    steps, target = 20, 0.4
    torque = 2 * inertia * target / (steps * DT) ** 2
    run.state.load(run.model, None, np.array([[[[0, 0, 0], [0, 0, torque]]]]))
    run.steps(steps)
    y = run.x()[run.model.affine.first_control + 1]
    # Implicit Euler sums to t (t + dt) / 2 instead of t^2 / 2.
    assert np.arctan2(y[1], y[0]) == pytest.approx(target * (1 + 1 / steps), rel=5e-3)


@pytest.mark.parametrize("element", list(Element))
def test_a_pulled_block_has_the_closed_form(element: Element) -> None:
    """nu = 0: P = mu (l - 1 / l) without lateral stress, uniform even beside the bond."""
    mesh = block_mesh((3, 2, 3), (3e-3, 2e-3, 2e-3), jitter=0.2)
    young, stress = 1e5, 3e4
    body = SoftBody(mesh, Material(young, 0.0), element=element)
    run = Stepped(Scene(body), absolute_tolerance_n=1e-13)
    surface = body.nodal_mesh
    faces = surface.region_faces(Region.CONTACT)
    if element is Element.LINEAR:
        forces = traction_forces(run.rest[None], faces, np.array([0, 0, stress]))
    else:
        # A uniform load on six-node triangles acts on the middles of edges alone.
        corners = mesh.region_faces(Region.CONTACT)
        thirds = traction_forces(run.rest[None], corners, np.array([0, 0, stress]))
        forces = np.zeros_like(thirds)
        area = np.linalg.norm(
            np.cross(*(run.rest[corners[:, k]] - run.rest[corners[:, 0]] for k in (1, 2))), axis=1
        )
        ends = {tuple(e): mesh.node_count + i for i, e in enumerate(surface.edges.tolist())}
        for face, twice in zip(corners, area, strict=True):
            for k in range(3):
                edge = sorted((int(face[k]), int(face[(k + 1) % 3])))
                forces[0, ends[tuple(edge)], 2] += stress * twice / 6
    run.state.load(run.model, forces)
    run.step()
    mu = young / 2
    stretch = (stress + np.sqrt(stress**2 + 4 * mu**2)) / (2 * mu)
    expected = run.rest.copy()
    expected[:, 2] = -2e-3 + (expected[:, 2] + 2e-3) * stretch
    np.testing.assert_allclose(run.x(), expected, atol=1e-8 * 2e-3)
    sigma = Outputs(run.solver).update(run.state).nodal_stresses.numpy()[0]
    np.testing.assert_allclose(sigma - np.diag([0, 0, stress]), 0, atol=1e-7 * stress)
