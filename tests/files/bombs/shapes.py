# SPDX-License-Identifier: Apache-2.0
"""Meshes and solids that state, or build, more than they hold."""

from __future__ import annotations

import base64
import re
import struct
import zipfile
from pathlib import Path

import numpy as np

from tests.files.bombs.written import Make, written

_RELATIONS = (
    '<?xml version="1.0"?><Relationships xmlns="http://schemas.openxmlformats.org/package/2006/'
    'relationships"><Relationship Target="/3D/3dmodel.model" Id="rel0" Type="http://schemas.'
    'microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>'
)
_TYPES = (
    '<?xml version="1.0"?><Types xmlns="http://schemas.openxmlformats.org/package/2006/content-'
    'types"><Default Extension="rels" ContentType="application/vnd.openxmlformats-package.'
    'relationships+xml"/><Default Extension="model" ContentType="application/vnd.ms-package.'
    '3dmanufacturing-3dmodel+xml"/></Types>'
)
_MODEL = (
    '<?xml version="1.0"?><model unit="millimeter" xmlns="http://schemas.microsoft.com/'
    '3dmanufacturing/core/2015/02"><resources>'
)
TETRAHEDRON = (
    '<object id="1" type="model"><mesh><vertices><vertex x="0" y="0" z="0"/><vertex x="9" y="0" '
    'z="0"/><vertex x="0" y="9" z="0"/><vertex x="0" y="0" z="9"/></vertices><triangles><triangle '
    'v1="0" v2="2" v3="1"/><triangle v1="0" v2="1" v3="3"/><triangle v1="1" v2="2" v3="3"/>'
    '<triangle v1="2" v2="0" v3="3"/></triangles></mesh></object>'
)


