# SPDX-License-Identifier: Apache-2.0
"""Robots of others: what their files name lies in their own folder, and a damaged one is a
sentence."""

from __future__ import annotations

import os
import struct
import zipfile
from pathlib import Path
from typing import Any

import pytest

from taccel_lab.cli import app
from taccel_lab.errors import InputError
from taccel_lab.files.xml_file import MAX_ELEMENTS
from taccel_lab.newton_bridge import load_mjcf, load_usd
from taccel_lab.printable import words_of
from taccel_lab.scene import box_mesh

pytest.importorskip("newton", reason="newton is not installed")
SECRET = "found_elsewhere"
BODY = '<body name="{}"><geom type="sphere" size="0.05"/>{}</body>'


def mjcf(head: str = "", inner: str = "", tag: str = "mujoco") -> str:
    return f"<{tag}>{head}<worldbody>{BODY.format('hand', inner)}</worldbody></{tag}>"


def mesh(attributes: str, head: str = "") -> str:
    return mjcf(
        f'{head}<asset><mesh name="m" {attributes}/></asset>', '<geom type="mesh" mesh="m"/>'
    )


def stl() -> bytes:
    box = box_mesh((0.02, 0.02, 0.02))
    corners = box.vertices_m[box.faces].astype("<f4")
    rows = [struct.pack("<12fH", 0, 0, 0, *triangle.ravel(), 0) for triangle in corners]
    return b"".ljust(80) + struct.pack("<I", len(rows)) + b"".join(rows)


def obj(head: str) -> str:
    box = box_mesh((0.02, 0.02, 0.02))
    points = ["v {:g} {:g} {:g}".format(*point) for point in box.vertices_m]
    return "\n".join([head, *points, *("f {} {} {}".format(*(f + 1)) for f in box.faces)]) + "\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A robot's folder, with a file and a mesh beside it that are not the robot's."""
    elsewhere = f"<mujocoinclude><worldbody>{BODY.format(SECRET, '')}</worldbody></mujocoinclude>"
    (tmp_path / "secret.xml").write_text(elsewhere)
    (tmp_path / "secret.stl").write_bytes(stl())
    (tmp_path / "secret.usda").write_text(f'#usda 1.0\ndef Cube "{SECRET}" {{}}\n')
    (tmp_path / "robot" / "sub").mkdir(parents=True)
    return tmp_path / "robot"


MESH_OUT = mesh('file="../secret.stl"')
FIRST_DIRECTORY = '<compiler angle="radian"/><compiler meshdir=".."/>'


@pytest.mark.parametrize(
    "text",
    [
        mjcf('<include file="../secret.xml"/>'),
        mjcf('<include file="{above}/secret.xml"/>'),
        mjcf('<include file="file://{above}/secret.xml"/>'),
        mjcf('<include file="link.xml"/>'),
        mjcf('<include file="elsewhere/secret.xml"/>'),
        mjcf('<include file="sub/nested.xml"/>'),
        MESH_OUT,
        mesh('file="secret.stl"', '<compiler meshdir=".."/>'),
        mesh('file="secret.stl"', '<compiler meshdir="{above}"/>'),
        mesh('file="secret.stl"', '<compiler assetdir="elsewhere"/>'),
        mesh('file="secret.stl"', FIRST_DIRECTORY),
        mesh("", '<default><mesh file="../secret.stl"/></default>'),
        mjcf('<asset><texture name="t" type="2d" file="../secret.png"/></asset>'),
        mjcf('<asset><texture name="t" type="cube" fileup="/secret.png"/></asset>'),
        mjcf('<asset><hfield name="h" size="1 1 1 1" file="../secret.png"/></asset>'),
        mjcf('<asset><skin name="s" file="/etc/passwd"/></asset>'),
    ],
)
def test_an_mjcf_file_names_nothing_outside_its_folder(text: str, folder: Path) -> None:
    (folder / "link.xml").symlink_to("../secret.xml")
    (folder / "elsewhere").symlink_to("..")
    (folder / "sub" / "nested.xml").write_text(
        '<mujoco><include file="../../secret.xml"/></mujoco>'
    )
    (folder / "hand.xml").write_text(text.replace("{above}", str(folder.parent)))
    with pytest.raises(InputError, match=r"hand.xml: <.*(relative|lead|link out|address)") as found:
        load_mjcf(folder / "hand.xml")
    assert SECRET not in str(found.value)


