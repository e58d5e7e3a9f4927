# SPDX-License-Identifier: Apache-2.0
"""Gels on links that drives move: where they are, what they weigh, how hard they press."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.geometry.block import block_mesh
from taccel_lab.outputs import GelFrames, Outputs
from taccel_lab.robots import DrivenRobot, Robot, drive, named, on_seat
from taccel_lab.robots.transforms import matrix_of, pose_of
from taccel_lab.scene import (
    AffineBody,
    Element,
    Material,
    Plane,
    PositionDrive,
    Scene,
    SoftBody,
    TimeStepping,
    box_mesh,
)
from taccel_lab.solvers import Control, SolverConfig, SolverIPC
from taccel_lab.state import initial_state

pytest.importorskip("yourdfpy", reason="yourdfpy is not installed")
PAD = block_mesh((4, 4, 2), (8e-3, 8e-3, 3e-3))
GEL = SoftBody(PAD, Material(1e5, 0.45), friction_coefficient=0.8)
SIDES = ("left", "right")
SIDEWAYS = np.array([0, 0, 0, np.sqrt(0.5), 0, 0, np.sqrt(0.5)])
G = 9.81
TIME = TimeStepping(quasi_static=False, dt_s=0.01, gravity_m_s2=(0, 0, -G))


def scene_of(driven: DrivenRobot, box: list[AffineBody], planes: list[Plane], envs: int) -> Scene:
    return Scene(
        driven.soft_bodies,
        driven.kinematic_bodies,
        envs,
        TIME,
        affine_bodies=[*driven.affine_bodies, *box],
        joints=driven.joints,
        planes=planes,
    )


@pytest.mark.parametrize(
    "element", [Element.LINEAR, pytest.param(Element.QUADRATIC, marks=pytest.mark.slow)]
)
def test_a_gripper_grips_with_the_force_of_its_drives_and_lifts(element: Element) -> None:
    """It hangs above a table and closes on a box with drives of 3 N, then its base goes up by
    5 mm."""
    half, largest, envs = 0.01, 3.0, 2
    down = np.array([0, 0, 0.13, 1.0, 0, 0, 0])
    robot = named("parallel_gripper").placed(down)
    for side in SIDES:
        gel = replace(GEL, element=element)
        robot = robot.mount(f"finger_{side}", gel, on_seat(PAD), side)
    servo = PositionDrive(2e4, damping=200.0, max_effort=largest)
    driven = drive(robot, {f"slide_{side}": servo for side in SIDES}, [half + 3.1e-3])
    box = AffineBody(
        box_mesh((2 * half, 2 * half, 2 * half)),
        density_kg_m3=2000,
        name="box",
        friction_coefficient=0.8,
        initial_pose=np.array([0, 0, half + 1e-4, 0, 0, 0, 1]),
    )
    table = Plane(name="table", friction_coefficient=0.3)
    solver = SolverIPC(scene_of(driven, [box], [table], envs).finalize(), SolverConfig(dhat_m=5e-5))
    model = solver.model
    state = initial_state(model, driven.poses(envs))
    control = Control(joint_targets=driven.joint_targets(np.zeros((envs, 1))))
    outputs = Outputs(solver)
    center = model.affine.first_control + 4 * (len(model.scene.affine_bodies) - 1)

    def advance(steps: int, per_step_m: float = 0.0) -> None:
        for _ in range(steps):
            down[2] += per_step_m
            report = solver.step(state, replace(control, target_poses=driven.poses(envs, down)))
            assert report.converged.all(), report.summary()

    advance(14)
    pressed = -outputs.update(state).soft_wrenches().numpy()[..., 2]
    np.testing.assert_allclose(pressed, largest, rtol=1e-3)
    stood = state.positions.numpy()[:, center, 2].copy()
    advance(10, 5e-4)
    advance(10)
    wrenches = outputs.update(state).soft_wrenches().numpy()
    np.testing.assert_allclose(-wrenches[..., 2], largest, rtol=1e-3)
    # The gels' y axis is -z of the links, which look down.
    weight = model.affine.properties[-1].mass_kg * G
    np.testing.assert_allclose(np.abs(wrenches[..., 1].sum(axis=1)), weight, rtol=1e-2)
    # It hangs in the gels, which give way.
    rose = state.positions.numpy()[:, center, 2] - stood
    assert (rose > 3e-3).all() and (rose < 5e-3).all()
    assert solver.joints is not None
    q = driven.coordinates(solver.joints.coordinates.numpy())
    # The gels are where forward kinematics has their links.
    frames = GelFrames(model).read(state).numpy()
    for gel, side in enumerate(SIDES):
        link = matrix_of(robot.placed(down).link_poses(f"finger_{side}", q))
        wanted = pose_of(link @ matrix_of(on_seat(PAD)))
        # Fingers move by themselves; the second one's drive has yielded a little less.
        np.testing.assert_allclose(frames[:, gel, :3], wanted[:, :3], atol=1e-4)
        signs = np.sign((frames[:, gel, 3:] * wanted[:, 3:]).sum(axis=1, keepdims=True))
        np.testing.assert_allclose(signs * frames[:, gel, 3:], wanted[:, 3:], atol=1e-6)


def test_the_weight_of_gels_arrives_at_the_joints() -> None:
    """At rest each drive's torque is that of the weights of links and gels, at the angles where the
    hand came to rest."""
    robot = named("three_finger_hand").placed(SIDEWAYS)
    tips = [name for name in robot.link_names if "distal" in name or "tip" in name]
    tips = [name for name in tips if robot.links[robot.link_id(name)].shapes]
    size = (16e-3, 16e-3, 6e-3)
    large = block_mesh((4, 4, 2), size)
    heavy = SoftBody(large, Material(1e5, 0.45, density_kg_m3=5000), element=Element.LINEAR)
    bare = robot
    for name in tips:
        robot = robot.mount(name, heavy, on_seat(large))
    assert len(robot.mounts) == 3
    start = np.tile([0.1, -0.2, 0.5], 3)
    driven = drive(robot, PositionDrive(0.5, damping=0.02), start)
    solver = SolverIPC(
        scene_of(driven, [], [], 1).finalize(), SolverConfig(absolute_tolerance_n=1e-8)
    )
    state = initial_state(solver.model, driven.poses(1))
    control = Control(joint_targets=driven.joint_targets(start))
    for _ in range(80):
        assert solver.step(state, control).converged.all()
    assert solver.joints is not None
    q = driven.coordinates(solver.joints.coordinates.numpy())
    x, masses = state.positions.numpy()[0], solver.model.masses.numpy()[0]
    of_links, of_gels = np.zeros(robot.dof), np.zeros(robot.dof)
    for link in bare.links:
        if link.mass is not None:
            frame = matrix_of(bare.link_poses(link.name, q)[0])
            of_links -= link.mass.mass_kg * G * _lift(bare, link.name, q, frame, link.mass.center_m)
    for k, name in enumerate(tips):
        nodes = solver.model.bodies[k].node_slice
        mass = masses[nodes].sum()
        assert mass == pytest.approx(5000 * np.prod(size))
        frame = matrix_of(robot.link_poses(name, q)[0])
        center = np.linalg.inv(frame) @ np.append(masses[nodes] @ x[nodes] / mass, 1.0)
        of_gels -= mass * G * _lift(robot, name, q, frame, center[:3])
    assert np.abs(of_gels).max() > 1e-3
    efforts = solver.joints.efforts.numpy()[0]
    weight = of_links + of_gels
    np.testing.assert_allclose(efforts, -weight, atol=1e-3 * np.abs(weight).max())
    assert np.abs(efforts + of_links).max() > 20 * 1e-3 * np.abs(weight).max()


def _lift(
    robot: Robot, link: str, q: np.ndarray, frame: np.ndarray, center_m: np.ndarray
) -> np.ndarray:
    """Slope of the height of a point of a link by each coordinate."""
    jacobian = robot.jacobian(link, q)[0]
    return jacobian[2] + np.cross(jacobian[3:].T, frame[:3, :3] @ center_m)[:, 2]


def test_what_stays_and_what_moves_carries_its_gels() -> None:
    """A gel on the base keeps its frame; one on a link of several shapes goes with the first."""
    gripper, servo = named("parallel_gripper"), PositionDrive(100.0)
    both = gripper.mount("palm", GEL, on_seat(PAD), "of palm").mount("finger_left", GEL, name="pad")
    driven = drive(both, servo)
    assert [body.shape is None for body in driven.kinematic_bodies] == [True, False]
    assert [gel.mount for gel in driven.soft_bodies] == [
        driven.kinematic_bodies[0].name,
        "parallel_gripper/finger_left",
    ]
    # On a frame without shape or mass, fixed to a finger.
    sensor = replace(gripper.part("tcp"), name="sensor")
    at = np.array([1e-3, 2e-3, 3e-3, 0, 0, 0, 1])
    seated = gripper.attach("finger_left", sensor, at, "left/").mount("left/tcp", GEL)
    (gel,) = drive(seated, servo).soft_bodies
    assert gel.mount == "parallel_gripper/finger_left"
    np.testing.assert_allclose(gel.mount_pose, at, atol=1e-12)


def test_a_base_without_shapes_still_carries() -> None:
    gripper = named("parallel_gripper").touching(["finger_left", "finger_right"])
    driven = drive(gripper, PositionDrive(100.0))
    (frame,) = driven.kinematic_bodies
    assert frame.shape is None
    assert {joint.second for joint in driven.joints} == {frame.name}
    away = np.array([1.0, 2, 3, 0, 0, 0, 1])
    np.testing.assert_allclose(driven.poses(2, away), np.tile(away, (2, 1, 1)), atol=1e-15)
    with pytest.raises(InputError, match=r"world_from_base must be finite, \[7\] or \[2, 7\]"):
        driven.poses(2, np.zeros((3, 7)))
