# SPDX-License-Identifier: Apache-2.0
"""The numbered faces of a part from elsewhere, with the triangles that show them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class FaceInfo:
    """What a user sees of one face."""

    index: int
    name: str
    kind: str
    """"plane", "cylinder", "bspline" and so on; "curved" where the file has triangles alone."""
    area_mm2: float
    center_mm: tuple[float, float, float]
    normal: tuple[float, float, float]
    """Outward unit normal at the middle."""
    color: str

    def __str__(self) -> str:
        center = ", ".join(f"{v:z.2f}" for v in self.center_mm)
        normal = ", ".join(f"{v:z.2f}" for v in self.normal)
        return (
            f"{self.index:4d}  {self.kind:<9} {self.area_mm2:10.3f} mm^2  at ({center})  "
            f"normal ({normal})  {self.color or '-':<6}  {self.name or '-'}"
        )


@dataclass(frozen=True)
class PartFaces:
    """A part's faces and its triangles, in the frame and the unit of its file."""

    table: list[FaceInfo]
    vertices: np.ndarray
    """float64, [n, 3]."""
    triangles: np.ndarray
    """Outward, int32, [m, 3]."""
    face_of: np.ndarray
    """Number of each triangle's face, int32, [m]."""


def listing(table: Sequence[FaceInfo], most: int = 40) -> str:
    """The table of faces as text."""
    lines = ["index  type           area        middle [mm], outward normal, colour, name"]
    lines += [str(info) for info in table[:most]]
    if len(table) > most:
        lines.append(f"  ... and {len(table) - most} more")
    return "\n".join(lines)
