# SPDX-License-Identifier: Apache-2.0
"""Tet meshes as VTK XML unstructured grids (.vtu), for ParaView and for reading back.

The file holds the tets as volume cells and, when given, the boundary triangles as surface cells;
the cell array ``region`` names the ``Region`` of each triangle and is -1 on tets. Positions are in
metres. Arrays are written inline in base64, uncompressed (VTK file formats, XML, format "binary"
with a UInt64 header), which needs no library.
"""

from __future__ import annotations

import base64
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry.quadratic import QuadraticMesh
from taccel_lab.geometry.tet_mesh import Region, TetMesh
from taccel_lab.output import atomic_file

_TETRA, _TRIANGLE = 10, 5
_TYPES = {
    "Float64": "<f8",
    "Float32": "<f4",
    "Int64": "<i8",
    "Int32": "<i4",
    "UInt8": "<u1",
}
_NAMES = {np.dtype(code): name for name, code in _TYPES.items()}


@dataclass(frozen=True)
class VtuData:
    """What a .vtu file of tets and triangles holds."""

    nodes_m: np.ndarray
    """[m], float64, shape [n, 3]."""
    tets: np.ndarray
    """int32, shape [t, 4]."""
    faces: np.ndarray
    """int32, shape [f, 3]; empty when the file has no triangles."""
    point_data: dict[str, np.ndarray]
    """Arrays of shape [n] or [n, k] by name."""
    cell_data: dict[str, np.ndarray]
    """Arrays of shape [t + f] or [t + f, k] by name, tets first."""


def write_vtu(
    path: Path | str,
    nodes_m: np.ndarray,
    tets: np.ndarray,
    point_data: Mapping[str, np.ndarray] | None = None,
    cell_data: Mapping[str, np.ndarray] | None = None,
    *,
    faces: np.ndarray | None = None,
    face_regions: np.ndarray | None = None,
) -> None:
    """Write tets and, when given, labelled boundary triangles.

    nodes_m [m], shape [n, 3]; tets, shape [t, 4]; point_data arrays [n] or [n, k]; cell_data arrays
    [t] or [t, k], which on the triangles become NaN or, for whole numbers, -1.
    """
    nodes = np.asarray(nodes_m, dtype=np.float64)
    tets = np.asarray(tets, dtype=np.int64)
    triangles = np.zeros((0, 3), dtype=np.int64) if faces is None else np.asarray(faces, np.int64)
    if nodes.ndim != 2 or nodes.shape[1] != 3 or tets.ndim != 2 or tets.shape[1] != 4:
        raise InputError(
            f"{path}: nodes must be [n, 3] and tets [t, 4], got {nodes.shape} and {tets.shape}"
        )
    cells = {
        name: _extended(path, name, values, len(tets), len(triangles))
        for name, values in (cell_data or {}).items()
    }
    if face_regions is not None:
        labels = np.asarray(face_regions, dtype=np.int32)
        if labels.shape != (len(triangles),):
            raise InputError(
                f"{path}: {len(triangles)} faces need as many regions, got {labels.shape}"
            )
        cells["region"] = np.concatenate([np.full(len(tets), -1, dtype=np.int32), labels])
    for name, values in (point_data or {}).items():
        if len(np.asarray(values)) != len(nodes):
            raise InputError(
                f"{path}: point array {name!r} has {len(np.asarray(values))} entries for "
                f"{len(nodes)} nodes"
            )
    sizes = np.concatenate([np.full(len(tets), 4), np.full(len(triangles), 3)])
    kinds = np.concatenate([np.full(len(tets), _TETRA), np.full(len(triangles), _TRIANGLE)])

    root = ElementTree.Element(
        "VTKFile",
        type="UnstructuredGrid",
        version="1.0",
        byte_order="LittleEndian",
        header_type="UInt64",
    )
    piece = ElementTree.SubElement(
        ElementTree.SubElement(root, "UnstructuredGrid"),
        "Piece",
        NumberOfPoints=str(len(nodes)),
        NumberOfCells=str(len(sizes)),
    )
    point_element = ElementTree.SubElement(piece, "PointData")
    for name, values in (point_data or {}).items():
        _add_array(point_element, name, np.asarray(values))
    cell_element = ElementTree.SubElement(piece, "CellData")
    for name, values in cells.items():
        _add_array(cell_element, name, values)
    _add_array(ElementTree.SubElement(piece, "Points"), "Points", nodes)
    cell_lists = ElementTree.SubElement(piece, "Cells")
    _add_array(cell_lists, "connectivity", np.concatenate([tets.ravel(), triangles.ravel()]))
    _add_array(cell_lists, "offsets", np.cumsum(sizes).astype(np.int64))
    _add_array(cell_lists, "types", kinds.astype(np.uint8))
    with atomic_file(path) as staging:
        ElementTree.ElementTree(root).write(staging, encoding="utf-8", xml_declaration=True)


