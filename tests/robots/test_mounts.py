# SPDX-License-Identifier: Apache-2.0
"""Gels on links: they are where forward kinematics says, and grip."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from taccel_lab.errors import InputError
from taccel_lab.exporters.export import export_profile
from taccel_lab.geometry import Region
from taccel_lab.geometry.block import block_mesh
from taccel_lab.model import Model
from taccel_lab.outputs import Outputs
from taccel_lab.profile import SensorProfile
from taccel_lab.robots import Robot, load_urdf, named, on_seat
from taccel_lab.robots.describe import draw_robot
from taccel_lab.robots.transforms import matrix_of, pose_of
from taccel_lab.scene import (
    AffineBody,
    Ball,
    Element,
    Material,
    Scene,
    SoftBody,
    TimeStepping,
    box_mesh,
    sphere_mesh,
)
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.solvers import SolverConfig, SolverIPC
from taccel_lab.state import State, initial_state
from tests.support.robot_files import CHAIN, REAL, random_coordinates, write

PAD = block_mesh((4, 4, 2), (8e-3, 8e-3, 3e-3), jitter=0.1)
GEL = SoftBody(PAD, Material(1e5, 0.45), friction_coefficient=0.8, element=Element.LINEAR)
DT = 0.02
TIME = TimeStepping(quasi_static=False, dt_s=DT)
IDENTITY = np.array([0, 0, 0, 0, 0, 0, 1.0])


@pytest.fixture(scope="module")
def coarse() -> SensorProfile:
    """A sensor of the catalogue on a mesh of 128 nodes."""
    mini = catalogue_profile("gelsight_mini")
    mesh = block_mesh((7, 7, 1), (25.25e-3, 20.75e-3, 4e-3))
    gel = mini.gel.replace(node_count=mesh.node_count, tet_count=mesh.tet_count)
    return replace(mini, gel=gel, mesh=mesh)


def gripper_with_pads() -> Robot:
    """Our gripper, a pad on each finger, somewhere in the world."""
    robot = named("parallel_gripper").placed([0.3, -0.1, 0.2, 0.5, 0.5, 0.5, 0.5])
    for side in ("left", "right"):
        robot = robot.mount(f"finger_{side}", GEL, on_seat(PAD), side)
    return robot


def carried(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points [n, 3] of a frame in the world; the frame at a pose [7]."""
    matrix = matrix_of(pose)
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def check_nodes(
    robot: Robot, model: Model, state: State, q: np.ndarray, nodes: np.ndarray, atol: float = 1e-15
) -> None:
    """These nodes of each gel are where the links carry them, by forward kinematics alone."""
    positions = state.positions.numpy()
    for mount in robot.mounts:
        frames = matrix_of(robot.link_poses(mount.link, q)) @ mount.link_from_gel
        first = model.bodies[model.body_id(mount.gel.name)].nodes[0]
        for env, frame in enumerate(frames):
            wanted = carried(pose_of(frame), PAD.nodes_m[nodes])
            np.testing.assert_allclose(positions[env, first + nodes], wanted, rtol=0, atol=atol)


def pushes_of_gels(
    robot: Robot, solver: SolverIPC, state: State, ways: list[np.ndarray], held: str
) -> tuple[np.ndarray, np.ndarray]:
    """Forces of the gels on a body after steps to coordinates, [env, gel, 3], and the residual.

    Between two steps the body's momentum changes by what the gels do, to the residual.
    """
    model, outputs, before = solver.model, Outputs(solver), np.zeros(3)
    body, gels = model.body_id(held), [model.body_id(m.gel.name) for m in robot.mounts]
    forces = residual = np.zeros(0)
    for q in ways:
        report = solver.step(state, robot.targets(q))
        assert report.converged.all(), report.summary()
        check_nodes(robot, model, state, np.atleast_2d(q), PAD.bonded_nodes())
        outputs.update(state)
        parts = outputs.contact_wrenches(), outputs.friction_wrenches()
        forces = np.sum([part.wrenches.numpy()[:, body, gels, :3] for part in parts], axis=0)
        momentum = outputs.momentum().linear.numpy()[:, body]
        change, residual = (momentum - before) / DT, report.residual_n
        assert (np.abs(forces.sum(axis=1) - change) <= 2 * residual[:, None] + 1e-9).all()
        before = momentum
    return forces, residual


