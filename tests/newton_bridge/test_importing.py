# SPDX-License-Identifier: Apache-2.0
"""Models of newton as ours: links are where newton has them, bodies weigh the same, no guesses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import warp as wp

from taccel_lab.bodies.mass_properties import mass_properties
from taccel_lab.cli import app
from taccel_lab.errors import InputError
from taccel_lab.newton_bridge import import_model, load_mjcf, load_usd
from taccel_lab.robots import drive
from taccel_lab.scene import PositionDrive, Scene, TimeStepping, TriangleMesh, box_mesh
from tests.newton_bridge.models import ARM, ASSETS, largest_difference, newton, read

ROUNDING = 5e-7
"""Of FP32 over a chain of a few joints of up to 1 m: some 1.2e-7 each."""


FINGER = (
    ([0.5, 0.1, -0.7, 0.6, 0.03], [0.204447, 0.349613, 0.478762],
     [0.362121, -0.004893, 0.38063, 0.850861]),
    ([-0.4, -0.05, 0.9, -0.3, 0.01], [0.204588, 0.266342, 0.263438],
     [0.602268, 0.59447, 0.516112, 0.132316]),
)  # fmt: skip
"""Coordinates of ``ARM``, and where mj_kinematics of MuJoCo 4.0.0 has its finger: place and
quaternion, w first. Newton turns the three joints of one body about one point."""


@pytest.mark.thorough
def test_a_robot_of_an_mjcf_file_is_where_mujoco_has_it(tmp_path: Path) -> None:
    """Joints off the origin of their link, three on one body, and one that mimics another."""
    builder = read(ARM, tmp_path)
    robot = load_mjcf(tmp_path / "robot.xml")
    assert robot.base == "world" and robot.name == "robot" and robot.dof == 5
    names = {"base", "upper", "fore", "finger", "thumb"}
    assert names < set(robot.link_names)
    assert {body.name for body in robot.kinematic_bodies()} == {f"robot/{name}" for name in names}
    assert robot.limits[0] == pytest.approx(np.radians([-60, 80]), abs=1e-6)
    mimic = next(joint.mimic for joint in robot.joints if joint.name == "right")
    assert mimic is not None and (mimic.joint, mimic.multiplier) == ("left", 1.0)
    assert robot.dof_names == ["shoulder", "out", "roll", "tilt", "left"]
    for q, place, turn in FINGER:
        x, y, z, *rest, w = robot.forward_kinematics([q])[0, robot.link_id("finger")].tolist()
        assert [x, y, z, w, *rest] == pytest.approx([*place, *turn], abs=1e-6)
    masses = [link.mass.mass_kg for link in robot.links if link.mass is not None]
    assert sum(masses) == pytest.approx(sum(builder.body_mass), rel=1e-6)
    for link in robot.links:
        for shape in link.shapes:
            surface, _ = shape.surface()
            if isinstance(surface, TriangleMesh):
                # MuJoCo's default density; 64 edges around a cylinder, 20 around what is round.
                volume = mass_properties(surface, 1.0).volume_m3
                assert link.mass is not None
                assert link.mass.mass_kg == pytest.approx(1000 * volume, rel=0.02)


def test_a_gripper_of_newton_is_driven(tmp_path: Path) -> None:
    builder = newton.ModelBuilder()
    joints = []
    for side, sign in (("left", 1.0), ("right", -1.0)):
        link = builder.add_link(label=side)
        builder.add_shape_box(link, hx=0.005, hy=0.01, hz=0.02)
        at = wp.transform((0.03 * sign, 0, 0), wp.quat_identity())
        options = {"limit_lower": -0.02, "limit_upper": 0.02, "label": f"{side} slide"}
        axis = (sign, 0, 0)
        slide = builder.add_joint_prismatic(-1, link, parent_xform=at, axis=axis, **options)
        joints.append(slide)
    builder.add_articulation(joints)
    builder.set_joint_mimic(joints[1], joints[0])
    scene = import_model(builder)
    assert scene.robot is not None
    assert scene.robot.dof_names == ["left slide"]
    assert scene.gravity_m_s2 == pytest.approx((0, 0, -9.81), abs=1e-6)
    driven = drive(scene.robot, PositionDrive(stiffness=100.0))
    masses = [body.stated_mass.mass_kg for body in driven.affine_bodies if body.stated_mass]
    assert masses == pytest.approx([0.008] * 2, rel=1e-6)
    assert largest_difference(builder, scene.robot) < ROUNDING


@pytest.mark.parametrize(("file", "dof"), [("ant.usda", 8), ("cartpole.usda", 3)])
def test_links_of_a_usd_file_are_where_newton_has_them(file: str, dof: int) -> None:
    pytest.importorskip("pxr", reason="usd-core is not installed")
    robot = load_usd(ASSETS / file, floating=False)
    builder = newton.ModelBuilder()
    builder.add_usd(str(ASSETS / file), floating=False)
    assert robot.dof == dof
    reach = max(robot.tree.length_m(link) for link in robot.link_names)
    assert largest_difference(builder, robot) < ROUNDING * (1 + max(1.0, reach))


def test_free_bodies_planes_and_gels_are_taken_over() -> None:
    builder = newton.ModelBuilder()
    cube = builder.add_body(xform=wp.transform((0.1, 0.2, 0.3), wp.quat_identity()), label="cube")
    cfg = newton.ModelBuilder.ShapeConfig(density=1200.0, mu=0.7)
    builder.add_shape_box(cube, hx=0.01, hy=0.02, hz=0.03, cfg=cfg)
    builder.add_ground_plane(height=-0.1)
    finger = builder.add_link(label="finger")
    builder.add_shape_box(finger, hx=0.01, hy=0.01, hz=0.01)
    builder.add_articulation([builder.add_joint_revolute(-1, finger, axis=(0, 0, 1))])
    add_grid(builder, (0.0, 0.0, 0.012))
    for i in range(9):
        builder.add_attachment_particle_body(i, finger, body_point=builder.particle_q[i])
    loose = len(builder.particle_q)
    add_grid(builder, (0.5, 0.0, 0.0), fix_left=True)
    scene = import_model(builder)

    (body,) = scene.affine_bodies
    solid = body.mass_properties()
    assert (body.name, body.friction_coefficient) == ("cube", pytest.approx(0.7))
    assert solid.mass_kg == pytest.approx(1200 * 0.02 * 0.04 * 0.06, rel=1e-6)
    assert body.initial_pose == pytest.approx([0.1, 0.2, 0.3, 0, 0, 0, 1], abs=1e-7)
    (plane,) = scene.planes
    assert plane.point_m == pytest.approx((0, 0, -0.1)) and plane.normal == (0, 0, 1)

    assert scene.robot is not None
    (carried,) = scene.robot.soft_bodies()
    assert scene.robot.mounts[0].link == "finger"
    assert carried.bonded().tolist() == list(range(9))
    assert carried.mesh.nodes_m[0] == pytest.approx(np.array(builder.particle_q[0]), abs=1e-7)
    (gel,) = scene.soft_bodies
    assert gel.mesh.node_count == len(builder.particle_q) - loose
    assert len(gel.bonded()) == 9
    for made in (carried, gel):
        # mu = 3.5e4 Pa and lambda = 3.15e5 Pa are those of E = 1e5 Pa within 0.5 % and nu = 0.45.
        assert made.material.young_modulus_pa == pytest.approx(1.015e5, rel=1e-6)
        assert made.material.poisson_ratio == pytest.approx(0.45, rel=1e-6)
        # Newton's grid gives each of the 27 particles the mass of one of the 8 cells.
        shares = np.bincount(made.mesh.tets.ravel(), np.repeat(made.mesh.volumes_m3() / 4, 4))
        free = np.ones(27, bool) if made is carried else ~np.isin(np.arange(27), made.bonded())
        mass = made.material.density_kg_m3 * shares[free].sum()
        assert mass == pytest.approx(free.sum() * 900 * 0.002**3, rel=1e-5)
    model = Scene(
        [*scene.robot.soft_bodies(), *scene.soft_bodies],
        scene.robot.kinematic_bodies(),
        affine_bodies=scene.affine_bodies,
        planes=scene.planes,
        time=TimeStepping(False, 0.01, scene.gravity_m_s2),
    ).finalize("cpu")
    assert model.soft_count == len(builder.particle_q)


@pytest.mark.parametrize("hull", [False, True])
def test_meshes_are_closed_where_newton_splits_their_vertices(hull: bool) -> None:
    """A box of which each triangle has vertices of its own, at twice its size."""
    box = box_mesh((0.02, 0.03, 0.04))
    points = box.vertices_m[box.faces].reshape(-1, 3).astype(np.float32)
    mesh = newton.Mesh(points, np.arange(len(points), dtype=np.int32))
    builder = newton.ModelBuilder()
    body = builder.add_body(label="box")
    add = builder.add_shape_convex_hull if hull else builder.add_shape_mesh
    add(body, mesh=mesh, scale=(2.0, 2.0, 2.0))
    (taken,) = import_model(builder).affine_bodies
    assert mass_properties(taken.shape, 1.0).volume_m3 == pytest.approx(8 * 2.4e-5, rel=1e-6)
    assert len(taken.shape.vertices_m) == 8


def add_grid(builder: Any, place: tuple[float, ...], **options: bool) -> None:
    sizes = {f"dim_{axis}": 2 for axis in "xyz"} | {f"cell_{axis}": 0.002 for axis in "xyz"}
    material = {"density": 900.0, "k_mu": 3.5e4, "k_lambda": 3.15e5, "k_damp": 0.0}
    still = {"rot": wp.quat_identity(), "vel": wp.vec3()}
    builder.add_soft_grid(pos=wp.vec3(*place), **still, **sizes, **material, **options)


def ball(builder: Any, link: int) -> None:
    builder.add_articulation([builder.add_joint_ball(-1, link, label="hip")])


def height_field(builder: Any, link: int) -> None:
    field = newton.Heightfield(data=np.zeros((4, 4), dtype=np.float32), nrow=4, ncol=4)
    builder.add_shape_heightfield(heightfield=field, label="hills")


def floating(builder: Any, link: int) -> None:
    base = builder.add_link(label="base")
    free = builder.add_joint_free(base, label="free")
    builder.add_articulation([free, builder.add_joint_revolute(base, link)])


def massless(builder: Any, link: int) -> None:
    body = builder.add_body(label="ghost")
    cfg = newton.ModelBuilder.ShapeConfig(density=0.0)
    builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1, cfg=cfg)


def loose_particle(builder: Any, link: int) -> None:
    builder.add_particle((0, 0, 0), (0, 0, 0), 1.0)


def held_by_a_free_body(builder: Any, link: int) -> None:
    cube = builder.add_body(label="cube")
    builder.add_shape_box(cube, hx=0.01, hy=0.01, hz=0.01)
    add_grid(builder, (0.0, 0.0, 0.0))
    builder.add_attachment_particle_body(0, cube, body_point=(0, 0, 0))


def stretched(builder: Any, link: int) -> None:
    builder.add_articulation([builder.add_joint_revolute(-1, link)])
    add_grid(builder, (0.0, 0.0, 0.0))
    builder.add_attachment_particle_body(0, link, body_point=(0, 0, 0.001))


def two_worlds(builder: Any, link: int) -> None:
    for _ in range(2):
        world = newton.ModelBuilder()
        held_by_a_free_body(world, 0)
        builder.add_world(world)


LINKED = (ball, floating, stretched)
"""Those that begin with a link."""


@pytest.mark.parametrize(
    ("add", "message"),
    [
        (ball, "joint 'hip' is a ball joint"),
        (height_field, "'hills' is a hfield"),
        (floating, "joint 'free' is a free joint.*floating=False"),
        (massless, "body 'ghost' moves freely and has no mass"),
        (loose_particle, "1 particles belong to no tet, such as particle 0"),
        (held_by_a_free_body, "attached to 'cube', which moves freely"),
        (stretched, "starts 0.001 m from where particle 0 is attached"),
        (two_worlds, "has 2 worlds"),
        (None, "newton.ModelBuilder or newton.Model is needed, got int"),
    ],
)
def test_what_cannot_be_taken_over_is_refused_by_name(add: Any, message: str) -> None:
    builder = newton.ModelBuilder()
    if add is not None:
        add(builder, builder.add_link(label="arm") if add in LINKED else -1)
    with pytest.raises(InputError, match=message):
        import_model(builder if add is not None else 3)


FLOOR = '<worldbody><geom name="floor" type="plane" size="0 0 1"/>'
WELD = '<weld body1="finger" body2="thumb"/><joint joint1'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<mujoco><size nope='x'><worldbody>", "is not valid XML"),
        ("<mujoco><worldbody/></mujoco>", "it holds no robot"),
        (ARM.replace("<worldbody>", FLOOR), "it holds more than a robot: .*floor"),
        (ARM.replace("<joint joint1", WELD), "<weld> in <equality>, which binds bodies, is not"),
    ],
)
def test_files_of_anything_but_a_robot_are_refused(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.xml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=f"bad.xml.* {message}"):
        load_mjcf(path)


def test_the_command_shows_an_mjcf_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "arm.xml"
    path.write_text(ARM, encoding="utf-8")
    assert app.main(["robot", "show", str(path)]) == 0
    printed = capsys.readouterr().out
    assert "arm: 5 coordinates, base world" in printed
    assert "capsule r 10, length 120 mm" in printed
