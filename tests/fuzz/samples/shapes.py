# SPDX-License-Identifier: Apache-2.0
"""A box as STEP and as tets, and as the meshes that indenters and gels may be."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np

_CORNERS = np.array([[x, y, z] for z in (0, 2) for y in (0, 3) for x in (0, 4)], dtype=float)
_TRIANGLES = np.array(
    [
        [0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
        [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5],
    ]
)  # fmt: skip


def step(given: Path) -> None:
    """A gel of 24 x 20 x 4 mm, and which of its faces is what."""
    from build123d import Plane, Solid, export_step

    export_step(Solid.make_box(24.0, 20.0, 4.0, Plane((-12.0, -10.0, -4.0))), given / "gel.step")
    (given / "faces.toml").write_text(
        'contact = ["plane:+z"]\nbond = ["plane:-z"]\nwindow = ["rect:10x8"]\nnormal = "+z"\n'
        'right = "+x"\norigin = "center"\nbody = ""\nunit = "mm"\n'
    )


def tets(given: Path) -> None:
    """A gel of 24 x 18 x 12 mm as five tets, in Gmsh's words."""
    nodes = "\n".join("{:g} {:g} {:g}".format(*corner) for corner in 6 * _CORNERS)
    five = [[1, 2, 3, 5], [2, 4, 3, 8], [2, 6, 5, 8], [3, 5, 7, 8], [2, 3, 5, 8]]
    cells = "\n".join(f"{k} {a} {b} {c} {d}" for k, (a, b, c, d) in enumerate(five, 1))
    (given / "gel.msh").write_text(
        "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 8 1 8\n3 1 0 8\n1\n2\n3\n4\n5\n6\n7\n8\n"
        f"{nodes}\n$EndNodes\n$Elements\n1 5 1 5\n3 1 4 5\n{cells}\n$EndElements\n"
    )


def box_3mf(given: Path) -> None:
    """A box of 24 x 18 x 12 mm built of two bodies of one, as lib3mf and the workshop write it."""
    from lib3mf import Lib3MF

    model: Any = Lib3MF.Wrapper().CreateModel()
    mesh = model.AddMeshObject()
    for corner in 6 * _CORNERS:
        position = Lib3MF.Position()
        position.Coordinates[:] = corner.tolist()
        mesh.AddVertex(position)
    for corners in _TRIANGLES:
        triangle = Lib3MF.Triangle()
        triangle.Indices[:] = corners.tolist()
        mesh.AddTriangle(triangle)
    whole, nowhere = model.AddComponentsObject(), Lib3MF.Wrapper().GetIdentityTransform()
    part = whole.AddComponent(mesh, nowhere)
    item = model.AddBuildItem(whole, nowhere)
    # Drawn anew for each file otherwise: seeds would damage another one in every run.
    for number, named in enumerate((mesh, whole, part, item)):
        named.SetUUID(f"00000000-0000-4000-8000-{number:012d}")
    model.SetBuildUUID(f"00000000-0000-4000-8000-{9:012d}")
    model.QueryWriter("3mf").WriteToFile(str(given / "gel.3mf"))


def vtu(given: Path) -> None:
    """Five tets as VTK's XML and as its older format, in words."""
    _write_grid(given, "gel.vtu")
    _write_grid(given, "gel.vtk")


def _write_grid(given: Path, name: str) -> None:
    import pyvista

    five = np.array([[1, 2, 3, 5], [2, 4, 3, 8], [2, 6, 5, 8], [3, 5, 7, 8], [2, 3, 5, 8]]) - 1
    cells = np.column_stack([np.full(5, 4), five]).ravel()
    grid = pyvista.UnstructuredGrid(cells, np.full(5, pyvista.CellType.TETRA), 6 * _CORNERS)
    grid.save(given / name, binary=name.endswith("u"))


