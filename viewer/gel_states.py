# SPDX-License-Identifier: Apache-2.0
"""A gel in a row of states: where its nodes are, fields and forces on them, what the sensor saw."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Field:
    """A number at every node in every state."""

    label: str
    unit: str
    values: np.ndarray
    """[state, node]; NaN where it is not known."""

    def limits(self) -> tuple[float, float]:
        """From 0, or the least value below it, to the largest of all states; never empty."""
        low = min(float(np.nanmin(self.values, initial=0.0)), 0.0)
        high = float(np.nanmax(self.values, initial=0.0))
        return low, max(high, low + 1e-9)


@dataclass(frozen=True)
class Tool:
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


@dataclass(frozen=True)
class GelStates:
    """All that a page shows of a gel."""

    rest_mm: np.ndarray
    """[node, 3]."""
    tets: np.ndarray
    """Four-node tets, [tet, 4]; none of a gel that is known by its face alone."""
    faces: np.ndarray
    """Its skin, outward, [face, 3]."""
    moved_mm: np.ndarray
    """[state, node, 3]."""
    captions: list[str]
    """A line of text a state."""
    fields: list[Field] = field(default_factory=list)
    forces_n: np.ndarray | None = None
    """Of the tool on the nodes, [state, node, 3]."""
    tool: Tool | None = None
    images: SensorImages | None = None

    @property
    def count(self) -> int:
        """States."""
        return len(self.moved_mm)

    def positions_mm(self, state: int, exaggerated: float = 1.0) -> np.ndarray:
        """Nodes of a state, their motion times a factor, [node, 3]."""
        return self.rest_mm + exaggerated * self.moved_mm[state]

    def all_fields(self) -> list[Field]:
        """The fields, with those of the motion, which need no other source."""
        length = Field("displacement", "mm", np.linalg.norm(self.moved_mm, axis=2))
        return [*self.fields, length, Field("displacement along z", "mm", self.moved_mm[..., 2])]