def write_mesh_vtu(
    path: Path | str,
    mesh: TetMesh | QuadraticMesh,
    *,
    positions_m: np.ndarray | None = None,
    point_data: Mapping[str, np.ndarray] | None = None,
    cell_data: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Write a labelled mesh, at rest or at the deformed ``positions_m`` [m], shape [n, 3].

    Of quadratic tets the volume cells have the corners only, the triangles all nodes.
    """
    nodes = mesh.nodes_m if positions_m is None else np.asarray(positions_m, dtype=np.float64)
    if nodes.shape != mesh.nodes_m.shape:
        raise InputError(
            f"{path}: positions have shape {nodes.shape}, the mesh {mesh.nodes_m.shape}"
        )
    write_vtu(
        path,
        nodes,
        mesh.tets[:, :4],
        point_data,
        cell_data,
        faces=mesh.faces,
        face_regions=mesh.face_regions,
    )


def read_vtu(path: Path | str) -> VtuData:
    """Read a file of tets and triangles as written by ``write_vtu``."""
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path} does not exist or is not a file")
    try:
        root = ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise InputError(f"{path} is not a complete VTK XML file: {error}") from error
    piece = root.find("UnstructuredGrid/Piece")
    if root.get("type") != "UnstructuredGrid" or piece is None:
        raise InputError(f"{path} is not a VTK unstructured grid (.vtu)")
    if root.get("compressor") or root.get("header_type") != "UInt64":
        raise InputError(
            f"{path}: compressed arrays or 32-bit headers are not supported; save it from ParaView "
            "with data mode Binary, compressor None and 64-bit headers"
        )
    lists = _read_arrays(path, piece, "Cells")
    points = _read_arrays(path, piece, "Points")
    if not {"connectivity", "offsets", "types"} <= set(lists) or len(points) != 1:
        raise InputError(f"{path} lacks its points or cell lists")
    nodes = next(iter(points.values()))
    kinds, ends = lists["types"].astype(np.int64), lists["offsets"].astype(np.int64)
    is_tet, is_triangle = kinds == _TETRA, kinds == _TRIANGLE
    tets_first = not (np.diff(is_tet.astype(int)) > 0).any()
    if not (is_tet | is_triangle).all() or not tets_first or len(ends) != len(kinds):
        raise InputError(f"{path}: allowed are tets (cell type 10) followed by triangles (5)")
    starts = ends - np.where(is_tet, 4, 3)
    if len(ends) == 0 or starts[0] != 0 or (starts[1:] != ends[:-1]).any():
        raise InputError(f"{path}: the cell offsets do not match the cell types")
    corners = lists["connectivity"]
    if len(corners) != ends[-1]:
        raise InputError(f"{path}: {len(corners)} cell corners, {ends[-1]} expected")
    split = 4 * int(is_tet.sum())
    return VtuData(
        nodes_m=nodes.reshape(-1, 3).astype(np.float64),
        tets=corners[:split].reshape(-1, 4).astype(np.int32),
        faces=corners[split:].reshape(-1, 3).astype(np.int32),
        point_data=_read_arrays(path, piece, "PointData"),
        cell_data=_read_arrays(path, piece, "CellData"),
    )


def read_mesh_vtu(path: Path | str) -> TetMesh:
    """Read a labelled mesh back; raises InputError when faces or the array ``region`` lack."""
    data = read_vtu(path)
    region = data.cell_data.get("region")
    if region is None or not len(data.faces):
        raise InputError(f"{path} has no labelled boundary triangles (cell array 'region')")
    labels = region[len(data.tets) :]
    if not np.isin(labels, [int(r) for r in Region]).all():
        known = ", ".join(f"{int(r)} {r.name.lower()}" for r in Region)
        raise InputError(f"{path}: cell array 'region' has unknown values; known: {known}")
    try:
        return TetMesh(data.nodes_m, data.tets, data.faces, labels)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _extended(
    path: Path | str, name: str, values: np.ndarray, tet_count: int, face_count: int
) -> np.ndarray:
    array = np.asarray(values)
    if len(array) != tet_count:
        raise InputError(
            f"{path}: cell array {name!r} has {len(array)} entries for {tet_count} tets"
        )
    filler = np.nan if np.issubdtype(array.dtype, np.floating) else -1
    signed = array if np.issubdtype(array.dtype, np.floating) else array.astype(np.int64)
    return np.concatenate([signed, np.full((face_count, *array.shape[1:]), filler, signed.dtype)])


def _add_array(parent: ElementTree.Element, name: str, values: np.ndarray) -> None:
    if values.dtype == bool:
        values = values.astype(np.uint8)
    little = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))
    kind = _NAMES.get(little.dtype)
    if kind is None:
        raise InputError(f"array {name!r} has type {values.dtype}; allowed: {', '.join(_TYPES)}")
    if little.ndim > 2 or (np.issubdtype(little.dtype, np.floating) and np.isinf(little).any()):
        raise InputError(f"array {name!r} must have one or two axes and no infinite values")
    attributes = {"type": kind, "Name": name, "format": "binary"}
    if little.ndim == 2:
        attributes["NumberOfComponents"] = str(little.shape[1])
    payload = little.tobytes()
    header = np.array([len(payload)], dtype="<u8").tobytes()
    element = ElementTree.SubElement(parent, "DataArray", attributes)
    element.text = base64.b64encode(header + payload).decode()


def _read_arrays(path: Path, piece: ElementTree.Element, group: str) -> dict[str, np.ndarray]:
    result: dict[str, np.ndarray] = {}
    for element in piece.findall(f"{group}/DataArray"):
        name, kind = element.get("Name", ""), element.get("type", "")
        if element.get("format") != "binary" or kind not in _TYPES:
            raise InputError(
                f"{path}: array {name!r} is {element.get('format')} {kind}; allowed are inline "
                f"binary arrays of {', '.join(_TYPES)}"
            )
        try:
            raw = base64.b64decode((element.text or "").strip(), validate=True)
        except ValueError as error:
            raise InputError(f"{path}: array {name!r} is damaged: {error}") from error
        size = int(np.frombuffer(raw[:8], dtype="<u8")[0]) if len(raw) >= 8 else -1
        components = int(element.get("NumberOfComponents", "1"))
        width = np.dtype(_TYPES[kind]).itemsize * max(components, 1)
        if size != len(raw) - 8 or components < 1 or size % width:
            raise InputError(f"{path}: array {name!r} is truncated")
        values = np.frombuffer(raw[8:], dtype=_TYPES[kind])
        result[name] = values.reshape(-1, components) if components > 1 else values
    return result
