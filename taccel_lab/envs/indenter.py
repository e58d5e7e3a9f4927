# SPDX-License-Identifier: Apache-2.0
"""Indenters by name: ``sphere:2.0``, ``cylinder:3.0``, ``box:4x2``, ``mesh:part.stl`` (in mm)."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.scene import Ball, TriangleMesh, box_mesh, cylinder_mesh

ALLOWED = (
    "sphere:RADIUS, cylinder:RADIUS (flat end), box:XxY (flat end) or mesh:FILE "
    "(STL, PLY or OBJ; its -z side touches the gel); lengths in mm"
)
_HEIGHT_M = 4e-3
_SIZE_LIMITS_MM = (0.05, 100.0)


@dataclass(frozen=True)
class Indenter:
    """A rigid body in its own frame: xy centred on the origin, its -z side goes first."""

    name: str
    """As given on the command line."""
    shape: Ball | TriangleMesh


def parse_indenter(text: str) -> Indenter:
    """Read an indenter description; raises InputError that lists what is allowed."""
    kind, _, value = text.partition(":")
    if kind == "sphere":
        return Indenter(text, Ball(_length_m(text, value)))
    if kind == "cylinder":
        return Indenter(text, cylinder_mesh(_length_m(text, value), _HEIGHT_M))
    if kind == "box":
        x, cross, y = value.partition("x")
        if not cross:
            raise InputError(f"indenter {text!r} is not understood; allowed: {ALLOWED}")
        return Indenter(text, box_mesh((_length_m(text, x), _length_m(text, y), _HEIGHT_M)))
    if kind == "mesh":
        return Indenter(text, _read_mesh(Path(value)))
    raise InputError(f"indenter {text!r} is not understood; allowed: {ALLOWED}")


def _length_m(text: str, value: str) -> float:
    try:
        length_mm = float(value)
    except ValueError:
        raise InputError(
            f"indenter {text!r}: {value!r} is not a number; allowed: {ALLOWED}"
        ) from None
    low, high = _SIZE_LIMITS_MM
    if not (math.isfinite(length_mm) and low <= length_mm <= high):
        raise InputError(
            f"indenter {text!r}: a size must lie in [{low:g}, {high:g}] mm, got {value} mm"
        )
    return length_mm * 1e-3


def _read_mesh(path: Path) -> TriangleMesh:
    import pyvista

    if not path.is_file():
        raise InputError(f"indenter mesh {path} does not exist")
    if path.suffix.lower() not in (".stl", ".ply", ".obj"):
        raise InputError(f"indenter mesh {path}: only .stl, .ply and .obj files can be read")
    with warnings.catch_warnings():
        # VTK's own words about a broken file; what is wrong is said below.
        warnings.simplefilter("ignore", UserWarning)
        loaded = pyvista.read(path)
    assert isinstance(loaded, pyvista.PolyData)
    surface = loaded.triangulate().clean()
    assert surface is not None
    if surface.n_cells == 0:
        raise InputError(f"indenter mesh {path} holds no faces, or is not a readable mesh file")
    if not surface.is_manifold:
        raise InputError(
            f"indenter mesh {path} is not a closed manifold surface ({surface.n_open_edges} open "
            "edges); repair it first, e.g. with pymeshlab"
        )
    points = np.asarray(surface.points, dtype=np.float64)
    size = np.ptp(points, axis=0).max()
    low, high = _SIZE_LIMITS_MM
    if not low <= size <= high:
        raise InputError(
            f"indenter mesh {path} is {size:g} units across; a size in [{low:g}, {high:g}] mm is "
            "needed (is the file in metres or inches?)"
        )
    faces = surface.faces.reshape(-1, 4)[:, 1:]
    corner = points[faces]
    if np.einsum("fi,fi->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) < 0:
        faces = faces[:, [0, 2, 1]]
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return TriangleMesh((points - centre) * 1e-3, faces)
