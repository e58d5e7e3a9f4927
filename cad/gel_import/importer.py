# SPDX-License-Identifier: Apache-2.0
"""A user's own gel from a file: its numbered faces, what is asked for, and what comes back."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import BeforeValidator, StrictStr

from taccel_lab.cad.mesh.surface import LabelledSurface
from taccel_lab.files.strict_model import StrictModel
from taccel_lab.geometry import Region, TetMesh

if TYPE_CHECKING:
    from taccel_lab.cad.parts.part import LabelledSolid


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


def triple(vector: Iterable[float]) -> tuple[float, float, float]:
    """Three numbers, rounded to the kernel's noise and without negative zeros."""
    x, y, z = (round(float(v), 9) + 0.0 for v in vector)
    return x, y, z


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


def _as_tuple(value: Any) -> Any:
    return (value,) if isinstance(value, str) else value


Selectors = Annotated[tuple[StrictStr, ...], BeforeValidator(_as_tuple)]
"""One or several; text stands for one."""


class FaceSelection(StrictModel):
    """Which faces are what, and how the body lies in its file; see ``selection`` for the words."""

    contact: Selectors = ("name:contact",)
    """Where nothing is stated, faces of the regions' names, or else what ``labelling`` proposes."""
    bond: Selectors = ("name:bond",)
    window: Selectors = ("name:window",)
    normal: str = "+z"
    """Direction of the file that points out of the gel; away from a plane bond, if not stated."""
    right: str = ""
    """Direction of the file that becomes the gel's x; +x, or +y for a normal along x, if empty."""
    origin: str = "center"
    """"center": the middle of the body in plan at the height of the apex; "file": as it is."""
    body: str = ""
    """Name of the solid in a file with several."""
    unit: str = ""
    """Unit of the numbers as read; millimetres, checked for plausibility, if empty."""
    thickness_mm: float = 0.0
    """Thickness that moves the glued surface; 0 leaves the gel as its file has it."""

    def assumed(self) -> dict[str, str]:
        """How the body lies in its file, as far as nobody has stated it, by the field's name."""
        taken = {
            "normal": f"{self.normal} of the file points out of the gel",
            "right": f"{self.right or right_of(self.normal)} of the file becomes the gel's x",
            "origin": "the middle of the body in plan, at the height of its apex",
            "unit": "the unit that the file declares",
        }
        return {name: text for name, text in taken.items() if name not in self.model_fields_set}

    @classmethod
    def from_toml(cls, path: Path | None) -> FaceSelection:
        """Read the fields as keys of a TOML file; the defaults without a file.

        Raises InputError with every key that is unknown or wrong.
        """
        return cls() if path is None else cls.read(path)


def right_of(normal: str) -> str:
    """The direction of the file that becomes the gel's x, where none is stated."""
    return "+y" if normal.strip().lstrip("+-") == "x" else "+x"


@dataclass(frozen=True)
class ImportedGel:
    """A gel read from a file, in the gel frame."""

    surface: LabelledSurface
    """Its closed triangles."""
    faces: PartFaces = field(repr=False)
    """The faces as the file has them."""
    face_regions: list[Region]
    """What each of them is for; a window that is split off counts as bond."""
    window_outline: np.ndarray | None
    """Corners of such a window in the frame of ``faces``, [4, 3]."""
    min_thickness_mm: float
    name: str
    selection: FaceSelection
    """What was asked for, completed."""
    assumed: dict[str, str]
    """What nobody has stated, by the field's name, in words."""
    rotation: np.ndarray
    """Gel from file: a point p of the file [mm] lies at ``rotation @ p + shift_mm``, [3, 3]."""
    shift_mm: np.ndarray
    part: LabelledSolid | None = None
    """The solid of a STEP file."""
    mesh: TetMesh | None = None
    """The tets of a file that has some."""

    @property
    def thickness_mm(self) -> float:
        """Gel between the highest contact point and the highest glued point under it [mm]."""
        return gel_thickness(self.surface)


def gel_thickness(surface: LabelledSurface) -> float:
    """Height of the highest contact point over the highest glued one [mm]."""
    z = surface.vertices_mm[:, 2]
    glued = np.isin(surface.regions, [int(Region.BOND), int(Region.WINDOW)])
    top = z[surface.triangles[surface.regions == int(Region.CONTACT)]].max()
    return float(top - z[surface.triangles[glued]].max())