def package(path: Path, *model: bytes) -> Path:
    """A 3MF file whose model is made of these parts."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("[Content_Types].xml", _TYPES)
        file.writestr("_rels/.rels", _RELATIONS)
        with file.open("3D/3dmodel.model", "w", force_zip64=True) as member:
            for part in model:
                member.write(part)
    return path


def package_of_points(folder: Path) -> Path:
    """320 MB of one vertex over and over in 0.8 MB."""
    vertices, triangles = TETRAHEDRON.split("</vertices>")
    end = f'</vertices>{triangles}</resources><build><item objectid="1"/></build></model>'
    many = b'<vertex x="0" y="0" z="0"/>' * 39_000
    return package(folder / "a.3mf", (_MODEL + vertices).encode(), *[many] * 310, end.encode())


def package_that_lies(folder: Path) -> Path:
    """The same, whose list of contents states a hundred bytes of them."""
    path = package_of_points(folder)
    data = bytearray(path.read_bytes())
    at = data.rindex(b"3D/3dmodel.model") - 46 + 24
    data[at : at + 4] = struct.pack("<I", 100)
    path.write_bytes(data)
    return path


def package_of_copies(folder: Path) -> Path:
    """A body of two bodies of two bodies: 2^30 tetrahedra in a few lines."""
    levels = "".join(
        f'<object id="{k}" type="model"><components><component objectid="{k - 1}"/>'
        f'<component objectid="{k - 1}"/></components></object>'
        for k in range(2, 32)
    )
    end = f'{TETRAHEDRON}{levels}</resources><build><item objectid="31"/></build></model>'
    return package(folder / "a.3mf", _MODEL.encode(), end.encode())


COLLADA_OF_COPIES = written(
    "a.dae",
    '<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" '
    'version="1.4.1"><asset><unit meter="1"/><up_axis>Z_UP</up_axis></asset>'
    '<library_geometries><geometry id="g"><mesh><source id="p"><float_array id="pa" count="9">'
    "0 0 0 1 0 0 0 1 0</float_array><technique_common><accessor source='#pa' count='3' "
    "stride='3'><param name='X' type='float'/><param name='Y' type='float'/><param name='Z' "
    "type='float'/></accessor></technique_common></source><vertices id='v'><input "
    "semantic='POSITION' source='#p'/></vertices><triangles count='1'><input "
    "semantic='VERTEX' source='#v' offset='0'/><p>0 1 2</p></triangles></mesh></geometry>"
    "</library_geometries><library_nodes><node id='n0'><instance_geometry url='#g'/></node>",
    *(
        f'<node id="n{k}"><instance_node url="#n{k - 1}"/><instance_node url="#n{k - 1}"/></node>'
        for k in range(1, 31)
    ),
    "</library_nodes><library_visual_scenes><visual_scene id='s'><node id='top'>"
    "<instance_node url='#n30'/></node></visual_scene></library_visual_scenes><scene>"
    "<instance_visual_scene url='#s'/></scene></COLLADA>",
)
"""A node of two nodes of two nodes, with a triangle."""


def polygon(count: int) -> Make:
    """An OBJ of one face with as many corners."""
    turn = np.linspace(0, 2 * np.pi, count, endpoint=False)
    ring = (1 + 0.3 * np.cos(np.arange(count))) * np.array([np.cos(turn), np.sin(turn)])
    lines = [f"v {x:.6f} {y:.6f} 0\n" for x, y in ring.T]
    return written("a.obj", *lines, "f ", " ".join(map(str, range(1, count + 1))), "\n")


def ply(count: int, before: str = "") -> Make:
    head = (
        f"ply\nformat binary_little_endian 1.0\n{before}element vertex {count}\nproperty float x\n"
        "property float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices"
        "\nend_header\n"
    )
    return written("a.ply", head, bytes(100))


_GRID = "# vtk DataFile Version 3.0\na\nASCII\nDATASET {}\n"
_VTU = (
    '<?xml version="1.0"?><VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" '
    'header_type="UInt64"{}><UnstructuredGrid><Piece NumberOfPoints="{}" NumberOfCells="{}">'
    "<Points>"
    '<DataArray type="Float32" NumberOfComponents="3" format="{}">{}</DataArray></Points><Cells>'
    '<DataArray type="Int64" Name="connectivity" format="ascii">0 1 2 3</DataArray><DataArray '
    'type="Int64" Name="offsets" format="ascii">4</DataArray><DataArray type="UInt8" Name="types" '
    'format="ascii">10</DataArray></Cells></Piece></UnstructuredGrid></VTKFile>'
)
_POINTS = "0 0 0 1 0 0 0 1 0 0 0 1"


def press_folder(folder: Path) -> Path:
    """A press whose mesh states four thousand million nodes."""
    (folder / "press.json").write_text("{}")
    (folder / "gel.vtu").write_text(_VTU.format("", 4_000_000_000, 1, "ascii", _POINTS))
    return folder


PLY_LIST = written(
    "a.ply",
    "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    "property float z\nelement face 1\nproperty list uint int vertex_indices\nend_header\n",
    bytes(36),
    b"\xff\xff\xff\x7f",
    bytes(64),
)
"""A face of two thousand million corners."""
MSH = written(
    "a.msh",
    "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1000000000 1000000000 1 1000000000\n"
    "3 1 0 1000000000\n1\n$EndNodes\n$Elements\n1 1 1 1\n3 1 4 1000000000\n$EndElements\n",
)
VTK_POINTS = written("a.vtk", _GRID.format("UNSTRUCTURED_GRID"), "POINTS 1000000000 float\n0 0 0\n")
VTK_CELLS = written(
    "a.vtk",
    _GRID.format("UNSTRUCTURED_GRID"),
    f"POINTS 4 float\n{_POINTS}\nCELLS 1000000000 2000000000\n4 0 1 2 3\n",
)
VTK_STRUCTURED = written(
    "a.vtk",
    _GRID.format("STRUCTURED_POINTS"),
    "DIMENSIONS 4000 4000 4000\nORIGIN 0 0 0\nSPACING 1 1 1\nPOINT_DATA 64000000000\n"
    "SCALARS a float\nLOOKUP_TABLE default\n0\n",
)
_BLOCKS = (struct.pack("<4Q", 1 << 40, 1 << 20, 0, 100), bytes(100))
VTU_BLOCKS = written(
    "a.vtu",
    _VTU.format(
        ' compressor="vtkZLibDataCompressor"', 4, 1, "binary",
        "".join(base64.b64encode(part).decode() for part in _BLOCKS),
    ),
)  # fmt: skip
"""A packed array that states 2^40 blocks."""
VTU_POINTS = written("a.vtu", _VTU.format("", 4_000_000_000, 1, "ascii", _POINTS))
VTU_CELLS = written("a.vtu", _VTU.format("", 4, 4_000_000_000, "ascii", _POINTS))
STL = written("a.stl", bytes(80), b"\xff\xff\xff\xff")
OBJ = written("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 2000000000\n")


def step_of_copies(levels: int, width: int) -> Make:
    """Assemblies of ``width`` assemblies each, ``levels`` deep, down to a box."""

    def make(folder: Path) -> Path:
        from build123d import Solid, export_step

        path = folder / "a.step"
        export_step(Solid.make_box(1.0, 1.0, 1.0), path)
        text, end = path.read_text(), "ENDSEC;\nEND-ISO"
        entities: list[str] = []

        def add(entity: str) -> int:
            entities.append(f"#{100_001 + len(entities)} = {entity};\n")
            return 100_000 + len(entities)

        def first(entity: str) -> str:
            return re.findall(rf"#(\d+) = {entity}", text)[0]

        product, body = (first(rf"{name}") for name in (r"PRODUCT_DEFINITION\(", "ADVANCED_BREP_S"))
        (context,) = re.findall(rf"#{body} = \w+\('\w*',\([^)]*\),#(\d+)", text)
        at = first("AXIS2_PLACEMENT_3D")
        for level in range(levels):
            name = f"level {level}"
            about = add(f"PRODUCT('{name}','{name}','',(#{first('PRODUCT_CONTEXT')}))")
            formation = add(f"PRODUCT_DEFINITION_FORMATION('','',#{about})")
            design = first("PRODUCT_DEFINITION_CONTEXT")
            whole = add(f"PRODUCT_DEFINITION('design','',#{formation},#{design})")
            shape = add(f"PRODUCT_DEFINITION_SHAPE('','',#{whole})")
            rep = add(f"SHAPE_REPRESENTATION('',(#{at}),#{context})")
            add(f"SHAPE_DEFINITION_REPRESENTATION(#{shape},#{rep})")
            move = add(f"ITEM_DEFINED_TRANSFORMATION('','',#{at},#{at})")
            for k in range(width):
                used = add(f"NEXT_ASSEMBLY_USAGE_OCCURRENCE('{k}','','',#{whole},#{product},$)")
                place = add(f"PRODUCT_DEFINITION_SHAPE('Placement','',#{used})")
                relation = add(
                    f"( REPRESENTATION_RELATIONSHIP('','',#{body},#{rep}) "
                    f"REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION(#{move}) "
                    "SHAPE_REPRESENTATION_RELATIONSHIP() )"
                )
                add(f"CONTEXT_DEPENDENT_SHAPE_REPRESENTATION(#{relation},#{place})")
            product, body = str(whole), str(rep)
        path.write_text(text.replace(end, "".join(entities) + end))
        return path

    return make
