# SPDX-License-Identifier: Apache-2.0
"""Drives hold links against gravity, grip with gels and push as hard as they may, by statics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.geometry.block import block_mesh
from taccel_lab.outputs import GelFrames, Outputs
from taccel_lab.robots import Robot, drive, load_urdf, named, on_seat
from taccel_lab.robots.driven import closest_solid
from taccel_lab.robots.transforms import matrix_of, pose_of
from taccel_lab.scene import AffineBody, Element, Material, Plane, PositionDrive, SoftBody, box_mesh
from taccel_lab.solvers import Control
from tests.robots.gels import GEL, PAD, G, Run, driven_scene, moving, with_pads
from tests.support.robot_files import CHAIN, REAL, write
from tests.support.sensor_refusals import refuses

SIDEWAYS = np.array([0, 0, 0, np.sqrt(0.5), 0, 0, np.sqrt(0.5)])
SERVO = PositionDrive(100.0)


def lift(robot: Robot, link: str, q: np.ndarray, point_m: np.ndarray) -> np.ndarray:
    """Slope of the height of a point of a link by each coordinate, [dof]."""
    jacobian = robot.jacobian(link, q)[0]
    arm = matrix_of(robot.link_poses(link, q)[0])[:3, :3] @ point_m
    return jacobian[2] + np.cross(jacobian[3:].T, arm)[:, 2]


def torques_of_weight(robot: Robot, q: np.ndarray) -> np.ndarray:
    """What gravity along -z does to each coordinate [N m or N], [dof]: the sum over the links of
    their weight times the slope of their centre's height."""
    masses = [(link.name, link.mass) for link in robot.links if link.mass is not None]
    return -np.sum([m.mass_kg * G * lift(robot, name, q, m.center_m) for name, m in masses], axis=0)


def test_a_drive_reaches_its_target_and_stops_at_the_limit() -> None:
    robot = named("three_finger_hand")
    driven = drive(robot, PositionDrive(5.0, damping=0.05))
    q = np.tile(np.tile([0.2, 0.4, 0.6], 3), (2, 1))
    q[1, 1] = 2.0  # Beyond the limit of 1.4.
    run = Run(driven_scene(driven, moving(0.02), envs=2), driven.poses(2))
    run.step(Control(joint_targets=driven.joint_targets(q)), 60)
    q[1, 1] = 1.4
    found = run.coordinates(driven)
    np.testing.assert_allclose(found, q, atol=2e-3)
    # Bodies are where forward kinematics has the links.
    poses = robot.forward_kinematics(found)
    momentum = Outputs(run.solver).update(run.state).momentum().linear.numpy()
    assert momentum == pytest.approx(0, abs=1e-5)
    affine = run.model.affine
    for i, body in list(enumerate(driven.affine_bodies))[::4]:
        center = run.state.positions.numpy()[:, affine.first_control + 4 * i]
        frames = matrix_of(poses[:, robot.link_id(body.name.split("/")[1])])
        local = np.append(affine.properties[i].center_m, 1.0)
        np.testing.assert_allclose(center, (frames @ local)[:, :3], atol=1e-6)


test_what_cannot_be_driven_is_refused = refuses(
    lambda folder, call: call(named("parallel_gripper"), folder),
    (lambda r, _: drive(r, {"slide": SERVO}), "no joint to drive 'slide'"),
    (lambda r, _: drive(r, SERVO, [0.05]), r"0\.05 of joint 'slide_left' in row 0 is out of i"),
    (lambda r, _: drive(r, SERVO, [0, 0.0]), r"start_q must have shape \[1\], got \[2\]"),
    (
        lambda r, _: drive(r, SERVO).joint_targets([np.nan]),
        r"coordinates must be finite, \[n, 1\] \('slide_left'\)",
    ),
    (
        lambda r, _: drive(r, SERVO).poses(2, np.zeros((3, 7))),
        r"world_from_base must have shape \[7\] or \[2, 7\]",
    ),
    (
        lambda _, folder: drive(load_urdf(write(folder, CHAIN)).touching([]), SERVO),
        "link 'arm' moves but has no collision shape",
    ),
    given="tmp_path",
)


