# SPDX-License-Identifier: Apache-2.0
"""Drives hold links against gravity and push as hard as they may: against statics by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.outputs import Outputs
from taccel_lab.robots import Robot, drive, load_urdf, named
from taccel_lab.robots.driven import closest_solid
from taccel_lab.robots.transforms import matrix_of
from taccel_lab.scene import (
    AffineBody,
    PositionDrive,
    Scene,
    TimeStepping,
    box_mesh,
)
from taccel_lab.solvers import Control, SolverConfig, SolverIPC
from taccel_lab.state import initial_state
from tests.support.robot_files import CHAIN, REAL, write

pytest.importorskip("yourdfpy", reason="yourdfpy is not installed")
SIDEWAYS = np.array([0, 0, 0, np.sqrt(0.5), 0, 0, np.sqrt(0.5)])
G = 9.81


def torques_of_weight(robot: Robot, q: np.ndarray) -> np.ndarray:
    """What gravity along -z does to each coordinate [N m or N], [dof]: the sum over the links of
    their weight times the slope of their centre's height."""
    total = np.zeros(robot.dof)
    for link in robot.links:
        if link.mass is None:
            continue
        jacobian = robot.jacobian(link.name, q)[0]
        arm = matrix_of(robot.link_poses(link.name, q)[0])[:3, :3] @ link.mass.center_m
        height = jacobian[2] + np.cross(jacobian[3:].T, arm)[:, 2]
        total -= link.mass.mass_kg * G * height
    return total


def test_drives_hold_a_hand_against_its_weight() -> None:
    """At rest each drive's torque is that of the weights, at the angles where the hand came to
    rest; that angle is what the spring gives way."""
    robot = named("three_finger_hand").placed(SIDEWAYS)
    start = np.tile([0.1, -0.2, 0.5], 3)
    stiffness = 0.5
    driven = drive(robot, PositionDrive(stiffness, damping=0.02), start)
    assert len(driven.affine_bodies) == 9 and len(driven.kinematic_bodies) == 1
    time = TimeStepping(quasi_static=False, dt_s=0.02, gravity_m_s2=(0, 0, -G))
    scene = Scene(
        kinematic_bodies=driven.kinematic_bodies,
        time=time,
        affine_bodies=driven.affine_bodies,
        joints=driven.joints,
    )
    solver = SolverIPC(scene.finalize(), SolverConfig(absolute_tolerance_n=1e-8))
    state = initial_state(solver.model, driven.poses(1))
    control = Control(joint_targets=driven.joint_targets(start))
    for _ in range(60):
        assert solver.step(state, control).converged.all()
    assert solver.joints is not None
    q = driven.coordinates(solver.joints.coordinates.numpy())
    weight = torques_of_weight(robot, q)
    assert np.abs(weight).max() > 0.01
    efforts = solver.joints.efforts.numpy()[0]
    np.testing.assert_allclose(efforts, -weight, atol=1e-3 * np.abs(weight).max())
    np.testing.assert_allclose(q[0] - start, weight / stiffness, atol=2e-3 * np.abs(weight).max())


def test_fingers_squeeze_with_the_largest_effort_of_their_drives() -> None:
    """The targets lie inside the box: each finger pushes with its drive's largest force."""
    robot = named("parallel_gripper")
    largest = np.array([3.0, 7.0])
    half = 0.01
    for effort in largest:
        drives = {
            name: PositionDrive(2e4, damping=200.0, max_effort=effort)
            for name in ("slide_left", "slide_right")
        }
        driven = drive(robot, drives, [half + 1e-4])
        box = AffineBody(
            box_mesh((2 * half, 0.02, 0.02)),
            name="box",
            initial_pose=robot.link_poses("tcp", robot.rest_q)[0],
        )
        scene = Scene(
            kinematic_bodies=driven.kinematic_bodies,
            time=TimeStepping(quasi_static=False, dt_s=0.01),
            affine_bodies=[*driven.affine_bodies, box],
            joints=driven.joints,
        )
        model = scene.finalize()
        solver = SolverIPC(model, SolverConfig(dhat_m=5e-5))
        state = initial_state(model, driven.poses(1))
        control = Control(joint_targets=driven.joint_targets([0.0]))
        for _ in range(12):
            assert solver.step(state, control).converged.all()
        forces = Outputs(solver).update(state).contact_wrenches().wrenches.numpy()[0]
        on_box = forces[model.body_id("box")][
            [model.body_id(f"parallel_gripper/finger_{side}") for side in ("left", "right")], 0
        ]
        np.testing.assert_allclose(on_box, [effort, -effort], rtol=1e-3)
        assert solver.joints is not None
        q = driven.coordinates(solver.joints.coordinates.numpy())
        assert q == pytest.approx(half, abs=2e-4)


