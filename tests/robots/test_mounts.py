# SPDX-License-Identifier: Apache-2.0
"""Gels on links: they are where forward kinematics says, and grip."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from taccel_lab.exporters.export import export_profile
from taccel_lab.geometry import Region
from taccel_lab.geometry.block import block_mesh
from taccel_lab.outputs import Outputs
from taccel_lab.robots import Robot, load_urdf, named, on_seat
from taccel_lab.robots.describe import draw_robot
from taccel_lab.robots.transforms import matrix_of
from taccel_lab.scene import AffineBody, Ball, Material, Scene, box_mesh, sphere_mesh
from taccel_lab.sensors.profile import catalogue_profile
from tests.robots.gels import GEL, IDENTITY, PAD, Run, moving, padded_hand, with_pads
from tests.support.robot_files import CHAIN, REAL, random_coordinates, write
from tests.support.sensor_refusals import refuses

DT = 0.02


def gripper_with_pads() -> Robot:
    """Somewhere in the world."""
    return with_pads(named("parallel_gripper").placed([0.3, -0.1, 0.2, 0.5, 0.5, 0.5, 0.5]))


def carried(frame: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points [n, 3] of a frame [4, 4] in the world."""
    return points @ frame[:3, :3].T + frame[:3, 3]


def check_nodes(robot: Robot, run: Run, q: np.ndarray, nodes: np.ndarray, atol: float) -> None:
    """These nodes of each gel are where the links carry them, by forward kinematics alone."""
    positions = run.state.positions.numpy()
    for mount in robot.mounts:
        first = run.model.bodies[run.model.body_id(mount.gel.name)].nodes[0]
        for env, link in enumerate(matrix_of(robot.link_poses(mount.link, q))):
            wanted = carried(link @ mount.link_from_gel, PAD.nodes_m[nodes])
            np.testing.assert_allclose(positions[env, first + nodes], wanted, rtol=0, atol=atol)


def pushes_of_gels(
    robot: Robot, body: AffineBody, start: np.ndarray, ways: list[np.ndarray]
) -> tuple[Run, np.ndarray, np.ndarray]:
    """The run, forces of the gels on a body after steps to coordinates, [env, gel, 3], and the
    residual. Between two steps the body's momentum changes by what the gels do, to the residual."""
    scene = Scene(
        robot.soft_bodies(), robot.kinematic_bodies(), len(start), moving(DT), affine_bodies=body
    )
    run = Run(scene, robot.targets(start), dhat_m=5e-5, relative_tolerance=1e-6)
    outputs, before = Outputs(run.solver), np.zeros(3)
    held = run.model.body_id(body.name)
    gels = [run.model.body_id(mount.gel.name) for mount in robot.mounts]
    forces = residual = np.zeros(0)
    for q in ways:
        residual = run.step(robot.targets(q))
        check_nodes(robot, run, np.atleast_2d(q), PAD.bonded_nodes(), 1e-15)
        outputs.update(run.state)
        parts = outputs.contact_wrenches(), outputs.friction_wrenches()
        forces = np.sum([part.wrenches.numpy()[:, held, gels, :3] for part in parts], axis=0)
        momentum = outputs.momentum().linear.numpy()[:, held]
        change = (momentum - before) / DT
        assert (np.abs(forces.sum(axis=1) - change) <= 2 * residual[:, None] + 1e-9).all()
        before = momentum
    return run, forces, residual


def test_a_gripper_closes_on_a_box_with_equal_and_opposite_forces() -> None:
    robot = gripper_with_pads()
    middle = robot.link_poses("tcp", robot.rest_q)[0]
    middle[:3] += [2e-4, 1e-4, 3e-4]
    slides = [(6.1e-3, 6.2e-3), (5.9e-3, 6.0e-3), (5.8e-3, 5.9e-3), *[(5.8e-3, 5.9e-3)] * 4]
    ways = [np.array(pair)[:, None] for pair in slides]
    box = AffineBody(box_mesh((6e-3, 6e-3, 6e-3)), name="box", initial_pose=middle)
    run, force, residual = pushes_of_gels(robot, box, np.full((2, 1), 6.3e-3), ways)
    poses = run.state.poses.numpy().reshape(2, -1, 7)
    np.testing.assert_array_equal(poses, robot.targets(ways[-1]))
    push = np.linalg.norm(force, axis=2)
    assert (push > 0.2).all() and (push[0] > 1.2 * push[1]).all()
    # At rest: equal and opposite, to the residual.
    assert (np.linalg.norm(force.sum(axis=1), axis=1) <= 2 * residual + 1e-7).all()


