# SPDX-License-Identifier: Apache-2.0
"""What MJCF files may hold: all of it is understood, has no influence, or is refused by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.newton_bridge import load_mjcf
from tests.newton_bridge.test_robot_files import stl

pytest.importorskip("newton", reason="newton is not installed")

GRIPPER = """
<mujoco model="gripper">
  <compiler angle="radian" meshdir="assets" autolimits="true"/>
  <option cone="elliptic" impratio="10" timestep="0.002"><flag gravity="disable"/></option>
  <size nkey="1"/>
  <statistic center="0 0 0.1" extent="0.4"/>
  <visual><global azimuth="120"/><rgba haze="0 0 0 1"/></visual>
  <default class="main">
    <geom density="500"/>
    <default class="gripper">
      <joint type="slide" axis="1 0 0" range="0 0.04" armature="0.1" damping="2"/>
      <general biastype="affine" forcerange="-5 5"/>
      <default class="visual">
        <geom type="mesh" contype="0" conaffinity="0" group="2" material="black"/>
      </default>
      <default class="collision">
        <geom type="box" size="0.01 0.02 0.03" group="3" friction="1 0.01" condim="4"/>
        <default class="pad"><geom size="0.005" solref="0.004 1"/></default>
      </default>
    </default>
  </default>
  <asset>
    <material name="black" rgba="0 0 0 1" texture="grid"/>
    <texture name="grid" type="2d" builtin="checker" width="8" height="8"/>
    <mesh file="base.stl" scale="0.5 0.5 0.5"/>
    <hfield name="ground" nrow="4" ncol="4" size="1 1 1 1"/>
  </asset>
  <worldbody>
    <light pos="0 0 1" directional="true"/>
    <camera name="side" pos="1 0 0" xyaxes="0 1 0 0 0 1"/>
    <body name="base" childclass="gripper" gravcomp="1">
      <inertial pos="0 0 0.01" mass="0.75" diaginertia="1e-3 2e-3 2e-3"/>
      <geom class="visual" mesh="base"/>
      <geom class="collision"/>
      <site name="tool" pos="0 0 0.1"/>
      <body name="left">
        <joint name="left"/>
        <geom class="pad" name="left_pad"/>
        <geom name="rod" type="capsule" fromto="0 0 0 0 0 0.1" size="0.004"/>
      </body>
      <frame euler="0 0 3.14159265358979">
        <body name="right"><include file="right.xml"/></body>
      </frame>
    </body>
  </worldbody>
  <contact><exclude body1="base" body2="left"/><pair geom1="left_pad" geom2="right_pad"/></contact>
  <tendon><fixed name="split"><joint joint="left" coef="0.5"/></fixed></tendon>
  <equality>
    <joint joint1="right" joint2="left" polycoef="0 1 0 0 0" solimp="0.95 0.99 0.001"/>
    <weld body1="left" body2="right" active="false"/>
  </equality>
  <actuator><general class="gripper" name="fingers" tendon="split"/></actuator>
  <sensor><jointpos joint="left"/><force site="tool"/></sensor>
  <keyframe><key name="open" qpos="0.04 0.04"/></keyframe>
  <custom><numeric name="n" data="1"/></custom>
