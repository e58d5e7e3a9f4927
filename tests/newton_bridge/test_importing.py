# SPDX-License-Identifier: Apache-2.0
"""Models of newton as ours: links are where newton has them, bodies weigh the same, no guesses."""

from __future__ import annotations

from pathlib import Path

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


def test_links_of_an_mjcf_file_are_where_newton_has_them(tmp_path: Path) -> None:
    """Joints off the origin of their link, three on one body, and one that mimics another."""
    builder = read(ARM, tmp_path)
    robot = load_mjcf(tmp_path / "robot.xml")
    assert robot.base == "world" and robot.name == "robot"
    assert {"base", "upper", "fore", "finger", "thumb"} < set(robot.link_names)
    assert robot.dof == 5
    assert robot.limits[0] == pytest.approx(np.radians([-60, 80]), abs=1e-6)
    mimic = next(joint.mimic for joint in robot.joints if joint.name == "right")
    assert mimic is not None and (mimic.joint, mimic.multiplier) == ("left", 1.0)
    assert largest_difference(builder, robot) < ROUNDING


def test_a_robot_of_an_mjcf_file_weighs_what_newton_says(tmp_path: Path) -> None:
    builder = read(ARM, tmp_path)
    robot = load_mjcf(tmp_path / "robot.xml")
    masses = [link.mass.mass_kg for link in robot.links if link.mass is not None]
    assert sum(masses) == pytest.approx(sum(builder.body_mass), rel=1e-6)  # type: ignore[attr-defined]
    assert {body.name for body in robot.kinematic_bodies()} == {
        f"robot/{name}" for name in ("base", "upper", "fore", "finger", "thumb")
    }
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
        joints.append(
            builder.add_joint_prismatic(
                -1,
                link,
                parent_xform=wp.transform((0.03 * sign, 0, 0), wp.quat_identity()),
                axis=(sign, 0, 0),
                limit_lower=-0.02,
                limit_upper=0.02,
                label=f"{side} slide",
            )
        )
    builder.add_articulation(joints)
    builder.set_joint_mimic(joints[1], joints[0])
    scene = import_model(builder)
    assert scene.robot is not None
    assert scene.robot.dof_names == ["left slide"]
    assert scene.gravity_m_s2 == pytest.approx((0, 0, -9.81), abs=1e-6)
    driven = drive(scene.robot, PositionDrive(stiffness=100.0))
    assert [body.stated_mass.mass_kg for body in driven.affine_bodies if body.stated_mass] == (
        pytest.approx([0.008] * 2, rel=1e-6)
    )
    assert largest_difference(builder, scene.robot) < ROUNDING


@pytest.mark.parametrize(("file", "dof"), [("ant.usda", 8), ("cartpole.usda", 3)])
def test_links_of_a_usd_file_are_where_newton_has_them(file: str, dof: int) -> None:
    pytest.importorskip("pxr", reason="usd-core is not installed")
    robot = load_usd(ASSETS / file, floating=False)
    builder = newton.ModelBuilder()
    builder.add_usd(str(ASSETS / file), floating=False)
    assert robot.dof == dof
    assert largest_difference(builder, robot) < ROUNDING * (1 + max(1.0, reach(robot)))


def reach(robot: object) -> float:
    return max(robot.tree.length_m(link) for link in robot.link_names)  # type: ignore[attr-defined]


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
        time=TimeStepping(quasi_static=False, dt_s=0.01, gravity_m_s2=scene.gravity_m_s2),
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


def add_grid(builder: object, place: tuple[float, ...], **options: bool) -> None:
    builder.add_soft_grid(  # type: ignore[attr-defined]
        pos=wp.vec3(*place),
        rot=wp.quat_identity(),
        vel=wp.vec3(),
        dim_x=2,
        dim_y=2,
        dim_z=2,
        cell_x=0.002,
        cell_y=0.002,
        cell_z=0.002,
        density=900.0,
        k_mu=3.5e4,
        k_lambda=3.15e5,
        k_damp=0.0,
        **options,
    )


def one_link() -> tuple[object, int]:
    builder = newton.ModelBuilder()
    return builder, builder.add_link(label="arm")


def ball() -> object:
    builder, link = one_link()
    builder.add_articulation([builder.add_joint_ball(-1, link, label="hip")])  # type: ignore[attr-defined]
    return builder


def height_field() -> object:
    builder = newton.ModelBuilder()
    field = newton.Heightfield(data=np.zeros((4, 4), dtype=np.float32), nrow=4, ncol=4)
    builder.add_shape_heightfield(heightfield=field, label="hills")
    return builder


def floating() -> object:
    builder = newton.ModelBuilder()
    base, arm = builder.add_link(label="base"), builder.add_link(label="arm")
    joints = [builder.add_joint_free(base, label="free"), builder.add_joint_revolute(base, arm)]
    builder.add_articulation(joints)
    return builder


def massless() -> object:
    builder = newton.ModelBuilder()
    body = builder.add_body(label="ghost")
    cfg = newton.ModelBuilder.ShapeConfig(density=0.0)
    builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1, cfg=cfg)
    return builder


def loose_particle() -> object:
    builder = newton.ModelBuilder()
    builder.add_particle((0, 0, 0), (0, 0, 0), 1.0)
    return builder


def held_by_a_free_body() -> object:
    builder = newton.ModelBuilder()
    cube = builder.add_body(label="cube")
    builder.add_shape_box(cube, hx=0.01, hy=0.01, hz=0.01)
    add_grid(builder, (0.0, 0.0, 0.0))
    builder.add_attachment_particle_body(0, cube, body_point=(0, 0, 0))
    return builder


def stretched() -> object:
    builder, link = one_link()
    builder.add_articulation([builder.add_joint_revolute(-1, link)])  # type: ignore[attr-defined]
    add_grid(builder, (0.0, 0.0, 0.0))
    builder.add_attachment_particle_body(0, link, body_point=(0, 0, 0.001))  # type: ignore[attr-defined]
    return builder


def two_worlds() -> object:
    builder = newton.ModelBuilder()
    for _ in range(2):
        builder.add_world(held_by_a_free_body())
    return builder


@pytest.mark.parametrize(
    ("builder", "message"),
    [
        (ball, "joint 'hip' is a ball joint"),
        (height_field, "'hills' is a hfield"),
        (floating, "joint 'free' is a free joint.*floating=False"),
        (massless, "body 'ghost' moves freely and has no mass"),
        (loose_particle, "1 particles belong to no tet, such as particle 0"),
        (held_by_a_free_body, "attached to 'cube', which moves freely"),
        (stretched, "starts 0.001 m from where particle 0 is attached"),
        (two_worlds, "has 2 worlds"),
        (lambda: 3, "newton.ModelBuilder or newton.Model is needed, got int"),
    ],
)
def test_what_cannot_be_taken_over_is_refused_by_name(builder: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        import_model(builder())  # type: ignore[operator]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<mujoco><size nope='x'><worldbody>", "is not valid XML"),
        ("<mujoco><worldbody/></mujoco>", "it holds no robot"),
        (
            ARM.replace("<worldbody>", '<worldbody><geom name="floor" type="plane" size="0 0 1"/>'),
            "it holds more than a robot: .*floor",
        ),
        (
            ARM.replace("<joint joint1", '<weld body1="finger" body2="thumb"/><joint joint1'),
            "is the child of two joints",
        ),
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