def test_an_mjcf_file_of_several_parts_is_one_robot(folder: Path) -> None:
    """Included files name theirs from where they are; OBJ files go without their materials."""
    (folder / "hand.xml").write_text(
        mjcf('<include file="sub/assets.xml"/>', '<geom type="mesh" mesh="m"/>')
        .replace("</body>", '<include file="sub/finger.xml"/></body>')
        .replace("<mujoco>", '<mujoco><compiler assetdir="meshes"/>')
    )
    (folder / "sub" / "assets.xml").write_text(
        '<mujocoinclude><asset><mesh name="m" file="box.obj"/><texture file="none.png" name="t"/>'
        '<mesh name="n" file="box.stl"/></asset></mujocoinclude>'
    )
    (folder / "sub" / "finger.xml").write_text(
        "<mujocoinclude>"
        + BODY.format("finger", '<joint name="j"/><geom type="mesh" mesh="n"/>')
        + "</mujocoinclude>"
    )
    (folder / "meshes").mkdir()
    (folder / "meshes" / "box.obj").write_text(obj("mtllib ../../secret.mtl\ng mtllib"))
    (folder / "sub" / "box.stl").write_bytes(stl())
    robot = load_mjcf(folder / "hand.xml")
    assert {"hand", "finger"} < set(robot.link_names) and robot.dof_names == ["j"]
    assert [len(link.shapes) for link in robot.links] == [0, 2, 2]


INERTIAL = '<inertial pos="0 0 0" mass="{}" diaginertia="1 1 1"/>'


@pytest.mark.thorough(cases=("text19-more than 500,000 elements",))
@pytest.mark.parametrize(
    ("text", "message"),
    [
        (mjcf('<include file="hand.xml"/>'), "hand.xml includes itself"),
        (mjcf('<include file="none.xml"/>'), "none.xml does not exist"),
        (mjcf('<include file="pipe"/>'), "pipe is no regular file"),
        (mjcf('<include file="sub"/>'), "sub is a folder"),
        (mjcf("<include/>"), "has no 'file'"),
        (mjcf('<include file="b0.xml"/>' * 10), "includes too much"),
        (mesh('file="pipe.stl"'), "pipe.stl is no regular file"),
        (mesh('file="none.stl"'), "none.stl"),
        (mesh('file="scene.gltf"'), "allowed are .stl, .obj, .msh"),
        (mesh('file="short.stl"'), "no triangles"),
        (mesh('file="short.msh"'), "Invalid MuJoCo mesh"),
        (mjcf(inner=INERTIAL.format("nan")), "mass of <inertial> in body 'hand' must be finite"),
        (mjcf(inner=INERTIAL.format("-1")), "at least 0, got '-1'"),
        (mjcf(inner='<body pos="1e300 0 0"/>'), "pos of <body> in body 'hand' must be finite"),
        (
            mjcf(inner='<body quat="0 0 0 0"/>'),
            "quat of <body> in body 'hand' must be of a length above 0",
        ),
        (
            mjcf(inner='<joint name="j" range="nan 1"/>'),
            "range of <joint> 'j' in body 'hand' must be finite",
        ),
        (mjcf(inner="<body>" * 200 + "</body>" * 200), "nested more than 100 deep"),
        (mjcf('<default class="a">' * 90 + "</default>" * 90), "'a': the first one is main"),
        (mjcf(inner="<site/>" * 60_000), "more than 50,000 elements"),
        (mjcf(inner="<a/>" * (MAX_ELEMENTS + 1)), f"more than {MAX_ELEMENTS:,} elements"),
        (mjcf(tag="robot"), "an MJCF file's is <mujoco>"),
        ("", "is not valid XML"),
        ('<!DOCTYPE m [<!ENTITY e SYSTEM "/etc/passwd">]>' + mjcf(), "has a document type"),
    ],
)
def test_a_damaged_mjcf_file(text: str, message: str, folder: Path, capsys: Any) -> None:
    os.mkfifo(folder / "pipe")
    os.mkfifo(folder / "pipe.stl")
    (folder / "short.stl").write_bytes(stl()[:200])
    (folder / "short.msh").write_bytes(struct.pack("<4i", 2**31 - 1, 0, 0, 4))
    for k in range(6):
        (folder / f"b{k}.xml").write_text(
            f'<mujoco>{f"""<include file="b{k + 1}.xml"/>""" * 10}</mujoco>'
        )
    (folder / "b6.xml").write_text("<mujoco/>")
    (folder / "hand.mjcf").write_text(text.replace("hand.xml", "hand.mjcf"))
    assert app.main(["robot", "show", str(folder / "hand.mjcf")]) == 2
    error = capsys.readouterr().err
    assert message.replace("hand.xml", "hand.mjcf") in " ".join(error.split())
    assert "hand.mjcf" in error and "Traceback" not in error