def test_a_gripper_closes_on_a_box_with_equal_and_opposite_forces() -> None:
    robot = gripper_with_pads()
    middle = robot.link_poses("tcp", robot.rest_q)[0]
    middle[:3] += [2e-4, 1e-4, 3e-4]
    box = AffineBody(box_mesh((6e-3, 6e-3, 6e-3)), name="box", initial_pose=middle)
    scene = Scene(robot.soft_bodies(), robot.kinematic_bodies(), 2, TIME, affine_bodies=box)
    solver = SolverIPC(scene.finalize(), SolverConfig(dhat_m=5e-5, relative_tolerance=1e-6))
    state = initial_state(solver.model, robot.targets([[6.3e-3], [6.3e-3]]))
    slides = [(6.1e-3, 6.2e-3), (5.9e-3, 6.0e-3), (5.8e-3, 5.9e-3), *[(5.8e-3, 5.9e-3)] * 4]
    ways = [np.array(pair)[:, None] for pair in slides]
    force, residual = pushes_of_gels(robot, solver, state, ways, "box")
    np.testing.assert_array_equal(state.poses.numpy().reshape(2, -1, 7), robot.targets(ways[-1]))
    push = np.linalg.norm(force, axis=2)
    assert (push > 0.2).all() and (push[0] > 1.2 * push[1]).all()
    # At rest: equal and opposite, to the residual.
    assert (np.linalg.norm(force.sum(axis=1), axis=1) <= 2 * residual + 1e-7).all()


@pytest.mark.thorough
def test_a_hand_of_turning_joints_holds_a_ball() -> None:
    """Knuckles bend in and middles out by the same angle: upright tips close on a free ball."""
    robot = named("three_finger_hand")
    for k in (1, 2, 3):
        robot = robot.mount(f"pad_{k}", GEL, on_seat(PAD), f"pad {k}")
    radius = 25e-3

    def bent(angle: float) -> np.ndarray:
        return np.tile([0.0, angle, -angle], (1, 3))

    # The seats' distance from the axis is 35 mm - 52 mm sin(angle), the pads are 3 mm thick.
    touch = np.arcsin((35e-3 - 3e-3 - radius) / 52e-3)
    seats = robot.link_poses("pad_1", bent(touch))[0]
    assert seats[0] == pytest.approx(radius + 3e-3, abs=1e-12)
    ball = AffineBody(
        sphere_mesh(radius, 3e-3),
        name="ball",
        initial_pose=np.array([0, 0, seats[2], 0, 0, 0, 1]),
        friction_coefficient=0.8,
    )
    # Palm and fingers are far from the ball: the scene has the frames of the pads alone.
    robot = robot.touching([])
    scene = Scene(robot.soft_bodies(), robot.kinematic_bodies(), 1, TIME, affine_bodies=ball)
    assert len(scene.kinematic_bodies) == 3
    solver = SolverIPC(scene.finalize(), SolverConfig(dhat_m=5e-5, relative_tolerance=1e-6))
    state = initial_state(solver.model, robot.targets(bent(touch - 0.01)))
    angles = (*np.linspace(touch - 0.005, touch + 0.008, 4), *[touch + 0.008] * 4)
    forces, _ = pushes_of_gels(robot, solver, state, [bent(angle) for angle in angles], "ball")
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
    targets = tips.targets(q)
    assert targets.shape == (6, 3, 7)
    np.testing.assert_allclose(targets[:, 0], hand.link_poses("pad_3", q), atol=1e-15)
    np.testing.assert_allclose(targets[:, 2], hand.link_poses("distal_2", q), atol=1e-15)
    assert hand.touching([]).targets(q).shape == (6, 0, 7)