@pytest.mark.thorough
def test_a_hand_of_turning_joints_holds_a_ball() -> None:
    """Knuckles bend in and middles out by the same angle: upright tips close on a free ball."""
    # Palm and fingers are far from the ball: the scene has the frames of the pads alone.
    robot, radius = padded_hand().touching([]), 25e-3
    assert len(robot.kinematic_bodies()) == 3

    def bent(angle: float) -> np.ndarray:
        return np.tile([0.0, angle, -angle], (1, 3))

    # The seats' distance from the axis is 35 mm - 52 mm sin(angle), the pads are 3 mm thick.
    touch = np.arcsin((35e-3 - 3e-3 - radius) / 52e-3)
    seats = robot.link_poses("pad_1", bent(touch))[0]
    assert seats[0] == pytest.approx(radius + 3e-3, abs=1e-12)
    at = np.array([0, 0, seats[2], 0, 0, 0, 1])
    ball = AffineBody(
        sphere_mesh(radius, 3e-3), name="ball", initial_pose=at, friction_coefficient=0.8
    )
    angles = (*np.linspace(touch - 0.005, touch + 0.008, 4), *[touch + 0.008] * 4)
    _, forces, _ = pushes_of_gels(robot, ball, bent(touch - 0.01), [bent(a) for a in angles])
    push = np.linalg.norm(forces[0], axis=1)
    assert (push > 0.2).all() and push.max() < 1.5 * push.min()
    assert np.linalg.norm(forces[0].sum(axis=0)) <= 1e-3 * push.max()


def test_links_without_shape_or_gel_cost_nothing() -> None:
    hand = named("three_finger_hand")
    assert len(hand.kinematic_bodies()) == 10  # Of 13 links, the seats have no shape.
    tips = hand.touching(["distal_1", "distal_2"]).mount("pad_3", GEL)
    bodies = tips.kinematic_bodies()
    assert [body.shape is None for body in bodies] == [True, False, False]
    assert tips.soft_bodies()[0].mount == bodies[0].name
    q = random_coordinates(hand, 6)
    wanted = [hand.link_poses(link, q) for link in ("pad_3", "distal_1", "distal_2")]
    np.testing.assert_allclose(tips.targets(q), np.stack(wanted, axis=1), atol=1e-15)
    assert hand.touching([]).targets(q).shape == (6, 0, 7)


def test_shapes_are_where_their_links_are(tmp_path: Path) -> None:
    """A ball has its own frame; a cylinder of a turned origin lies in that of its link."""
    ball = "<collision><geometry><sphere"
    moved = '<collision><origin xyz="0.01 0 0"/><geometry><sphere'
    robot = replace(load_urdf(write(tmp_path, CHAIN.replace(ball, moved))), link_friction=0.3)
    bodies = robot.kinematic_bodies()
    assert [body.name for body in bodies] == ["chain/arm", "chain/slide", "chain/wheel"]
    q = random_coordinates(robot, 3)
    targets = robot.targets(np.clip(q, *robot.limits.T))
    assert isinstance(bodies[1].shape, Ball) and bodies[1].friction_coefficient == 0.3
    frame = matrix_of(robot.link_poses("slide", q))
    wanted = frame[:, :3, 3] + 0.01 * frame[:, :3, 0]
    np.testing.assert_allclose(targets[:, 1, :3], wanted, atol=1e-15)
    np.testing.assert_allclose(targets[:, 2], robot.link_poses("wheel", q), atol=1e-15)
    # A ball is drawn though it has no edges, as the tips of Allegro's fingers have none.
    rest = np.clip(np.zeros(robot.dof), *robot.limits.T)
    draw_robot(robot.touching(["slide"]), rest, tmp_path / "ball.png")
    image = np.asarray(Image.open(tmp_path / "ball.png"))
    assert ((image.std(axis=2) < 6) & (image.mean(axis=2) < 200)).mean() > 0.05