def test_options_that_would_lead_elsewhere_are_refused(folder: Path) -> None:
    (folder / "hand.xml").write_text(mjcf())
    with pytest.raises(InputError, match="path_resolver is not taken"):
        load_mjcf(folder / "hand.xml", path_resolver=lambda base, name: name)
    with pytest.raises(InputError, match="plain values"):
        load_mjcf(folder / "hand.xml", floating=lambda: True)


class Unspeakable(RuntimeError):
    def __str__(self) -> str:
        return b"\xff".decode()


def test_an_error_whose_own_text_fails_is_told_by_its_kind() -> None:
    assert words_of(Unspeakable()) == "Unspeakable, whose own words are no text"
    assert words_of(ValueError("one\n  two")) == "one two"
    assert words_of(ValueError()) == "ValueError"


ROBOT = """#usda 1.0
(
    defaultPrim = "robot"
    metersPerUnit = 1
    upAxis = "Z"
    LAYER
)
def Xform "robot" (
    prepend apiSchemas = ["PhysicsArticulationRootAPI"]
    PRIM
)
{
    INNER
    def Cube "base" (
        prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI", "PhysicsMassAPI"]
    )
    {
        double size = 0.1
        float physics:mass = MASS
    }
    def PhysicsFixedJoint "fix"
    {
        rel physics:body1 = </robot/base>
    }
}
"""


def usda(layer: str = "", prim: str = "", inner: str = "", mass: str = "1") -> str:
    text = ROBOT.replace("LAYER", layer).replace("PRIM", prim)
    return text.replace("INNER", inner).replace("MASS", mass)


CLIPS = """clips = {
        dictionary default = {
            string templateAssetPath = "../c.#.usd"
        }
    }"""


