# SPDX-License-Identifier: Apache-2.0
"""What is read of a URDF file, and what is refused by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from taccel_lab.errors import InputError, InputWarning
from taccel_lab.robots import Robot, drive, load_urdf
from taccel_lab.robots.describe import describe_robot
from taccel_lab.scene import Ball, PositionDrive, TriangleMesh
from tests.files.test_triangle_file import collada
from tests.support.robot_files import CHAIN, write

TETRAHEDRON = """v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"""
WITH_MESH = """<robot name="m"><link name="a"><collision>
<geometry><mesh filename="{file}" scale="{scale}"/></geometry></collision></link></robot>"""
LINKS = """<robot name="r"><link name="base"/><link name="a">{inertial}<collision><geometry>{shape}
</geometry></collision></link><joint name="j" type="revolute"><parent link="base"/><child link="a"/>
<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="{effort}" velocity="1"/></joint></robot>"""
BOX = '<box size="0.02 0.02 0.02"/>'


def with_mesh(file: str, scale: str = "0.01 0.01 0.01") -> str:
    return WITH_MESH.format(file=file, scale=scale)


def with_link(inertial: str = "", shape: str = BOX, effort: str = "1") -> str:
    return LINKS.format(inertial=inertial, shape=shape, effort=effort)


def surface(robot: Robot, link: str = "a") -> TriangleMesh:
    """Of a link's first shape."""
    found = robot.links[robot.link_id(link)].shapes[0].surface()[0]
    assert isinstance(found, TriangleMesh)
    return found


def size(robot: Robot, link: str = "a") -> np.ndarray:
    return np.ptp(surface(robot, link).vertices_m, axis=0)


def test_limits_masses_and_shapes(tmp_path: Path) -> None:
    robot = load_urdf(write(tmp_path, CHAIN))
    # The follower, -0.8 q + 0.1 within [-1, 1], narrows its leader's [-2, 1.5] to 1.375; the slide
    # of half the lift, within 0.1, does not.
    wanted = [[-1.125, 1.375], [-0.05, 0.1], [-np.inf, np.inf]]
    np.testing.assert_allclose(robot.limits, wanted, atol=1e-12)
    assert [joint.max_effort for joint in robot.joints][:3] == [7, 50, np.inf]
    links = {link.name: link for link in robot.links}
    arm = links["arm"].mass
    assert arm is not None and arm.mass_kg == 2
    np.testing.assert_allclose(arm.center_m, [0, 0, 0.1])
    # The frame of the inertia is turned by a quarter about z: x and y change places.
    np.testing.assert_allclose(arm.inertia_kg_m2, np.diag([0.2, 0.1, 0.25]), atol=1e-15)
    inertial = """<inertial><origin rpy="0.3 0.5 0.7"/><mass value="2"/>
        <inertia ixx="0.1" iyy="0.2" izz="0.25" ixy="0.01" ixz="0.02" iyz="0.03"/></inertial>"""
    mass = load_urdf(write(tmp_path, with_link(inertial))).links[1].mass
    turn = Rotation.from_euler("xyz", [0.3, 0.5, 0.7]).as_matrix()
    given = np.array([[0.1, 0.01, 0.02], [0.01, 0.2, 0.03], [0.02, 0.03, 0.25]])
    assert mass is not None
    np.testing.assert_allclose(mass.inertia_kg_m2, turn @ given @ turn.T, atol=1e-12)
    assert links["tip"].mass is None and links["tip"].shapes == ()
    corners = surface(robot, "arm").vertices_m
    np.testing.assert_allclose(corners.min(axis=0), [-0.01, -0.015, 0], atol=1e-15)
    np.testing.assert_allclose(corners.max(axis=0), [0.01, 0.015, 0.2], atol=1e-15)
    np.testing.assert_array_equal(links["arm"].shapes[0].surface()[1], np.eye(4))
    assert links["slide"].shapes[0].surface()[0] == Ball(0.01)
    np.testing.assert_allclose(size(robot, "wheel"), [0.04, 0.01, 0.04], atol=1e-15)


