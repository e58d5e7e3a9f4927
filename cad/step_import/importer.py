# SPDX-License-Identifier: Apache-2.0
"""A user's own gel from a STEP file, as it is asked for and as it comes back."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import BeforeValidator, StrictStr

from taccel_lab.cad.mesh.surface import LabelledSurface
from taccel_lab.cad.step_import.selection import FaceInfo
from taccel_lab.files.strict_model import StrictModel
from taccel_lab.geometry import Region

if TYPE_CHECKING:
    from taccel_lab.cad.parts.labelled_solid import LabelledSolid


def _as_tuple(value: Any) -> Any:
    return (value,) if isinstance(value, str) else value


Selectors = Annotated[tuple[StrictStr, ...], BeforeValidator(_as_tuple)]
"""One or several; text stands for one."""


class FaceSelection(StrictModel):
    """Which faces are what, and how the body lies in its file; see ``selection`` for the words."""

    contact: Selectors = ("name:contact",)
    bond: Selectors = ("name:bond",)
    window: Selectors = ("name:window",)
    normal: str = "+z"
    """Direction of the file that points out of the gel."""
    right: str = ""
    """Direction of the file that becomes the gel's x; +x, or +y for a normal along x, if empty."""
    origin: str = "center"
    """"center": the middle of the body in plan at the height of the apex; "file": as it is."""
    body: str = ""
    """Name of the solid in a file with several."""
    unit: str = ""
    """Unit of the numbers as read; millimetres, checked for plausibility, if empty."""

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

    part: LabelledSolid
    surface: LabelledSurface
    """Closed triangles of the part."""
    faces: list[FaceInfo] = field(repr=False)
    """The faces as the file has them."""
    min_thickness_mm: float
    name: str
    rotation: np.ndarray
    """Gel from file: a point p of the file [mm] lies at ``rotation @ p + shift_mm``, [3, 3]."""
    shift_mm: np.ndarray

    @property
    def thickness_mm(self) -> float:
        """Gel between the highest contact point and the highest glued point under it [mm]."""
        z = self.surface.vertices_mm[:, 2]
        glued = np.isin(self.surface.regions, [int(Region.BOND), int(Region.WINDOW)])
        top = z[self.surface.triangles[self.surface.regions == int(Region.CONTACT)]].max()
        return float(top - z[self.surface.triangles[glued]].max())