def test_a_sensor_brings_its_mesh_material_and_friction(tmp_path: Path) -> None:
    mini = catalogue_profile("gelsight_mini")
    mesh = block_mesh((7, 7, 1), (25.25e-3, 20.75e-3, 4e-3))
    gel = mini.gel.replace(node_count=mesh.node_count, tet_count=mesh.tet_count)
    coarse = replace(mini, gel=gel, mesh=mesh)
    robot = named("parallel_gripper").mount("finger_left", coarse, on_seat(coarse.mesh))
    (gel,) = robot.soft_bodies()
    assert gel.mesh is coarse.mesh and gel.name == "gel of finger_left"
    assert gel.friction_coefficient == coarse.material.friction_coefficient
    assert isinstance(gel.material, Material)
    assert gel.material.young_modulus_pa == coarse.material.young_modulus_pa
    # The back lies on the seat, the contact face looks along the link's x axis.
    at = carried(matrix_of(on_seat(coarse.mesh)), coarse.mesh.nodes_m)
    assert at[:, 0].min() == pytest.approx(0, abs=1e-15)
    touched = coarse.mesh.region_nodes(Region.CONTACT)
    assert at[touched, 0] == pytest.approx(4e-3, abs=1e-15)
    # Its exported URDF is attached; the rigid gel gives way to the soft one at the same place.
    export_profile(coarse, "urdf", tmp_path / "out")
    sensor = load_urdf(tmp_path / "out" / "sensor.urdf")
    place = np.array([0.02, 0, 0.01, 0, 0, np.sqrt(0.5), np.sqrt(0.5)])
    robot = named("parallel_gripper").attach("finger_right", sensor, place, "sensor/")
    q = np.array([[0.01], [0.03]])
    names = [body.name for body in robot.kinematic_bodies()]
    rigid = names.index("parallel_gripper/sensor/gel")
    shape = robot.kinematic_bodies()[rigid].shape
    assert shape is not None and not isinstance(shape, Ball)
    hard = matrix_of(robot.targets(q)[:, rigid])

    robot = robot.mount("sensor/gel_frame", coarse, IDENTITY, "gel")
    robot = robot.touching(["palm", "finger_left", "finger_right", "sensor/sensor_link"])
    scene = Scene(robot.soft_bodies(), robot.kinematic_bodies(), 2)
    run = Run(scene, robot.targets([[0.01], [0.02]]), absolute_tolerance_n=1e-9)
    run.step(robot.targets(q))
    for soft, frame in zip(run.state.positions.numpy(), hard, strict=True):
        surface = soft[np.unique(coarse.mesh.faces)]
        gap = np.linalg.norm(surface[:, None] - carried(frame, shape.vertices_m)[None], axis=2)
        assert gap.min(axis=1).max() < 1e-8  # The STL file has single precision.


@pytest.mark.thorough
def test_a_picture_shows_gels(tmp_path: Path) -> None:
    """Blue where the pad that looks at us is, as seen along its normal."""
    robot = named("parallel_gripper").mount("finger_left", GEL, on_seat(PAD))
    for direction, seen in (((1.0, 0.0, 0.3), True), ((-1.0, 0.0, 0.3), False)):
        draw_robot(robot.touching(["finger_left"]), [0.04], tmp_path / "gel.png", direction)
        red, _, blue = np.asarray(Image.open(tmp_path / "gel.png")).astype(int).T
        assert ((blue - red > 40).mean() > 0.005) == seen


test_wrong_coordinates_and_gels_are_refused = refuses(
    lambda call: call(gripper_with_pads()),
    (lambda r: r.targets([[0.03], [0.05]]), r"0.05 of joint 'slide_left' in row 1 is out of i"),
    (lambda r: r.mount("palm", GEL, IDENTITY, "left"), "2 gels are called 'left'"),
    (lambda r: r.mount("finger", GEL), "has no link 'finger'"),
    (lambda r: r.mount("palm", replace(GEL, mount="h")), "'gel' already has a mount or a pose"),
    (
        lambda r: r.mount("palm", GEL, np.tile(IDENTITY, (2, 1))),
        r"pose of the gel on 'palm' must have shape \[7\]",
    ),
)


@pytest.mark.parametrize("name", REAL)
def test_real_robots_carry_pads(name: str) -> None:
    """Panda's hand two, Allegro's fingers four; UR5 carries our gripper with its own two."""
    tips = ["link_3.0_tip", "link_7.0_tip", "link_11.0_tip", "link_15.0_tip"]
    if name.startswith("panda"):
        tips = ["panda_leftfinger", "panda_rightfinger"]
    robot = named(name)
    if name == "ur5_gripper":
        robot = robot.touching([]).attach("tool0", gripper_with_pads(), IDENTITY, "g/")
    else:
        for link in tips:
            robot = robot.mount(link, GEL, on_seat(PAD))
    assert len(robot.soft_bodies()) == (4 if name.startswith("allegro") else 2)
    q = random_coordinates(robot, 3)
    run = Run(Scene(robot.soft_bodies(), robot.kinematic_bodies(), 3), robot.targets(q))
    check_nodes(robot, run, q, np.arange(PAD.node_count), 1e-14)