API = "PhysicsRigidBodyAPI"
JOINT = """def PhysicsRevoluteJoint "j"
    {
        float physics:lowerLimit = 30
        float physics:upperLimit = -30
    }"""


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (usda(layer="subLayers = [@../secret.usda@]"), "leads out"),
        (usda(layer="subLayers = [@{above}/secret.usda@]"), "absolute"),
        (usda(layer="subLayers = [@sub/nested.usda@]"), "nested.usda names .*leads out"),
        (usda(prim="prepend references = @../secret.usda@"), "leads out"),
        (usda(prim="prepend payload = @../secret.usda@"), "leads out"),
        (usda(prim="prepend references = @link.usda@"), "link out"),
        (usda(prim="prepend references = @secret.usda@"), "secret.usda does not exist"),
        (usda(prim="prepend references = @pipe.usda@"), "pipe.usda is no regular file"),
        (usda(prim="prepend references = @https://a.b/c.usda@"), "not by an address"),
        (usda(prim="prepend references = @sub/x.usdz@"), "a layer of a kind that is not read"),
        (usda(prim='prepend references = @`"${A}"`@'), "computed"),
        (usda(prim=CLIPS), "leads out"),
        (usda(inner="asset t = @/etc/passwd@"), "absolute"),
        (usda(inner="asset[] t = [@a.png@, @../secret.png@]"), "leads out"),
        (usda(inner="asset t = @link.png@"), "link out"),
        (usda(mass="nan"), "physics:mass of /robot/base must be finite"),
        (usda(mass="-1"), "physics:mass of /robot/base must be finite"),
        (usda(inner=JOINT), "physics:lowerLimit of /robot/j must not be above its upperLimit"),
        (usda(inner='def PointInstancer "p" {}'), "/robot/p is a 'PointInstancer', which is not"),
        (usda().replace(API, "PhysxTendonAxisRootAPI"), "RootAPI' of /robot/base is not underst"),
        (usda().replace("Unit = 1", "Unit = 0.01"), "does not take it as it stands: .*metersPerU"),
        ("#usda 1.0\n( \udcff\udcfe )\n", "no readable USD layer: ErrorException, whose own words"),
        ("", "no readable USD layer"),
        ("PXR-USDC" + "x" * 1000, "no readable USD layer"),
    ],
)
def test_a_usd_file_stays_inside(text: str, message: str, folder: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(folder.parent)  # Where USD would look for what is nowhere else.
    (folder / "link.usda").symlink_to("../secret.usda")
    (folder / "link.png").symlink_to("/etc/passwd")
    os.mkfifo(folder / "pipe.usda")
    (folder / "sub" / "x.usdz").write_text("x")
    nested = "#usda 1.0\n(\n    subLayers = [@../../secret.usda@]\n)\n"
    (folder / "sub" / "nested.usda").write_text(nested)
    text = text.replace("{above}", str(folder.parent))
    (folder / "hand.usda").write_text(text, encoding="utf-8", errors="surrogateescape")
    with pytest.raises(InputError, match=f"hand.usda.*{message}"):
        load_usd(folder / "hand.usda")


def test_a_usd_file_of_several_layers_is_read_as_it_is_now(folder: Path) -> None:
    """A process that read a file of this name before does not answer with that."""
    path = folder / "hand.usda"
    path.write_text(usda(layer="subLayers = [@./sub/a.usda@]", inner="asset t = @OmniPBR.mdl@"))
    (folder / "sub" / "a.usda").write_text("#usda 1.0\n(\n    subLayers = [@../b.usda@]\n)\n")
    (folder / "b.usda").write_text("#usda 1.0\n")
    assert load_usd(path).link_names == ["world", "base"]
    path.write_text(usda().replace("base", "palm"))
    assert load_usd(path).link_names == ["world", "palm"]


def prim(name: str, **children: str) -> str:
    """A prim of the layer whose children refer to others."""
    inner = "".join(
        f'    def "{child}" (\n        references = <{of}>\n    )\n    {{\n    }}\n'
        for child, of in children.items()
    )
    return f'def Xform "{name}"\n{{\n{inner}}}\n'


@pytest.mark.parametrize("brought", [False, True])
def test_doubled_references_are_counted_before_they_are_made(brought: bool, folder: Path) -> None:
    """As prims that stand in the layer, and as those that another one brings along."""
    twice = prim("p0")
    for k in range(1, 40):
        of = f"/around{k}/outer/inner" if brought else f"/p{k - 1}"
        twice += prim(f"held{k}", inner=f"/p{k - 1}") + prim(f"around{k}", outer=f"/held{k}")
        twice += prim(f"p{k}", a=of, b=of)
    (folder / "hand.usda").write_text(usda(prim="prepend references = </p39>") + twice)
    with pytest.raises(InputError, match=r"hand.usda shows more than 20,000 prims"):
        load_usd(folder / "hand.usda")


OTHER = '#usda 1.0\n(\n    defaultPrim = "x"\n)\ndef Xform "x"\n{\n}\n'


@pytest.mark.parametrize(
    ("members", "message"),
    [
        ({"r.usda": usda(prim="prepend references = @./o.usda@"), "o.usda": OTHER}, None),
        ({"r.usda": usda(prim="prepend references = @../../secret.usda@")}, "leads out"),
        ({"r.usda": usda(), "../../evil": "x"}, "'../../evil': .*leads out"),
        ({"a.png": "x", "r.usda": usda()}, "first file of a package has to be a USD layer"),
        ({}, "first file of a package"),
        (None, "is no USDZ package"),
    ],
)
def test_a_usdz_package_holds_all(members: Any, message: str | None, folder: Path) -> None:
    path = folder / "hand.usdz"
    path.write_text("x")
    if members is not None:
        with zipfile.ZipFile(path, "w") as archive:
            for name, text in members.items():
                archive.writestr(name, text)
    if message is None:
        assert load_usd(path).name == "hand"
        return
    with pytest.raises(InputError, match=f"hand.usdz.*{message}"):
        load_usd(path)
    assert not (folder.parent.parent / "evil").exists()