def collada(given: Path) -> None:
    """A gripper with a box of Collada on one finger, by way of a node of its library."""
    urdf(given)
    numbers = " ".join(f"{x:g}" for x in (0.01 * _CORNERS).ravel())
    corners = " ".join(map(str, _TRIANGLES.ravel()))
    (given / "box.dae").write_text(
        '<?xml version="1.0"?>\n<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" '
        'version="1.4.1">\n<asset><unit meter="1"/><up_axis>Z_UP</up_axis></asset>\n'
        '<library_geometries><geometry id="g"><mesh><source id="p">\n<float_array id="a" '
        f'count="24">{numbers}</float_array>\n<technique_common><accessor source="#a" count="8" '
        'stride="3"><param name="X" type="float"/><param name="Y" type="float"/><param name="Z" '
        'type="float"/></accessor></technique_common></source>\n<vertices id="v"><input '
        'semantic="POSITION" source="#p"/></vertices>\n<triangles count="12"><input '
        f'semantic="VERTEX" source="#v" offset="0"/><p>{corners}</p></triangles></mesh></geometry>'
        '</library_geometries>\n<library_nodes><node id="n"><instance_geometry url="#g"/></node>'
        '</library_nodes>\n<library_visual_scenes><visual_scene id="s"><node id="top">'
        '<instance_node url="#n"/></node></visual_scene></library_visual_scenes>\n<scene>'
        '<instance_visual_scene url="#s"/></scene>\n</COLLADA>\n'
    )
    path = given / "gripper.urdf"
    text = path.read_text(encoding="utf-8").replace('filename="words.stl"', 'filename="box.dae"')
    path.write_text(text, encoding="utf-8")


def stl(given: Path) -> None:
    """In words and in bytes."""
    lines = ["solid box"]
    binary = b"box".ljust(80) + struct.pack("<I", len(_TRIANGLES))
    for triangle in _CORNERS[_TRIANGLES]:
        normal = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
        normal /= np.linalg.norm(normal)
        lines.append("facet normal {:g} {:g} {:g}\nouter loop".format(*normal))
        lines += ["vertex {:g} {:g} {:g}".format(*corner) for corner in triangle]
        lines.append("endloop\nendfacet")
        binary += struct.pack("<12fH", *normal, *triangle.ravel(), 0)
    (given / "words.stl").write_text("\n".join([*lines, "endsolid box"]) + "\n")
    (given / "bytes.stl").write_bytes(binary)


def ply(given: Path) -> None:
    """In words and in bytes."""
    head = (
        "ply\nformat {} 1.0\ncomment a box\nelement vertex 8\nproperty float x\nproperty float y\n"
        "property float z\nelement face 12\nproperty list uchar int vertex_indices\nend_header\n"
    )
    words = ["{:g} {:g} {:g}".format(*corner) for corner in _CORNERS]
    words += ["3 {} {} {}".format(*triangle) for triangle in _TRIANGLES]
    (given / "words.ply").write_text(head.format("ascii") + "\n".join(words) + "\n")
    data = _CORNERS.astype("<f4").tobytes()
    data += b"".join(b"\x03" + triangle.astype("<i4").tobytes() for triangle in _TRIANGLES)
    (given / "bytes.ply").write_bytes(head.format("binary_little_endian").encode() + data)


def obj(given: Path) -> None:
    """With texture coordinates, normals and a material that is not there."""
    lines = ["# a box", "mtllib box.mtl", "o box"]
    lines += ["v {:g} {:g} {:g}".format(*corner) for corner in _CORNERS]
    lines += ["vt 0.5 0.5", "vn 0 0 1", "usemtl steel", "s off"]
    lines += ["f {}/1/1 {}/1/1 {}/1/1".format(*(triangle + 1)) for triangle in _TRIANGLES]
    (given / "box.obj").write_text("\n".join(lines) + "\n")


def urdf(given: Path) -> None:
    """A gripper of primitive shapes, with a mesh on one finger."""
    from taccel_lab.robots import catalogue

    stl(given)
    (entry,) = (entry for entry in catalogue.ENTRIES if entry.name == "parallel_gripper")
    text = entry.path().read_text(encoding="utf-8")
    box = '<box size="0.012 0.024 0.06"/>'
    mesh = '<mesh filename="words.stl" scale="0.003 0.008 0.03"/>'
    (given / "gripper.urdf").write_text(text.replace(box, mesh, 1), encoding="utf-8")