def test_shapes_are_where_their_links_are(tmp_path: Path) -> None:
    """A ball has its own frame; a cylinder of a turned origin lies in that of its link."""
    text = CHAIN.replace(
        "<collision><geometry><sphere", '<collision><origin xyz="0.01 0 0"/><geometry><sphere'
    )
    robot = load_urdf(write(tmp_path, text))
    robot = replace(robot, link_friction=0.3)
    bodies = {body.name: i for i, body in enumerate(robot.kinematic_bodies())}
    assert list(bodies) == ["chain/arm", "chain/slide", "chain/wheel"]
    q = random_coordinates(robot, 3)
    targets = robot.targets(np.clip(q, *robot.limits.T))
    ball = robot.kinematic_bodies()[bodies["chain/slide"]]
    assert isinstance(ball.shape, Ball) and ball.friction_coefficient == 0.3
    frame = matrix_of(robot.link_poses("slide", q))
    wanted = frame[:, :3, 3] + 0.01 * frame[:, :3, 0]
    np.testing.assert_allclose(targets[:, bodies["chain/slide"], :3], wanted, atol=1e-15)
    np.testing.assert_allclose(
        targets[:, bodies["chain/wheel"]], robot.link_poses("wheel", q), atol=1e-15
    )


def test_gels_touch_gels_and_objects_but_no_links() -> None:
    robot = gripper_with_pads()
    box = AffineBody(box_mesh((6e-3, 6e-3, 6e-3)), name="box")
    time = TimeStepping(quasi_static=False)
    scene = Scene(robot.soft_bodies(), robot.kinematic_bodies(), 1, time, affine_bodies=box)
    left, right = scene.soft_bodies
    links = [body for body in scene.kinematic_bodies if body.shape is not None]
    assert len(links) == 3
    assert scene.may_touch(left, right) and scene.may_touch(left, box)
    for link in links:
        assert scene.may_touch(link, box)
        assert not scene.may_touch(left, link) and not scene.may_touch(right, link)


def test_a_sensor_brings_its_mesh_material_and_friction(coarse: SensorProfile) -> None:
    robot = named("parallel_gripper").mount("finger_left", coarse, on_seat(coarse.mesh))
    (gel,) = robot.soft_bodies()
    assert gel.mesh is coarse.mesh and gel.name == "gel of finger_left"
    assert gel.friction_coefficient == coarse.material.friction_coefficient
    assert isinstance(gel.material, Material)
    assert gel.material.young_modulus_pa == coarse.material.young_modulus_pa
    # The back lies on the seat, the contact face looks along the link's x axis.
    at = carried(on_seat(coarse.mesh), coarse.mesh.nodes_m)
    assert at[:, 0].min() == pytest.approx(0, abs=1e-15)
    touched = coarse.mesh.region_nodes(Region.CONTACT)
    assert at[touched, 0] == pytest.approx(4e-3, abs=1e-15)


def test_the_exported_urdf_of_a_sensor_mounts(coarse: SensorProfile, tmp_path: Path) -> None:
    """Attached as a robot of its own; its rigid gel gives way to the soft one at the same place."""
    export_profile(coarse, "urdf", tmp_path / "out")
    sensor = load_urdf(tmp_path / "out" / "sensor.urdf")
    place = np.array([0.02, 0, 0.01, 0, 0, np.sqrt(0.5), np.sqrt(0.5)])
    robot = named("parallel_gripper").attach("finger_right", sensor, place, "sensor/")
    q = np.array([[0.01], [0.03]])
    rigid = {b.name: i for i, b in enumerate(robot.kinematic_bodies())}
    shape = robot.kinematic_bodies()[rigid["parallel_gripper/sensor/gel"]].shape
    assert shape is not None and not isinstance(shape, Ball)
    hard = robot.targets(q)[:, rigid["parallel_gripper/sensor/gel"]]

    robot = robot.mount("sensor/gel_frame", coarse, IDENTITY, "gel")
    robot = robot.touching(["palm", "finger_left", "finger_right", "sensor/sensor_link"])
    model = Scene(robot.soft_bodies(), robot.kinematic_bodies(), 2).finalize()
    state = initial_state(model, robot.targets([[0.01], [0.02]]))
    solver = SolverIPC(model, SolverConfig(absolute_tolerance_n=1e-9))
    assert solver.step(state, robot.targets(q)).converged.all()
    surface = np.unique(coarse.mesh.faces)
    for env in range(2):
        soft = state.positions.numpy()[env, surface]
        there = carried(hard[env], shape.vertices_m)
        gap = np.linalg.norm(soft[:, None] - there[None], axis=2).min(axis=1)
        assert gap.max() < 1e-8  # The STL file has single precision.