def test_the_closest_inertia_of_a_solid() -> None:
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    # Second moments of (1, 2, 3.2) are 2.1, 1.1 and -0.1: the last one becomes 0.0021.
    for given, wanted in (([2.0, 3, 4], [2.0, 3, 4]), ([1, 2, 3.2], [1.1021, 2.1021, 3.2])):
        found = closest_solid(turn @ np.diag(given) @ turn.T)
        np.testing.assert_allclose(found, turn @ np.diag(wanted) @ turn.T, atol=1e-14)


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
    run = Run(driven_scene(driven, moving(0.05, G)), driven.poses(1))
    run.step(Control(joint_targets=driven.joint_targets(driven.start_q)), 40)
    q = run.coordinates(driven)
    moved = robot.forward_kinematics([driven.start_q, driven.start_q + 0.1])
    moving_links = np.flatnonzero(np.abs(moved[1] - moved[0]).max(axis=1) > 0)
    masses = [robot.links[i].mass for i in moving_links]
    found = sum(solid.mass_kg for solid in run.model.affine.properties)
    assert found == pytest.approx(sum(mass.mass_kg for mass in masses if mass is not None))
    assert np.abs(q - driven.start_q).max() < 0.2
    weight = torques_of_weight(robot, q)
    of_drives = dict(zip([joint.name for joint in driven.joints], run.efforts(), strict=True))
    # A joint that mimics another one bears its part of the weight alone.
    factors = zip(robot.joints, robot.tree.factors, strict=True)
    efforts = sum(factor * of_drives[joint.name] for joint, factor in factors if joint.moves)
    np.testing.assert_allclose(efforts, -weight, atol=2e-3 * np.abs(weight).max() + 1e-6)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "element", [Element.LINEAR, pytest.param(Element.QUADRATIC, marks=pytest.mark.slow)]
)
def test_a_gripper_grips_with_the_force_of_its_drives_and_lifts(element: Element) -> None:
    """It hangs above a table and closes on a box with drives of 3 N, then its base goes up by
    5 mm."""
    half, largest, envs = 0.01, 3.0, 2
    down = np.array([0, 0, 0.13, 1.0, 0, 0, 0])
    robot = with_pads(named("parallel_gripper").placed(down), replace(GEL, element=element))
    servo = PositionDrive(2e4, damping=200.0, max_effort=largest)
    driven = drive(robot, {"slide_left": servo, "slide_right": servo}, [half + 3.1e-3])
    box = AffineBody(
        box_mesh((2 * half, 2 * half, 2 * half)),
        density_kg_m3=2000,
        name="box",
        friction_coefficient=0.8,
        initial_pose=np.array([0, 0, half + 1e-4, 0, 0, 0, 1]),
    )
    table = Plane(name="table", friction_coefficient=0.3)
    scene = driven_scene(driven, moving(0.01, G), [box], [table], envs)
    run = Run(scene, driven.poses(envs), dhat_m=5e-5)
    control = Control(joint_targets=driven.joint_targets(np.zeros((envs, 1))))
    outputs, affine = Outputs(run.solver), run.model.affine
    center = affine.first_control + 4 * (len(scene.affine_bodies) - 1)

    def advance(steps: int, per_step_m: float = 0.0) -> np.ndarray:
        for _ in range(steps):
            down[2] += per_step_m
            run.step(replace(control, target_poses=driven.poses(envs, down)))
        wrenches = outputs.update(run.state).soft_wrenches().numpy()
        np.testing.assert_allclose(-wrenches[..., 2], largest, rtol=1e-3)
        return wrenches

    advance(14)
    stood = run.state.positions.numpy()[:, center, 2].copy()
    advance(10, 5e-4)
    wrenches = advance(10)
    # The gels' y axis is -z of the links, which look down.
    weight = affine.properties[-1].mass_kg * G
    np.testing.assert_allclose(np.abs(wrenches[..., 1].sum(axis=1)), weight, rtol=1e-2)
    # It hangs in the gels, which give way.
    rose = run.state.positions.numpy()[:, center, 2] - stood
    assert (rose > 3e-3).all() and (rose < 5e-3).all()
    q = run.coordinates(driven)
    # The gels are where forward kinematics has their links.
    frames = GelFrames(run.model).read(run.state).numpy()
    for gel, side in enumerate(("left", "right")):
        link = matrix_of(robot.placed(down).link_poses(f"finger_{side}", q))
        wanted = pose_of(link @ matrix_of(on_seat(PAD)))
        # Fingers move by themselves; the second one's drive has yielded a little less.
        np.testing.assert_allclose(frames[:, gel, :3], wanted[:, :3], atol=1e-4)
        signs = np.sign((frames[:, gel, 3:] * wanted[:, 3:]).sum(axis=1, keepdims=True))
        np.testing.assert_allclose(signs * frames[:, gel, 3:], wanted[:, 3:], atol=1e-6)


