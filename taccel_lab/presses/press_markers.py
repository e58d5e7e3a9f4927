# SPDX-License-Identifier: Apache-2.0
"""Dots of a pressed gel in the sensor's image, which ``taccel-lab press`` keeps."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.camera.gel_camera import View, camera_of
from taccel_lab.files.atomic_file import atomic_file
from taccel_lab.geometry import QuadraticMesh, TetMesh
from taccel_lab.signals.markers import MarkerLayout
from taccel_lab.summary import Summary

if TYPE_CHECKING:
    from taccel_lab.profile import SensorProfile

MARKERS = "markers.csv"
"""Name of the file in the folder of a press."""
COLUMNS = (
    "marker", "rest_u_px", "rest_v_px", "u_px", "v_px", "rest_x_mm", "rest_y_mm", "rest_z_mm",
    "x_mm", "y_mm", "z_mm",
)  # fmt: skip


@dataclass(frozen=True, repr=False)
class PressMarkers(Summary):
    """Dots that the image shows at rest, at rest and in each of some states."""

    image_px: tuple[int, int]
    """Width and height of the image that pixels are of."""
    rest_mm: np.ndarray
    """Gel xyz at rest, [marker, 3]."""
    places_mm: np.ndarray
    """The same in each state, [state, marker, 3]."""
    rest_px: np.ndarray
    """Columns and rows (u, v) at rest, [marker, 2]."""
    places_px: np.ndarray
    """[state, marker, 2]; NaN where the lens sees nothing."""

    @classmethod
    def of(
        cls, profile: SensorProfile, mesh: TetMesh | QuadraticMesh, positions_m: np.ndarray
    ) -> PressMarkers | None:
        """Dots of a profile with nodes at ``positions_m`` [state, node, 3], through its camera;
        None for a gel without."""
        if profile.markers is None:
            return None
        view: View = camera_of(profile)
        points = profile.markers.grid().points_mm()
        layout, _ = MarkerLayout.seen_on(mesh, points, view, designed=profile.mesh)
        rest, places = layout.places_mm(mesh.nodes_m), layout.places_mm(positions_m)
        size = view.width_px, view.height_px
        return cls(size, rest, places, view.pixel_from_gel(rest), view.pixel_from_gel(places))

    def summary(self) -> tuple[str, list[tuple[str, str]]]:
        """How many there are and how far they moved."""
        moved = np.linalg.norm(self.places_px[-1] - self.rest_px, axis=1)
        return f"{len(self.rest_px)} markers", [
            ("image", f"{self.image_px[0]} x {self.image_px[1]} px"),
            ("largest motion", f"{np.nanmax(moved, initial=0.0):.3g} px"),
        ]

    def arrays(self) -> dict[str, np.ndarray]:
        """The last state, for ``signals.npz``."""
        return {
            "rest_markers_px": self.rest_px,
            "markers_px": self.places_px[-1],
            "rest_markers_m": 1e-3 * self.rest_mm,
            "markers_m": 1e-3 * self.places_mm[-1],
        }

    def figures(self) -> dict[str, Any]:
        """The last state, for JSON."""
        moved_px = np.linalg.norm(self.places_px[-1] - self.rest_px, axis=1)
        known = moved_px[np.isfinite(moved_px)]
        return {
            "count": len(self.rest_px),
            "image_px": self.image_px,
            "largest_motion_px": float(known.max()) if len(known) else None,
            "rest_px": self.rest_px,
            "px": self.places_px[-1],
            "rest_mm": self.rest_mm,
            "mm": self.places_mm[-1],
        }

    def write_csv(self, path: Path) -> None:
        """A row a marker of the last state; empty cells where the lens sees nothing."""
        numbers = np.concatenate(
            [self.rest_px, self.places_px[-1], self.rest_mm, self.places_mm[-1]], axis=1
        )
        lines = [",".join(COLUMNS)]
        for number, row in enumerate(numbers.tolist()):
            cells = ("" if math.isnan(value) else f"{value:.6g}" for value in row)
            lines.append(",".join([str(number), *cells]))
        with atomic_file(path) as staging:
            staging.write_text("\n".join(lines) + "\n", encoding="utf-8")