def test_a_drive_reaches_its_target_and_stops_at_the_limit() -> None:
    robot = named("three_finger_hand")
    driven = drive(robot, PositionDrive(5.0, damping=0.05))
    scene = Scene(
        kinematic_bodies=driven.kinematic_bodies,
        env_count=2,
        time=TimeStepping(quasi_static=False, dt_s=0.02),
        affine_bodies=driven.affine_bodies,
        joints=driven.joints,
    )
    solver = SolverIPC(scene.finalize())
    state = initial_state(solver.model, driven.poses(2))
    q = np.tile(np.tile([0.2, 0.4, 0.6], 3), (2, 1))
    q[1, 1] = 2.0  # Beyond the limit of 1.4.
    for _ in range(60):
        report = solver.step(state, Control(joint_targets=driven.joint_targets(q)))
        assert report.converged.all()
    assert solver.joints is not None
    found = driven.coordinates(solver.joints.coordinates.numpy())
    q[1, 1] = 1.4
    np.testing.assert_allclose(found, q, atol=2e-3)
    # Bodies are where forward kinematics has the links.
    poses = robot.forward_kinematics(found)
    outputs = Outputs(solver).update(state)
    assert outputs.momentum().linear.numpy() == pytest.approx(0, abs=1e-5)
    for body in driven.affine_bodies[::4]:
        i = [b.name for b in driven.affine_bodies].index(body.name)
        center = state.positions.numpy()[:, solver.model.affine.first_control + 4 * i]
        frames = matrix_of(poses[:, robot.link_id(body.name.split("/")[1])])
        local = np.append(solver.model.affine.properties[i].center_m, 1.0)
        np.testing.assert_allclose(center, (frames @ local)[:, :3], atol=1e-6)


def test_what_cannot_be_driven_is_refused(tmp_path: Path) -> None:
    gripper, servo = named("parallel_gripper"), PositionDrive(100.0)
    with pytest.raises(InputError, match="no joint 'slide' to drive; there are 'slide_left', 'sl"):
        drive(gripper, {"slide": servo})
    with pytest.raises(
        InputError, match=r"0\.05 of joint 'slide_left' in row 0 is out of its limit"
    ):
        drive(gripper, servo, [0.05])
    with pytest.raises(InputError, match=r"start_q must have shape \[1\], got \(2,\)"):
        drive(gripper, servo, [0.0, 0.0])
    with pytest.raises(InputError, match=r"coordinates must be finite, \[n, 1\] \('slide_left'\)"):
        drive(gripper, servo).joint_targets([np.nan])
    chain = load_urdf(write(tmp_path, CHAIN))
    with pytest.raises(InputError, match="link 'arm' moves but has no collision shape"):
        drive(chain.touching([]), servo)


def test_the_closest_inertia_of_a_solid() -> None:
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    solid = turn @ np.diag([2.0, 3.0, 4.0]) @ turn.T
    np.testing.assert_allclose(closest_solid(solid), solid, atol=1e-14)
    # Second moments of (1, 2, 3.2) are 2.1, 1.1 and -0.1: the last one becomes 0.0021.
    none = turn @ np.diag([1.0, 2.0, 3.2]) @ turn.T
    wanted = turn @ np.diag([1.1021, 2.1021, 3.2]) @ turn.T
    np.testing.assert_allclose(closest_solid(none), wanted, atol=1e-14)


@pytest.mark.parametrize("name", REAL)
def test_real_robots_hold_themselves(name: str) -> None:
    """All that moves weighs what the file says and where it says; the drives bear that."""
    robot = named(name).placed(SIDEWAYS)
    servo = PositionDrive(1e3, damping=20.0)
    drives = {joint.name: servo for joint in robot.joints if joint.moves}
    start = robot.limits.clip(-1, 1).mean(axis=1)
    if name.startswith("allegro"):
        with pytest.raises(InputError, match=r"is that of no solid.*closest_inertia=True"):
            drive(robot, drives, start)
    driven = drive(robot, drives, start, closest_inertia=name.startswith("allegro"))
    scene = Scene(
        kinematic_bodies=driven.kinematic_bodies,
        time=TimeStepping(quasi_static=False, dt_s=0.05, gravity_m_s2=(0, 0, -G)),
        affine_bodies=driven.affine_bodies,
        joints=driven.joints,
    )
    solver = SolverIPC(scene.finalize())
    moved = robot.forward_kinematics([driven.start_q, driven.start_q + 0.1])
    moving = np.abs(moved[1] - moved[0]).max(axis=1) > 0
    stated = [
        link.mass.mass_kg
        for link, moves in zip(robot.links, moving, strict=True)
        if moves and link.mass is not None
    ]
    found = sum(solid.mass_kg for solid in solver.model.affine.properties)
    assert found == pytest.approx(sum(stated))
    state = initial_state(solver.model, driven.poses(1))
    control = Control(joint_targets=driven.joint_targets(driven.start_q))
    for _ in range(40):
        report = solver.step(state, control)
        assert report.converged.all(), report.summary()
    assert solver.joints is not None
    values = solver.joints.coordinates.numpy()
    q = driven.coordinates(values)
    assert np.abs(q - driven.start_q).max() < 0.2
    weight = torques_of_weight(robot, q)
    names = [joint.name for joint in driven.joints]
    efforts = np.zeros(robot.dof)
    # A joint that mimics another one bears its part of the weight alone.
    for joint, factors in zip(robot.joints, robot.tree.factors, strict=True):
        if joint.moves:
            efforts += factors * solver.joints.efforts.numpy()[0, names.index(joint.name)]
    np.testing.assert_allclose(efforts, -weight, atol=2e-3 * np.abs(weight).max() + 1e-6)
