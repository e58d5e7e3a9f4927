# SPDX-License-Identifier: Apache-2.0
"""A gel in a row of states: where its nodes are, fields and forces on them, what the sensor saw."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Self

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import QuadraticMesh, TetMesh
from taccel_lab.viewer.section import linear_tets


@dataclass(frozen=True)
class Field:
    """A number at every node, or pixel, in every state."""

    label: str
    unit: str
    values: np.ndarray
    """[state, node], or [state, height, width]; NaN where it is not known."""
    span: tuple[float, float] | None = None
    """Limits of its colours; those of the values when None."""

    def limits(self) -> tuple[float, float]:
        """Range from 0, or the least value below it, to the largest of all states; never empty."""
        if self.span is not None:
            return self.span
        low = min(float(np.nanmin(self.values, initial=0.0)), 0.0)
        high = float(np.nanmax(self.values, initial=0.0))
        return low, max(high, low + 1e-9)


@dataclass(frozen=True)
class ShownTool:
    """A rigid body that touches the gel."""

    vertices_mm: np.ndarray
    """[vertex, 3], in its own frame."""
    faces: np.ndarray
    poses: np.ndarray
    """gel_from_tool of each state: position [mm] and quaternion x, y, z, w, [state, 7]."""


@dataclass(frozen=True)
class SensorImages:
    """What the sensor shows in each state."""

    rgb: np.ndarray
    """uint8 [state, height, width, 3]; a single one where only the end was kept."""
    markers_px: np.ndarray | None = None
    """(u, v) in pixels of ``rgb``, [state, marker, 2]; NaN beside the gel."""
    maps: tuple[Field, ...] = ()
    """What else the pixels of ``rgb`` know, such as depth."""


@dataclass(frozen=True)
class GelStates:
    """All that a page shows of a gel."""

    rest_mm: np.ndarray
    """[node, 3]."""
    faces: np.ndarray
    """Its skin, outward, [face, 3]."""
    moved_mm: np.ndarray
    """[state, node, 3]."""
    captions: list[str]
    """A line of text a state."""
    tets: np.ndarray = field(default_factory=lambda: np.zeros((0, 4), dtype=np.int64))
    """Four-node tets, [tet, 4]; none of a gel that is known by its face alone."""
    fields: list[Field] = field(default_factory=list)
    forces_n: np.ndarray | None = None
    """Forces of the tool on the nodes, [state, node, 3]."""
    tool: ShownTool | None = None
    images: SensorImages | None = None

    @classmethod
    def untouched(
        cls, mesh: TetMesh | QuadraticMesh, images: SensorImages | None = None
    ) -> GelStates:
        """A gel in one state, at rest."""
        rest = 1e3 * mesh.nodes_m
        return cls(
            rest_mm=rest,
            faces=mesh.faces.astype(np.int64),
            moved_mm=np.zeros((1, *rest.shape)),
            captions=["untouched"],
            tets=linear_tets(mesh.tets),
            images=images,
        )

    @property
    def count(self) -> int:
        """States."""
        return len(self.moved_mm)

    def positions_mm(self, state: int, exaggerated: float = 1.0) -> np.ndarray:
        """Nodes of a state, their motion times a factor, [node, 3]."""
        return self.rest_mm + exaggerated * self.moved_mm[state]

    def checked(self, source: object) -> Self:
        """These states, if every array has its shape, its numbers are finite and its triangles are
        of nodes that there are; InputError that begins with ``source`` otherwise."""
        nodes, count = len(self.rest_mm) if self.rest_mm.ndim else 0, len(self.captions)
        _require(self.rest_mm, (nodes, 3), "nodes", source)
        if nodes == 0 or count == 0:
            raise InputError(f"{source}: there is no {'node' if nodes == 0 else 'state'}")
        _require(self.moved_mm, (count, nodes, 3), "motion", source)
        _require_indices(self.tets, 4, nodes, "tets", source)
        _require_indices(self.faces, 3, nodes, "triangles", source)
        for one in self.fields:
            _require(one.values, (count, nodes), one.label, source, finite=False)
        if self.forces_n is not None:
            _require(self.forces_n, (count, nodes, 3), "forces", source)
        if self.tool is not None:
            corners = len(self.tool.vertices_mm) if self.tool.vertices_mm.ndim else 0
            _require(self.tool.vertices_mm, (corners, 3), "the tool's vertices", source)
            _require_indices(self.tool.faces, 3, corners, "the tool's triangles", source)
            _require(self.tool.poses, (count, 7), "the tool's poses", source)
        if self.images is not None:
            rgb, markers = self.images.rgb, self.images.markers_px
            kept = 1 if rgb.ndim and len(rgb) == 1 else count
            if rgb.dtype != np.uint8 or rgb.ndim != 4 or rgb.size == 0:
                raise InputError(f"{source}: images are {_found(rgb)}; 8 bits RGB are needed")
            _require(rgb, (kept, *rgb.shape[1:3], 3), "images", source)
            if markers is not None:
                many = markers.shape[1] if markers.ndim == 3 else 0
                _require(markers, (kept, many, 2), "markers", source, finite=False)
        return self

    def all_fields(self) -> list[Field]:
        """The fields, with those of the motion, which need no other source."""
        length = Field("displacement", "mm", np.linalg.norm(self.moved_mm, axis=2))
        return [*self.fields, length, Field("displacement along z", "mm", self.moved_mm[..., 2])]


def _require(
    array: np.ndarray, shape: tuple[int, ...], what: str, source: object, *, finite: bool = True
) -> None:
    """InputError for an array of another shape, that holds no numbers, or (``finite``) some that
    are not finite."""
    if array.shape != shape or array.dtype.kind not in "fiu":
        wanted = " x ".join(map(str, shape))
        raise InputError(f"{source}: {what} are {_found(array)}; {wanted} numbers are needed")
    if finite and not np.isfinite(array).all():
        raise InputError(f"{source}: {what} hold numbers that are not finite")


def _require_indices(
    array: np.ndarray, corners: int, count: int, what: str, source: object
) -> None:
    rows = len(array) if array.ndim else 0
    _require(array, (rows, corners), what, source)
    if array.dtype.kind == "f" or (array.size and not 0 <= array.min() <= array.max() < count):
        raise InputError(f"{source}: {what} name nodes that are not there; there are {count}")


def _found(array: np.ndarray) -> str:
    shape = " x ".join(map(str, array.shape)) or "a single value"
    return f"{shape} of {array.dtype}"