</mujoco>
"""
RIGHT = '<mujocoinclude><joint name="right"/><geom class="pad" name="right_pad"/>{}</mujocoinclude>'


def written(folder: Path, text: str, right: str = "") -> Path:
    (folder / "assets").mkdir()
    (folder / "assets" / "base.stl").write_bytes(stl())
    (folder / "right.xml").write_text(RIGHT.format(right))
    (folder / "gripper.xml").write_text(text)
    return folder / "gripper.xml"


def test_a_robot_as_they_are_published_is_read_with_what_its_defaults_say(tmp_path: Path) -> None:
    """Masses are those of MuJoCo 4.0.0."""
    robot = load_mjcf(written(tmp_path, GRIPPER))
    assert robot.link_names == ["world", "base", "left", "right"] and robot.dof_names == ["left"]
    np.testing.assert_allclose(robot.limits, [[0, 0.04]], atol=1e-8)
    masses = [link.mass.mass_kg for link in robot.links if link.mass is not None]
    assert masses == pytest.approx([0.75, 0.01464732, 0.012], rel=1e-5)
    assert [len(link.shapes) for link in robot.links] == [0, 1, 2, 1]
    left, right = robot.forward_kinematics([[0.03]])[0, 2:, :3]
    assert left.tolist() == pytest.approx([0.03, 0, 0], abs=1e-7)
    assert right.tolist() == pytest.approx([-0.03, 0, 0], abs=1e-7)


def test_joints_of_one_body_move_it_in_their_order(tmp_path: Path) -> None:
    """A quarter about a point 0.1 m from its origin, then 0.2 m along what was x."""
    path = tmp_path / "two.xml"
    path.write_text(
        '<mujoco><worldbody><body name="a" pos="0.5 0 1"><geom size="0.01"/>'
        '<joint name="turn" pos="0.1 0 0"/><joint name="slide" type="slide" axis="1 0 0"/>'
        "</body></worldbody></mujoco>"
    )
    robot = load_mjcf(path)
    assert robot.dof_names == ["turn", "slide"]
    place = robot.forward_kinematics([[np.pi / 2, 0.2]])[0, robot.link_id("a"), :3]
    assert place.tolist() == pytest.approx([0.6, 0.1, 1.0], abs=1e-7)


BASE, LEFT = '<site name="tool" pos="0 0 0.1"/>', '<joint name="left"/>'
SECTION = "<contact>"
COMPILER = '<compiler angle="radian"'


def joint(attributes: str) -> tuple[str, str]:
    return LEFT, f'<joint name="left" {attributes}/>'


def geom(attributes: str) -> tuple[str, str]:
    return BASE, f"<geom {attributes}/>"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (BASE, '<replicate count="50"><geom size="0.1"/></replicate>',
         "<replicate> in body 'base' is not understood"),
        (BASE, '<composite type="cable"/>', "<composite> in body 'base' is not understood"),
        (BASE, '<flexcomp name="f" type="grid"/>', "<flexcomp> in body 'base' is not understood"),
        (BASE, '<attach model="m" prefix="p"/>', "<attach> in body 'base' is not understood"),
        (BASE, '<plugin plugin="p"/>', "<plugin> in body 'base' is not understood"),
        (BASE, "<blob/>", "<blob> in body 'base' is not understood"),
        (BASE, "<frame><joint/></frame>", "<joint> in body 'base' is not understood"),
        (BASE, '<frame scale="2"/>', "scale of <frame> in body 'base' is not understood"),
        (BASE, '<body mocap="true"/>', "mocap of <body> in body 'base' must be false"),
        (BASE, '<body name="left"/>', "two elements <body> are called 'left'"),
        (BASE, '<body childclass="none"/>', "childclass 'none' of <body> has no defaults"),
        (BASE, '<body quat="1 0 0 0" euler="0 0 0"/>', "in body 'base' states more than one of"),
        (BASE, '<body pos="0 0"/>', "pos of <body> in body 'base' must be 3 numbers"),
        (SECTION, "<deformable><flex/></deformable><contact>", "<flex> in <deformable> is not"),
        (SECTION, "<blob/><contact>", "<blob> in the file is not understood"),
        (SECTION, "<option><flag limit='disable'/></option><contact>", "limit of <flag> must be"),
        (COMPILER, '<compiler settotalmass="3" angle="radian"', "settotalmass of <compiler>"),
        (COMPILER, '<compiler eulerseq="xyq" angle="radian"', "eulerseq of <compiler> must be"),
        (COMPILER, '<compiler angle="grad"', "angle of <compiler> in the file must be degree or"),
        ('"0 1 0 0 0"', '"0 1 0.2 0 0"', "polycoef of <joint> '' in <equality> must be linear"),
        (' joint2="left"', "", "joint2 of <joint> '' in <equality> must be the name of a joint"),
        (' active="false"', "", "<weld> in <equality>, which binds bodies, is not understood"),
        ('name="split"', 'name="split" range="0 1"', "range of tendon 'split' is not understood"),
        (*joint('range="30 -30"'), "range of <joint> 'left' in body 'left' must be two numbers"),
        (*joint('range="0 0" limited="true"'), "range of <joint> 'left' in body 'left' must be"),
        (*joint('ref="nan"'), "ref of <joint> 'left' in body 'left' must be finite numbers"),
        (*joint('armature="nan"'), "armature of <joint> 'left' in body 'left' must be finite"),
        (*joint('damping="inf"'), "damping of <joint> 'left' in body 'left' must be finite"),
        (*joint('damping="-1"'), "damping of <joint> 'left' in body 'left' must be at least 0"),
        (*joint('type="screw"'), "type of <joint> 'left' in body 'left' must be hinge or slide"),
        (*joint('limited="yes"'), "limited of <joint> 'left' in body 'left' must be true or"),
        (*joint('class="none"'), "<joint> is of class 'none', which has no defaults"),
        (*geom('size="0.1" friction="-1 0 0"'), "friction of <geom> in body 'base' must be at"),
        (*geom('size="0.1" shellinertia="true"'), "shellinertia of <geom> in body 'base' must be"),
        (*geom('size="0.1" surfacevel="1 0 0"'), "surfacevel of <geom> in body 'base' must be 0"),
        (*geom('size="0.1" blob="1"'), "blob of <geom> in body 'base' is not understood"),
        (*geom('type="box" size="0.1"'), "size of <geom> '' in body 'base' must be 3 numbers"),
        (*geom('type="box" fromto="0 0 0 0 0 1" size="1"'), "fromto of <geom> '' in body 'base'"),
        (*geom('type="mesh" mesh="none"'), "in body 'base' is of mesh 'none', which is not there"),
        (*geom('type="hfield" hfield="ground"'), "type of <geom> in body 'base' must be plane or"),
        (*geom('size="0.1" contype="1.5"'), "contype of <geom> in body 'base' must be whole"),
        ('mass="0.75"', 'mass="-1"', "mass of <inertial> in body 'base' must be at least 0"),
        ('mass="0.75" ', "", "mass of <inertial> in body 'base' must be above 0"),
        ('class="main"', 'class="other"', "a class of defaults is called 'other'"),
        ('<default class="pad">', '<default class="visual">', "two classes of defaults are called"),
        ("<geom density", "<blob/><geom density", "<blob> in defaults 'main' is not understood"),
    ],
)  # fmt: skip
def test_what_is_not_understood_is_refused_by_name(
    old: str, new: str, message: str, tmp_path: Path
) -> None:
    assert GRIPPER.count(old) == 1
    with pytest.raises(InputError, match=f"gripper.xml.*{message}"):
        load_mjcf(written(tmp_path, GRIPPER.replace(old, new)))


def test_an_included_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"right.xml: <blob> in body 'right' is not understood"):
        load_mjcf(written(tmp_path, GRIPPER, "<blob/>"))


def test_options_that_hide_something_are_refused(tmp_path: Path) -> None:
    path = written(tmp_path, GRIPPER.replace(BASE, ""))
    with pytest.raises(InputError, match="visual_classes is not taken: contype and conaffinity"):
        load_mjcf(path, visual_classes=("pad",))
    path.write_text('<mujoco><worldbody><body name="a"><joint/></body></worldbody></mujoco>')
    with pytest.raises(InputError, match="take the place of joints of the first bodies, such as"):
        load_mjcf(path, floating=False)


@pytest.mark.parametrize(
    ("inner", "message"),
    [
        ('<geom size="0.01"/>' * 49_000, "has 2,001 geoms; up to 2,000 are allowed"),
        ("<body/>" * 9_000, "has 1,001 bodies; up to 1,000 are allowed"),
        ("<joint/>" * 1001, "has 1,001 bodies; up to 1,000 are allowed"),
        ('<geom type="hfield" hfield="h"/>', "type of <geom> in body 'a' must be plane or"),
    ],
    ids=["geoms", "bodies", "joints", "height field"],
)
def test_a_small_file_that_takes_newton_minutes_is_refused_at_once(
    inner: str, message: str, tmp_path: Path
) -> None:
    """A height field of 8 bytes may state 2^40 numbers."""
    (tmp_path / "h.bin").write_bytes(np.array([1 << 20, 1 << 20], np.int32).tobytes())
    (tmp_path / "many.xml").write_text(
        '<mujoco><asset><hfield name="h" size="1 1 1 1" file="h.bin"/></asset><worldbody>'
        f'<body name="a">{inner}</body></worldbody></mujoco>'
    )
    with pytest.raises(InputError, match=f"many.xml.*{message}"):
        load_mjcf(tmp_path / "many.xml")
