# SPDX-License-Identifier: Apache-2.0
"""What ``render`` shows: the scene, and beside it what each gel sees."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.learning.gel_views import GelViews

if TYPE_CHECKING:
    from taccel_lab.geometry import PixelGrid
    from taccel_lab.signals.gel_faces import Colors
    from taccel_lab.solvers import SolverIPC
    from taccel_lab.state import State

GEL_PX = (160, 120)
SCENE_PX = (320, 2 * GEL_PX[1])
DIRECTION = (1.0, -1.4, 0.6)
"""Where the scene is looked at from, in world axes."""
GAIN = 4
"""Factor of changes of images: a squeeze of half a millimetre is hardly seen in the image."""


class EnvPicture:
    """Draws environments: the scene at the left, then a column for each gel with its tactile image
    and, below, 4 times how far that is from the untouched one, about a middle grey."""

    def __init__(
        self,
        solver: SolverIPC,
        untouched: State,
        colors: Colors | None,
        view: PixelGrid | None,
    ) -> None:
        """
        Args:
            solver: Of the scene.
            untouched: Before the first step.
            colors: As of ``GelViews``.
            view: As of ``GelViews``.

        Raises:
            InputError: As of ``GelViews``.
        """
        self._model = solver.model
        self._views = GelViews(solver, ("rgb",), GEL_PX, colors, view)
        self._untouched = self._views.read("rgb", untouched)[0].cpu().numpy().astype(np.int16)

    def draw(self, state: State) -> tuple[np.ndarray, ...]:
        """Pictures of all environments, uint8 [240, 320 + 160 gels, 3]."""
        # Only who looks needs pyvista, which a machine that learns may lack.
        from taccel_lab.tasks.scene_picture import draw_bodies

        positions = state.positions.numpy()
        images = self._views.read("rgb", state).cpu().numpy()
        changes = np.clip(128 + GAIN * (images - self._untouched), 0, 255).astype(np.uint8)
        columns = np.concatenate([images, changes], axis=2)
        return tuple(
            np.concatenate([draw_bodies(self._model, nodes, DIRECTION, SCENE_PX), *gels], axis=1)
            for nodes, gels in zip(positions, columns, strict=True)
        )