@pytest.mark.thorough
def test_a_picture_shows_gels(tmp_path: Path) -> None:
    """Blue where the pad that looks at us is, as seen along its normal."""
    robot = named("parallel_gripper").mount("finger_left", GEL, on_seat(PAD))
    for direction, seen in (((1.0, 0.0, 0.3), True), ((-1.0, 0.0, 0.3), False)):
        draw_robot(robot.touching(["finger_left"]), [0.04], tmp_path / "gel.png", direction)
        red, _, blue = np.asarray(Image.open(tmp_path / "gel.png")).astype(int).T
        assert ((blue - red > 40).mean() > 0.005) == seen


def test_a_ball_is_drawn(tmp_path: Path) -> None:
    """Though it has no edges, as the tips of Allegro's fingers have none."""
    robot = load_urdf(write(tmp_path, CHAIN)).touching(["slide"])
    draw_robot(robot, np.clip(np.zeros(robot.dof), *robot.limits.T), tmp_path / "ball.png")
    grey = np.asarray(Image.open(tmp_path / "ball.png")).std(axis=2) < 6
    bright = np.asarray(Image.open(tmp_path / "ball.png")).mean(axis=2)
    assert (grey & (bright < 200)).mean() > 0.05


def test_wrong_coordinates_and_gels_are_refused() -> None:
    robot = gripper_with_pads()
    for call, message in (
        (
            lambda: robot.targets([[0.03], [0.05]]),
            r"0.05 of joint 'slide_left' in row 1 is out of its lim",
        ),
        (lambda: robot.mount("palm", GEL, IDENTITY, "left"), "2 gels are called 'left'"),
        (lambda: robot.mount("finger", GEL), "has no link 'finger'"),
        (
            lambda: robot.mount("palm", replace(GEL, mount="hand")),
            "'gel' already has a mount or a pose",
        ),
        (
            lambda: robot.mount("palm", GEL, np.tile(IDENTITY, (2, 1))),
            r"pose of the gel on 'palm' must have shape \[7\]",
        ),
    ):
        with pytest.raises(InputError, match=message):
            call()


@pytest.mark.parametrize("name", REAL)
def test_real_robots_carry_pads(name: str) -> None:
    """Panda's hand two, Allegro's fingers four; UR5 carries our gripper with its own two."""
    tips = {
        "panda": ["panda_leftfinger", "panda_rightfinger"],
        "panda_hand": ["panda_leftfinger", "panda_rightfinger"],
        "ur5_gripper": [],
    }.get(name, ["link_3.0_tip", "link_7.0_tip", "link_11.0_tip", "link_15.0_tip"])
    robot = named(name)
    for link in tips:
        robot = robot.mount(link, GEL, on_seat(PAD))
    if name == "ur5_gripper":
        robot = robot.touching([]).attach("tool0", gripper_with_pads(), IDENTITY, "g/")
    assert len(robot.soft_bodies()) == max(len(tips), 2)
    model = Scene(robot.soft_bodies(), robot.kinematic_bodies(), 3).finalize()
    q = random_coordinates(robot, 3)
    state = initial_state(model, robot.targets(q))
    check_nodes(robot, model, state, q, np.arange(PAD.node_count), atol=1e-14)