_MJCF = """<mujoco model="gripper">
  <compiler angle="degree" meshdir="meshes"/>
  <default><default class="finger"><joint type="slide" range="0 0.04"/></default></default>
  <include file="parts/assets.xml"/>
  <worldbody>
    <body name="palm" pos="0 0 0.1" quat="0.8 0 0.6 0">
      <inertial pos="0 0 0.01" mass="0.4" diaginertia="1e-4 2e-4 1e-4"/>
      <geom type="box" size="0.05 0.04 0.03"/>
      <body name="left" pos="0.03 0 0.05" euler="10 20 30">
        <joint name="left" class="finger" axis="1 0 0"/>
        <geom type="mesh" mesh="words"/>
        <geom type="capsule" size="0.01 0.05"/>
      </body>
      <body name="right" pos="-0.03 0 0.05">
        <joint name="right" class="finger" axis="-1 0 0"/>
        <geom type="mesh" mesh="box"/>
      </body>
    </body>
  </worldbody>
  <equality><joint joint1="right" joint2="left" polycoef="0 1 0 0 0"/></equality>
</mujoco>
"""
_ASSETS = """<mujocoinclude>
  <asset>
    <mesh name="words" file="words.stl" scale="0.01 0.01 0.01"/>
    <mesh name="box" file="box.obj" scale="0.01 0.01 0.01"/>
    <texture name="steel" type="2d" file="steel.png"/>
  </asset>
</mujocoinclude>
"""


def mjcf(given: Path) -> None:
    """A gripper with an included part, and meshes on both fingers."""
    (given / "gripper.xml").write_text(_MJCF)
    (given / "parts").mkdir()
    (given / "parts" / "assets.xml").write_text(_ASSETS)
    (given / "meshes").mkdir()
    stl(given / "meshes")
    obj(given / "meshes")


_USDA = """#usda 1.0
(
    defaultPrim = "gripper"
    metersPerUnit = 1
    upAxis = "Z"
    subLayers = [@./parts/looks.usda@]
)
def Xform "gripper" (
    prepend apiSchemas = ["PhysicsArticulationRootAPI"]
)
{
    def Xform "palm" (
        prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]
    )
    {
        float physics:mass = 0.4
        def Cube "box" (
            prepend apiSchemas = ["PhysicsCollisionAPI"]
            prepend references = @parts/box.usdc@
        )
        {
        }
    }
    def Sphere "finger" (
        prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI"]
    )
    {
        double radius = 0.02
        double3 xformOp:translate = (0.2, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def PhysicsFixedJoint "base"
    {
        rel physics:body1 = </gripper/palm>
    }
    def PhysicsRevoluteJoint "knuckle"
    {
        uniform token physics:axis = "Z"
        rel physics:body0 = </gripper/palm>
        rel physics:body1 = </gripper/finger>
        point3f physics:localPos0 = (0.1, 0, 0)
        point3f physics:localPos1 = (-0.1, 0, 0)
        float physics:lowerLimit = -30
        float physics:upperLimit = 40
    }
}
"""


def usd(given: Path) -> None:
    """A finger on a palm, of three layers as text and as bytes, the last one a mesh's."""
    from pxr import Sdf

    (given / "gripper.usda").write_text(_USDA)
    (given / "parts").mkdir()
    (given / "parts" / "looks.usda").write_text(
        '#usda 1.0\nover "gripper"\n{\n    asset inputs:file = @steel.png@\n}\n'
    )
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.ImportFromString(
        '#usda 1.0\n(\n    defaultPrim = "box"\n)\ndef Cube "box"\n{\n    double size = 0.1\n}\n'
    )
    layer.Export(str(given / "parts" / "box.usdc"))
