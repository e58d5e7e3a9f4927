# SPDX-License-Identifier: Apache-2.0
"""What the gel of a running scene shows and feels: depth, pressure, markers, tactile image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.geometry import QuadraticMesh, Region, TetMesh
from taccel_lab.signals.gel_faces import Colors, face_grid, marker_points_mm
from taccel_lab.signals.markers import MarkerLayout
from taccel_lab.signals.tactile import SignalTactile

if TYPE_CHECKING:
    from taccel_lab.geometry import PixelGrid
    from taccel_lab.solvers import SolverIPC
    from taccel_lab.state import State

IMAGE_PX = 160
"""Height of the images of a gel."""


@dataclass(frozen=True)
class GelSnapshot:
    """A gel at one time."""

    depth_m: np.ndarray
    """Sink-in since rest, float32 [height, width]; negative where it rose, NaN beside the gel."""
    pressure_pa: np.ndarray
    """Contact pressure, float32 [height, width]; zero before the first step."""
    markers_px: np.ndarray
    """(u, v), float32 [marker, 2]; NaN where they are not seen."""
    rgb: np.ndarray | None
    """Tactile image, uint8 [height, width, 3]; None without colours."""


class GelWatch:
    """Reads environment 0 of one gel of a scene, in the gel's frame."""

    def __init__(self, solver: SolverIPC, gel: str, colors: Colors | None = None) -> None:
        """
        Args:
            solver: Of the scene.
            gel: Name of the soft body.
            colors: Colour network and untouched image of a grid; without them no tactile image.
        """
        index = solver.model.body_id(gel)
        mesh = solver.model.scene.soft_body(index).nodal_mesh
        self.grid: PixelGrid = face_grid(mesh, _size_px(mesh))
        points = MarkerLayout.from_points(mesh, marker_points_mm(self.grid))
        options: dict[str, Any] = {"markers": points}
        if colors is not None:
            options["color_model"], options["background_rgb"] = colors(self.grid)
        self._signal = SignalTactile.from_solver(solver, self.grid, gel=index, **options)
        self._colored = colors is not None

    def frame(self, state: State, stepped: bool) -> GelSnapshot:
        """The gel in a state; ``stepped``: whether the solver's forces are of this state."""
        signal = self._signal
        signal.update(state)
        depth = signal.depth_m.numpy()[0].copy()
        pressure = signal.pressure_pa.numpy()[0].copy() if stepped else np.zeros_like(depth)
        return GelSnapshot(
            depth_m=depth,
            pressure_pa=pressure,
            markers_px=signal.markers_px.numpy()[0].astype(np.float32),
            rgb=signal.rgb.numpy()[0].copy() if self._colored else None,
        )


def _size_px(mesh: TetMesh | QuadraticMesh) -> tuple[int, int]:
    """Square pixels over the contact face."""
    face = mesh.nodes_m[np.unique(mesh.region_faces(Region.CONTACT))][:, :2]
    width, height = np.ptp(face, axis=0)
    return max(1, round(IMAGE_PX * width / height)), IMAGE_PX
