# SPDX-License-Identifier: Apache-2.0
"""What the gels of a scene show and feel, by name, as torch tensors on the solver's device.

A gel is a soft body that is bonded. Names, units and frames are those of ``SignalTactile``; pixels
and markers fill the view of a sensor's camera or, without a sensor, the contact face. Nothing here
waits for the device.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, QuadraticMesh, TetMesh
from taccel_lab.learning.gymnasium_names import spaces
from taccel_lab.outputs import Outputs, to_torch
from taccel_lab.signals.contact_fields import CONTACT_SIGNALS
from taccel_lab.signals.gel_faces import MARKERS, Colors, bonded_gels, face_grid, marker_points_mm
from taccel_lab.signals.markers import MarkerLayout
from taccel_lab.signals.tactile import SIGNALS, SignalTactile
from taccel_lab.solvers import SolverIPC
from taccel_lab.state import State

VIEWS = (*SIGNALS, "wrench")
"""What gels have to say."""
FORCES = (*CONTACT_SIGNALS, "wrench")
"""What is zero at a start, where nothing has been stepped."""
_VECTORS = ("normals", "points_m", "traction_pa", "slip_m")


class GelViews:
    """Looks at the gels of a solver's scene."""

    def __init__(
        self,
        solver: SolverIPC,
        names: tuple[str, ...],
        size_px: tuple[int, int] = (80, 60),
        colors: Colors | None = None,
        view: PixelGrid | None = None,
    ) -> None:
        """
        Args:
            solver: Of the scene.
            names: Of ``VIEWS``.
            size_px: Width and height of images.
            colors: For ``rgb`` and ``rgb_levels``; ``gel_colors.default_colors`` has some.
            view: What pixels see of each gel, in any number of them; its contact face when None.

        Raises:
            InputError: No gel, no colours, sliding of a scene without friction.
        """
        if {"rgb", "rgb_levels"} & set(names) and colors is None:
            raise InputError(
                "rgb needs colors: a function that gives the colour network and the untouched "
                "image of a pixel grid; gels without a camera have depth_m and markers_px"
            )
        if {"slip_m", "slipping"} & set(names) and solver.friction is None:
            raise InputError("slip_m and slipping need a scene with friction")
        self._outputs = Outputs(solver)
        self.device = solver.model.device
        self.gels = bonded_gels(solver.model)
        """Indices of the gels among the soft bodies."""
        bodies = [solver.model.scene.soft_bodies[i] for i in self.gels]
        self.grids = [
            face_grid(body.nodal_mesh, size_px) if view is None else view.resized(*size_px)
            for body in bodies
        ]
        """Pixels of each gel."""
        self._signals = [
            _signal(solver, gel, body.nodal_mesh, grid, colors)
            for gel, body, grid in zip(self.gels, bodies, self.grids, strict=True)
        ]
        gels, (width, height) = len(self.gels), size_px
        image = (gels, height, width)
        self._shapes: dict[str, tuple[int, ...]] = dict.fromkeys(SIGNALS, image)
        self._shapes |= dict.fromkeys(("rgb", "rgb_levels", *_VECTORS), (*image, 3))
        self._shapes["markers_px"] = (gels, MARKERS[0] * MARKERS[1], 2)
        self._shapes["wrench"] = (gels, 6)

    def space(self, name: str) -> spaces.Box:
        """Space of one environment."""
        shape = self._shapes[name]
        if name in ("contact", "slipping"):
            return spaces.Box(0, 1, shape, bool)  # type: ignore[arg-type]
        if name == "rgb":
            return spaces.Box(0, 255, shape, np.uint8)
        return spaces.Box(-np.inf, np.inf, shape, np.float32)

    def read(self, name: str, state: State) -> torch.Tensor:
        """What the last step led to, on memory of its own, [env, gel, ...]: a signal of
        ``SignalTactile`` (docs/signals.md), zero where that is NaN, or ``wrench``: force [N] and
        torque [N m] of contact and friction in the gel's frame where it has a mount, [6], float32.
        """
        if name == "wrench":
            return to_torch(self._outputs.update(state).soft_wrenches())[:, self.gels].float()
        return torch.stack([self._see(name, signal, state) for signal in self._signals], dim=1)

    def _see(self, name: str, signal: SignalTactile, state: State) -> torch.Tensor:
        signal.update(state)
        seen = to_torch(signal.read(name)[0])
        return torch.nan_to_num(seen) if seen.is_floating_point() else seen


def _signal(
    solver: SolverIPC,
    gel: int,
    mesh: TetMesh | QuadraticMesh,
    grid: PixelGrid,
    colors: Colors | None,
) -> SignalTactile:
    options: dict[str, Any] = {"markers": MarkerLayout.from_points(mesh, marker_points_mm(grid))}
    if colors is not None:
        options["color_model"], options["background_rgb"] = colors(grid)
    return SignalTactile.from_solver(solver, grid, gel=gel, **options)