@pytest.mark.parametrize(
    "name", ["mesh.obj", "../shared/mesh.obj", "package://pack/mesh.obj", "file://{folder}/m.obj"]
)
def test_mesh_files_are_found(tmp_path: Path, name: str) -> None:
    for place in ("urdf/mesh.obj", "shared/mesh.obj", "mesh.obj", "m.obj"):
        write(tmp_path / "pack", TETRAHEDRON, place)
    text = with_mesh(name.format(folder=tmp_path / "pack"))
    robot = load_urdf(write(tmp_path / "pack" / "urdf", text))
    np.testing.assert_allclose(size(robot), 0.01, atol=1e-9)
    # Packages are where one says.
    path = write(tmp_path, with_mesh("package://my_robot/shared/mesh.obj"))
    for packages, words in (
        ({}, r"packages=\{'my_robot': FOLDER\}\), or --package"),
        ({"my_robot": tmp_path}, "is not there; looked in"),
    ):
        with pytest.raises(InputError, match=words):
            load_urdf(path, packages=packages)
    robot = load_urdf(path, packages={"my_robot": tmp_path / "pack"})
    assert len(surface(robot).faces) == 4


@pytest.mark.parametrize("scale", ["0.01 0.02 0.03", "0.01 -0.02 0.03"])
@pytest.mark.parametrize("hull", [False, True])
def test_scaled_meshes_stay_outward(tmp_path: Path, scale: str, hull: bool) -> None:
    write(tmp_path, TETRAHEDRON, "mesh.obj")
    robot = load_urdf(write(tmp_path, with_mesh("mesh.obj", scale)))
    mesh = surface(robot.with_hulls() if hull else robot)
    volume = np.linalg.det(mesh.vertices_m[mesh.faces]).sum() / 6
    assert volume == pytest.approx(1e-6, rel=1e-6)


def test_a_surface_that_crosses_itself_can_be_touched_as_its_hull(tmp_path: Path) -> None:
    moved = "".join(f"v {x} {y} {z}\n" for x, y, z in np.vstack([np.zeros(3), np.eye(3)]) + 0.2)
    faces = "f 5 7 6\nf 5 6 8\nf 6 7 8\nf 7 5 8\n"
    write(tmp_path, TETRAHEDRON + moved + faces, "mesh.obj")
    robot = load_urdf(write(tmp_path, with_mesh("mesh.obj")))
    with pytest.raises(InputError, match=r"mesh\.obj: its surface intersects.*Robot\.with_hulls"):
        robot.kinematic_bodies()
    (body,) = robot.with_hulls(["a"]).kinematic_bodies()
    assert isinstance(body.shape, TriangleMesh) and len(body.shape.vertices_m) >= 6