@pytest.mark.thorough(cases=("True",))
@pytest.mark.parametrize("with_gels", [False, True])
def test_drives_hold_a_hand_and_its_gels_against_their_weight(with_gels: bool) -> None:
    """At rest each drive's torque is that of the weights of links and gels, at the angles where the
    hand came to rest; that angle is what the spring gives way."""
    bare = robot = named("three_finger_hand").placed(SIDEWAYS)
    size = (16e-3, 16e-3, 6e-3)
    large = block_mesh((4, 4, 2), size)
    heavy = SoftBody(large, Material(1e5, 0.45, density_kg_m3=5000), element=Element.LINEAR)
    tips = [name for name in robot.link_names if "distal" in name] if with_gels else []
    for name in tips:
        robot = robot.mount(name, heavy, on_seat(large))
    assert len(robot.mounts) == (3 if with_gels else 0)
    start, stiffness = np.tile([0.1, -0.2, 0.5], 3), 0.5
    driven = drive(robot, PositionDrive(stiffness, damping=0.02), start)
    assert len(driven.affine_bodies) == 9
    scene = driven_scene(driven, moving(0.01 if with_gels else 0.02, G))
    run = Run(scene, driven.poses(1), absolute_tolerance_n=1e-8)
    run.step(Control(joint_targets=driven.joint_targets(start)), 80 if with_gels else 60)
    q, efforts = run.coordinates(driven), run.efforts()
    x, masses = run.state.positions.numpy()[0], run.model.masses.numpy()[0]
    of_links, of_gels = torques_of_weight(bare, q), np.zeros(robot.dof)
    for k, name in enumerate(tips):
        nodes = run.model.bodies[k].node_slice
        mass = masses[nodes].sum()
        assert mass == pytest.approx(5000 * np.prod(size))
        frame = matrix_of(robot.link_poses(name, q)[0])
        center = np.linalg.inv(frame) @ np.append(masses[nodes] @ x[nodes] / mass, 1.0)
        of_gels -= mass * G * lift(robot, name, q, center[:3])
    weight = of_links + of_gels
    largest = np.abs(weight).max()
    assert largest > 0.01
    np.testing.assert_allclose(efforts, -weight, atol=1e-3 * largest)
    np.testing.assert_allclose(q[0] - start, weight / stiffness, atol=2e-3 * largest)
    if with_gels:
        assert np.abs(efforts + of_links).max() > 20 * 1e-3 * largest


def test_what_stays_and_what_moves_carries_its_gels() -> None:
    """A gel on the base keeps its frame; one on a link of several shapes goes with the first."""
    gripper, left = named("parallel_gripper"), "parallel_gripper/finger_left"
    both = gripper.mount("palm", GEL, on_seat(PAD), "of palm").mount("finger_left", GEL, name="pad")
    driven = drive(both, SERVO)
    assert [body.shape is None for body in driven.kinematic_bodies] == [True, False]
    mounts = [gel.mount for gel in driven.soft_bodies]
    assert mounts == [driven.kinematic_bodies[0].name, left]
    # On a frame without shape or mass, fixed to a finger.
    sensor = replace(gripper.part("tcp"), name="sensor")
    at = np.array([1e-3, 2e-3, 3e-3, 0, 0, 0, 1])
    seated = gripper.attach("finger_left", sensor, at, "left/").mount("left/tcp", GEL)
    (gel,) = drive(seated, SERVO).soft_bodies
    assert gel.mount == left
    np.testing.assert_allclose(gel.mount_pose, at, atol=1e-12)
    # A base without shapes.
    driven = drive(gripper.touching(["finger_left", "finger_right"]), SERVO)
    (frame,) = driven.kinematic_bodies
    assert frame.shape is None
    assert {joint.second for joint in driven.joints} == {frame.name}
    away = np.array([1.0, 2, 3, 0, 0, 0, 1])
    np.testing.assert_allclose(driven.poses(2, away), np.tile(away, (2, 1, 1)), atol=1e-15)
