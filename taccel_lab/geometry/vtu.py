# SPDX-License-Identifier: Apache-2.0
"""Tet meshes as VTK XML unstructured grids (.vtu), for ParaView.

The file holds the tets as volume cells and the boundary triangles as surface cells; the cell array
``region`` names the ``Region`` of each triangle and is -1 on tets. Positions are in metres.
"""

from __future__ import annotations

import base64
import sys
import zlib
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import atomic_file
from taccel_lab.geometry.quadratic import QuadraticMesh
from taccel_lab.geometry.tet_mesh import TetMesh

_TETRA, _TRIANGLE = 10, 5
"""VTK's numbers of the cells."""
_TYPES = {"f8": "Float64", "f4": "Float32", "i8": "Int64", "i4": "Int32", "u1": "UInt8"}


def write_mesh_vtu(
    path: Path | str,
    mesh: TetMesh | QuadraticMesh,
    *,
    positions_m: np.ndarray | None = None,
    point_data: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Write a labelled mesh, at rest or at the deformed ``positions_m`` [m], shape [node, 3].

    ``point_data`` are arrays of shape [node] or [node, k] by name. Of quadratic tets the volume
    cells have the corners only, the triangles all nodes.

    Raises InputError for positions or arrays of another length than the mesh's nodes.
    """
    nodes = mesh.nodes_m if positions_m is None else np.asarray(positions_m, dtype=np.float64)
    if nodes.shape != mesh.nodes_m.shape:
        raise InputError(
            f"{path}: positions have shape {nodes.shape}, the mesh {mesh.nodes_m.shape}"
        )
    corners = (mesh.tets[:, :4], mesh.faces)
    sizes = np.concatenate([np.full(len(c), c.shape[1]) for c in corners])
    kinds = np.repeat([_TETRA, _TRIANGLE], [len(c) for c in corners]).astype(np.uint8)
    root = ElementTree.Element(
        "VTKFile", type="UnstructuredGrid", version="1.0", header_type="UInt64",
        byte_order="LittleEndian" if sys.byteorder == "little" else "BigEndian",
        compressor="vtkZLibDataCompressor",
    )  # fmt: skip
    piece = ElementTree.SubElement(
        ElementTree.SubElement(root, "UnstructuredGrid"), "Piece",
        NumberOfPoints=str(len(nodes)), NumberOfCells=str(len(kinds)),
    )  # fmt: skip
    on_points = ElementTree.SubElement(piece, "PointData")
    for name, values in (point_data or {}).items():
        if len(values) != len(nodes):
            raise InputError(
                f"{path}: point array {name!r} has {len(values)} entries for {len(nodes)} nodes"
            )
        _add(on_points, name, values)
    on_tets = np.full(len(mesh.tets), -1, dtype=np.int32)
    regions = np.concatenate([on_tets, mesh.face_regions.astype(np.int32)])
    _add(ElementTree.SubElement(piece, "CellData"), "region", regions)
    _add(ElementTree.SubElement(piece, "Points"), "Points", nodes)
    cells = ElementTree.SubElement(piece, "Cells")
    _add(cells, "connectivity", np.concatenate([c.ravel() for c in corners]).astype(np.int64))
    _add(cells, "offsets", np.cumsum(sizes, dtype=np.int64))
    _add(cells, "types", kinds)
    with atomic_file(path) as staging:
        ElementTree.ElementTree(root).write(staging, encoding="utf-8", xml_declaration=True)


def _add(parent: ElementTree.Element, name: str, values: np.ndarray) -> None:
    """An array as VTK's XML holds it: one block of zlib behind its sizes, both in base 64."""
    values = np.ascontiguousarray(values)
    data = values.tobytes()
    packed = zlib.compress(data, level=1)
    sizes = np.array([1, len(data), 0, len(packed)], dtype=np.uint64).tobytes()
    array = ElementTree.SubElement(
        parent, "DataArray", Name=name, type=_TYPES[values.dtype.str[1:]], format="binary"
    )
    if values.ndim > 1:
        array.set("NumberOfComponents", str(values.shape[1]))
    array.text = "".join(base64.b64encode(part).decode("ascii") for part in (sizes, packed))