CHANGES = {
    "planar": ('type="continuous"', 'type="planar"', "joint 'spin' is planar, which is not supp"),
    "floating": ('type="continuous"', 'type="floating"', "joint 'spin' is floating, which is not"),
    "kind": ('type="continuous"', 'type="screw"', "'spin' is of type 'screw', which URDF does not"),
    "no kind": ('name="spin" type="continuous"', 'name="spin"', "<joint> of the robot has no 'typ"),
    "no name": ('<link name="tip"/>', "<link/>", "<link> of the robot has no 'name'"),
    "axis": ('axis xyz="0 3 4"', 'axis xyz="0 0 0"', "axis of joint 'shoulder' has no length"),
    "slide": ('axis xyz="0.6 0 0.8"', 'axis xyz="0 0 2"', "axis of joint 'lift' must have length "),
    "words": ('axis xyz="0 3 4"', 'axis xyz="0 x 4"', "joint 'shoulder' must be 3 finite numbers"),
    "two": ('axis xyz="0 3 4"', 'axis xyz="3 4"', "xyz of <axis> of joint 'shoulder' must be 3"),
    "nan": ('lower="-2"', 'lower="nan"', "lower of <limit> of joint 'shoulder' must be a finite"),
    "turned": ('lower="-2"', 'lower="2"', "limits of joint 'shoulder' must be lower <= upper, got"),
    "limits": ('<limit lower="-2" upper="1.5" effort="7" velocity="1"/>', "", "has no <limit>; gi"),
    "parent": ('parent link="wheel"', 'parent link="hub"', "parent of joint 'bond' is 'hub', whic"),
    "two parents": ('child link="tip"', 'child link="thumb"', "'thumb' is the child of two joints"),
    "bases": ('<link name="tip"/>', '<link name="tip"/><link name="x"/>', "2 links are the child "),
    "ring": ('parent link="base"', 'parent link="tip"', "2 links|ring"),
    "twice": ('<link name="tip"/>', '<link name="arm"/>', "2 links are called 'arm'"),
    "mimic": ('mimic joint="shoulder"', 'mimic joint="bond"', "'follow' mimics 'bond', which is f"),
    "mimics": ('mimic joint="lift"', 'mimic joint="nail_slide"', "mimic each other in a ring"),
    "no leader": ('mimic joint="lift"', 'mimic joint="x"', "mimics 'x', which is no joint of the "),
    "apart": ('offset="0.1"', 'offset="9"', "joint 'shoulder' cannot be anywhere"),
    "capsule": ('<sphere radius="0.01"/>', "<capsule/>", "shape of link 'slide' is 'capsule'; it "),
    "radius": ('<sphere radius="0.01"/>', "<sphere/>", "<sphere> of link 'slide' has no 'radius'"),
    "mass": ('mass value="2"', 'mass value="-2"', "mass of link 'arm' must be positive, got -2 kg"),
    "inertia": ('ixx="0.1" ', "", "<inertia> of link 'arm' has no 'ixx'"),
    "element": ('<link name="tip"/>', '<link name="tip"><blob/></link>', "<blob> of link 'tip' is"),
    "copies": ("</robot>", "<include/></robot>", "<include> of the robot is not understood"),
    "drag": ('<axis xyz="0 3 4"/>', '<axis xyz="0 3 4"/><dynamics damping="-1"/>', "of at least 0"),
    "effort": ('effort="7"', 'effort="-7"', "effort of <limit> of joint 'shoulder' must be a fini"),
    "open": ("</robot>", "", "is not valid XML: no element found"),
    "type": ('<robot name="chain">', "<!DOCTYPE robot><robot name='c'>", "has a document type"),
    "macro": ("<gazebo ", "<x:macro xmlns:x='http://ros.org/wiki/xacro'/><gazebo ", "holds xacro"),
    "nameless": ('<robot name="chain">', "<robot>", "<robot> of the robot has no 'name'"),
}  # fmt: skip


TIE = """<link name="{0}"/>
<joint name="{0}" type="fixed"><parent link="{0}"/><child link="{1}"/></joint>"""
MANY = "".join(TIE.format(f"l{k}", f"l{k - 1}") for k in range(1, 9000)) + '<link name="l0"/>'
RING = TIE.format("a", "b") + TIE.format("b", "a")
TEXTS = {
    "root element": ("<sdf><model/></sdf>", "root element is <sdf>; a URDF file's is <robot>"),
    "ring beside": (f'<robot name="r"><link name="o"/>{RING}</robot>', "'a', 'b' carry each other"),
    "many": (f'<robot name="r">{MANY}</robot>', "has 9,000 links; up to 2,500 are allowed"),
    "no stl": (with_mesh("x.stl"), r"mesh file 'x\.stl' is not there; looked in"),
    "no package": (with_mesh("package://other/x.stl"), "'package://other/x.stl' is not there"),
    "mesh": (with_mesh("x.3ds"), r"collision mesh 'x\.3ds' of link 'a' is of a kind that is not r"),
}


