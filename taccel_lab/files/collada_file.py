# SPDX-License-Identifier: Apache-2.0
"""Triangles of Collada files (.dae), read by pycollada in its own process.

Lengths are those of the file times its unit, metres where it names none, and the axis that the file
calls up is turned to z, as https://www.khronos.org/collada says. RViz leaves ``up_axis`` out, and
some exporters write it whatever is up: ``as_drawn`` leaves it out, too.
"""

from __future__ import annotations

import io
import warnings
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from taccel_lab.errors import InputError, InputWarning
from taccel_lab.files.apart import read_apart
from taccel_lab.files.declared import require_few_copies
from taccel_lab.files.regular_file import shown
from taccel_lab.files.triangle_file import check_count, clean_triangles, without_idle_faces
from taccel_lab.files.xml_file import read_xml

SUFFIX = ".dae"
_KEPT = ("asset", "library_geometries", "library_nodes", "library_visual_scenes", "scene")
_Z_UP = {
    "X_UP": np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]),
    "Y_UP": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "Z_UP": np.eye(3),
}
"""Rotations, z up from the file; the Collada specification 1.4.1 says what is right and inwards."""
_LEFT_OUT = (
    "bind_material",
    "extra",
    "instance_camera",
    "instance_controller",
    "instance_light",
    "instance_physics_scene",
    "lines",
    "linestrips",
)
"""Looks, and what else is no surface; parts of it may name other files."""


MAX_PARTS, _PART_BYTES = 10_000, 6_400
"""Most parts of a scene, each counted as often as it is shown, and bytes of a surface that count as
one."""
_SHOWS = ("instance_node", "instance_geometry")


def read_collada(path: Path, as_drawn: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Points [m], float64, [n, 3], and triangles, int64, [m, 3], of what the file's scene shows.

    ``as_drawn``: whether axes are the file's own. Else a file whose z is not up is turned, with a
    warning. Faces of more corners are cut, points merged and counts limited as by
    ``read_triangle_file``.

    Raises InputError for a file that cannot be read or shows no faces, and where pycollada is not
    installed.
    """
    root = read_xml(path, "a Collada file")
    if _name(root) != "COLLADA":
        raise InputError(
            f"{path}: its root element is <{_name(root)}>; a Collada file's is <COLLADA>"
        )
    if find_spec("collada") is None:
        raise InputError(
            f"{path} is read by pycollada, which is not installed: pip install 'taccel-lab[robots]'"
        )
    root[:] = [part for part in root if _name(part) in _KEPT]
    for part in list(root.iter()):
        for child in list(part):
            if _name(child) in _LEFT_OUT:
                part.remove(child)
            elif _name(child) == "float_array":
                _check_numbers(path, child)
    _check_copies(path, root)
    points, faces = read_apart(
        str(path), _read_with_pycollada, path, ElementTree.tostring(root), by="collada"
    )
    if not len(faces):
        raise InputError(f"{path} shows no faces")
    if not as_drawn and (up := _up_axis(root)) != "Z_UP":
        warnings.warn(
            f"{path} says {up}, so it is turned to z up; if it now lies wrong, load it as drawn: "
            "RViz ignores this entry, and files made for it may state a wrong axis",
            InputWarning,
            stacklevel=2,
        )
        points = points @ _Z_UP[up].T
    return without_idle_faces(path, points, faces)


def _up_axis(root: ElementTree.Element) -> str:
    """Z_UP where a file says nothing, or nothing that Collada knows: it stays as it is drawn."""
    for asset in (part for part in root if _name(part) == "asset"):
        for entry in asset:
            if _name(entry) == "up_axis" and (entry.text or "").strip() in _Z_UP:
                return str(entry.text).strip()
    return "Z_UP"


def _check_numbers(path: Path, array: ElementTree.Element) -> None:
    """Refuse what pycollada would read as 0, or stop at."""
    try:
        finite = np.isfinite(np.array((array.text or "").split(), dtype=np.float64))
    except ValueError:
        finite = np.zeros(1, dtype=bool)
    if not finite.all():
        raise InputError(
            f"{path}: float_array {shown(str(array.get('id')))} has entries that are no finite "
            "numbers"
        )


def _check_copies(path: Path, root: ElementTree.Element) -> None:
    """Refuse nodes of nodes that stand for a great many, before they are followed."""
    parts: dict[Any, list[Any]] = {}
    scenes, surfaces = [], {}
    for element in root.iter():
        kind = _name(element)
        if kind in ("node", "visual_scene"):
            name = element.get("id") or element
            shown = [child for child in element if _name(child) in ("node", *_SHOWS)]
            parts[name] = [
                child.get("id") or child
                if _name(child) == "node"
                else str(child.get("url")).lstrip("#")
                for child in shown
            ]
        elif kind == "geometry":
            text = sum(len(inner.text or "") for inner in element.iter())
            surfaces[element.get("id")] = 1 + text // _PART_BYTES
        elif kind == "instance_visual_scene":
            scenes.append(str(element.get("url")).lstrip("#"))
    require_few_copies(path, parts, scenes, MAX_PARTS, own=surfaces)


def _name(element: ElementTree.Element) -> str:
    return str(element.tag).rpartition("}")[2]


def _read_with_pycollada(path: Path, text: bytes) -> tuple[np.ndarray, np.ndarray]:
    """What pycollada makes of the file; runs in the readers' process."""
    from collada import Collada
    from collada.common import DaeError

    try:
        found = Collada(io.BytesIO(text))
        surfaces, count = [], 0
        for surface in () if found.scene is None else _surfaces(found.scene):
            surfaces.append(surface)
            count += len(surface[1])
            check_count(path, count)
        unit = found.assetInfo.unitmeter if found.assetInfo else None
    except InputError:
        raise
    except (DaeError, ValueError, LookupError, TypeError, AttributeError, RuntimeError) as error:
        # pycollada follows what a damaged file says until something is not there.
        raise InputError(f"{path} is no readable Collada file: {error}") from None
    if not surfaces:
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    first = np.cumsum([0, *(len(points) for points, _ in surfaces)])
    points = np.concatenate([points for points, _ in surfaces]) * (1.0 if unit is None else unit)
    faces = np.concatenate(
        [faces + start for (_, faces), start in zip(surfaces, first[:-1], strict=True)]
    )
    return clean_triangles(path, points, faces)


def _surfaces(scene: Any) -> Any:
    """Points [n, 3] in the scene and triangles [m, 3] of each of its surfaces."""
    from collada.polygons import BoundPolygons
    from collada.polylist import BoundPolylist
    from collada.triangleset import BoundTriangleSet

    for item in scene.objects("geometry"):
        mirrored = np.linalg.det(np.asarray(item.matrix, dtype=np.float64)[:3, :3]) < 0
        for part in item.primitives():
            if isinstance(part, (BoundPolylist, BoundPolygons)):
                part = part.triangleset()
            if not isinstance(part, BoundTriangleSet) or part.vertex is None:
                continue
            faces = np.asarray(part.vertex_index, dtype=np.int64).reshape(-1, 3)
            yield (
                np.asarray(part.vertex, dtype=np.float64),
                faces[:, ::-1] if mirrored else faces,
            )