@pytest.mark.parametrize("case", [*CHANGES, *TEXTS])
def test_what_cannot_be_taken_over_is_said(tmp_path: Path, case: str) -> None:
    if case in CHANGES:
        old, new, message = CHANGES[case]
        assert old in CHAIN
        text = CHAIN.replace(old, new)
    else:
        text, message = TEXTS[case]
    path = write(tmp_path, text)
    with pytest.raises(InputError, match=message) as error:
        load_urdf(path)
    assert str(path) in str(error.value) and "\n" not in str(error.value)
    if case == "mesh":  # Shapes can be left out.
        (link,) = load_urdf(path, shapes=False).links
        assert link.name == "a" and link.shapes == ()
    with pytest.raises(InputError, match="does not exist; expected a URDF file"):
        load_urdf(tmp_path / "none.urdf")


@pytest.mark.parametrize("inertial", ["", '<inertial><origin xyz="0 0 0.001"/></inertial>'])
def test_links_without_mass_and_drives_without_effort(tmp_path: Path, inertial: str) -> None:
    """Mass is that of the shapes, effort has no limit."""
    path = write(tmp_path, with_link(inertial, effort="0"))
    with pytest.warns(InputWarning) as warned:
        robot = load_urdf(path)
    words = " ".join(str(warning.message) for warning in warned)
    assert "effort=\"0\" of joint 'j' is taken as no limit" in words
    assert ("has no <mass>" in words) == bool(inertial)
    assert robot.joints[0].max_effort == np.inf
    with pytest.warns(InputWarning, match=r"'a' states no mass: .* 1000 kg/m\^3 weigh 0.008 kg"):
        (body,) = drive(robot, PositionDrive(1.0, 0.01)).affine_bodies
    mass = body.stated_mass
    assert mass is not None and mass.mass_kg == pytest.approx(8e-3)
    np.testing.assert_allclose(mass.inertia_kg_m2, 8e-3 * 0.02**2 / 6 * np.eye(3), atol=1e-12)


def test_a_mesh_in_millimetres_is_shown_and_asked_about(tmp_path: Path) -> None:
    write(tmp_path, TETRAHEDRON, "part.obj")
    large, small = (
        describe_robot(load_urdf(write(tmp_path, with_mesh("part.obj", f"{s} {s} {s}"))))
        for s in (20.0, 0.02)
    )
    (sentence,) = large["refused"]
    assert "20 m across" in sentence and "20 mm if its numbers are millimetres" in sentence
    assert small["refused"] == []
    assert small["links"]["a"]["shapes"] == ["part.obj 20 x 20 x 20 mm"]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("package://pack/../mesh.obj", "leads out of it"),
        ("package://pack//mesh.obj", "absolute path"),
        ("package://pack/link.obj", "is a link out of"),
        ("link.obj", "is a link out of"),
    ],
)
def test_meshes_of_a_package_lie_in_it(name: str, message: str, tmp_path: Path) -> None:
    write(tmp_path, TETRAHEDRON, "mesh.obj")
    path = write(tmp_path / "pack", with_mesh(name))
    (tmp_path / "pack" / "link.obj").symlink_to("../mesh.obj")
    with pytest.raises(InputError, match=message):
        load_urdf(path)


def test_collada_is_turned_to_z_up_unless_as_drawn(tmp_path: Path) -> None:
    """Of 2 x 3 x 4 mm, the longest edge along z of the file."""
    write(tmp_path, collada(place="", up="Y_UP"), "part.dae")
    path = write(tmp_path, with_link(shape='<mesh filename="part.dae"/>'))
    with pytest.warns(InputWarning, match="says Y_UP, so it is turned to z up"):
        np.testing.assert_allclose(size(load_urdf(path)), [2e-3, 4e-3, 3e-3], rtol=1e-6)
    drawn = size(load_urdf(path, as_drawn=True))
    np.testing.assert_allclose(drawn, [2e-3, 3e-3, 4e-3], rtol=1e-6)
