# SPDX-License-Identifier: Apache-2.0
"""What the gels of a scene show and feel, by name, as torch tensors on the solver's device.

A gel is a soft body that is bonded. Pixels and markers fill its contact face; depth and markers say
how that differs from rest. Nothing here waits for the device.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
import warp as wp
from gymnasium import spaces

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, QuadraticMesh, Region, TetMesh
from taccel_lab.learning.poses import rotated
from taccel_lab.outputs import GelFrames, Outputs, to_torch
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.gel_faces import MARKERS, bonded_gels, face_grid, marker_points_mm
from taccel_lab.signals.markers import MarkerLayout
from taccel_lab.signals.tactile import SignalTactile
from taccel_lab.solvers import SolverIPC
from taccel_lab.state import State

VIEWS = ("image", "depth", "markers", "wrench", "traction")
"""What gels have to say."""
FORCES = ("wrench", "traction")
"""What is zero at a start, where nothing has been stepped."""
Colors = Callable[[PixelGrid], tuple[ColorModel, np.ndarray]]
"""Of the pixels of a gel its colour network and its image untouched, levels [height, width, 3]."""


class GelViews:
    """Looks at the gels of a solver's scene."""

    def __init__(
        self,
        solver: SolverIPC,
        names: tuple[str, ...],
        size_px: tuple[int, int] = (80, 60),
        colors: Colors | None = None,
    ) -> None:
        """
        Args:
            solver: Of the scene.
            names: Of ``VIEWS``.
            size_px: Width and height of images and depth.
            colors: For images.

        Raises:
            InputError: No gel, gels that differ where these views have one shape, no colours.
        """
        if "image" in names and colors is None:
            raise InputError(
                "image needs colors: a function that gives the colour network and the untouched "
                "image of a pixel grid; gels without a camera have depth and markers"
            )
        self._solver, self._model = solver, solver.model
        self._outputs = Outputs(solver)
        self.gels = bonded_gels(solver.model)
        """Indices of the gels among the soft bodies."""
        self._frames = GelFrames(self._model)
        bodies = [self._model.scene.soft_bodies[i] for i in self.gels]
        meshes = [body.nodal_mesh for body in bodies]
        grids = self.grids = [face_grid(mesh, size_px) for mesh in meshes]
        """Pixels of each gel."""
        self._signals = [self._signal(k, mesh, colors) for k, mesh in enumerate(meshes)]
        device = wp.device_to_torch(self._model.device)
        self._face_nodes = [
            torch.as_tensor(first + np.unique(mesh.region_faces(Region.CONTACT)), device=device)
            for first, mesh in zip(self._first_nodes(), meshes, strict=True)
        ]
        if "traction" in names and len({len(nodes) for nodes in self._face_nodes}) > 1:
            raise InputError("traction needs gels whose contact faces have as many nodes each")
        self._rest_mm: list[torch.Tensor] = []
        """Height of each gel's face at rest, float32, [row, column]."""
        if "depth" in names:
            self._rest_mm = [self._rest_height(k, mesh) for k, mesh in enumerate(meshes)]
        self._rest_px = [self._put(grid.pixel_from_gel(marker_points_mm(grid))) for grid in grids]
        self._inverse = self._put([-1.0, -1.0, -1.0, 1.0])
        """Times a quaternion, its inverse."""
        self._pitch = [self._put([grid.mm_per_px_x, grid.mm_per_px_y]) for grid in grids]
        gels, (width, height) = len(self.gels), size_px
        self._shapes = {
            "image": (gels, height, width, 3),
            "depth": (gels, height, width),
            "markers": (gels, MARKERS[0] * MARKERS[1], 2),
            "wrench": (gels, 6),
            "traction": (gels, len(self._face_nodes[0]), 3),
        }

    def space(self, name: str) -> spaces.Box:
        """Of one environment."""
        if name == "image":
            return spaces.Box(0, 255, self._shapes[name], np.uint8)
        return spaces.Box(-np.inf, np.inf, self._shapes[name], np.float32)

    def read(self, name: str, state: State) -> torch.Tensor:
        """What the last step led to, on memory of its own, [env, gel, ...].

        ``image``: uint8, [row, column, 3]. ``depth``: how far the face has sunk [mm], [row,
        column]. ``markers``: how far markers have moved along the face [mm], [marker, 2].
        ``wrench``: force [N] and torque [N m] of contact and friction in the gel's frame where it
        has a mount, [6]. ``traction``: force by area at the nodes of the face [kPa], in that frame,
        [node, 3]. All but images float32.
        """
        if name == "wrench":
            return to_torch(self._outputs.update(state).soft_wrenches())[:, self.gels].float()
        if name == "traction":
            return self._tractions(state)
        return torch.stack([self._see(name, k, state) for k in range(len(self.gels))], dim=1)

    def _see(self, name: str, gel: int, state: State) -> torch.Tensor:
        signal = self._signals[gel]
        signal.update(state.positions, self._frames.of(self.gels[gel], state))
        if name == "image":
            return to_torch(signal.rgb)
        if name == "depth":
            sunk = self._rest_mm[gel] - 1e3 * to_torch(signal.height_m)
            return torch.nan_to_num(sunk, nan=0.0)
        return (to_torch(signal.markers_px) - self._rest_px[gel]) * self._pitch[gel]

    def _tractions(self, state: State) -> torch.Tensor:
        load = to_torch(self._outputs.update(state).surface_load.tractions)
        found = []
        for gel, nodes in zip(self.gels, self._face_nodes, strict=True):
            traction = 1e-3 * load[:, nodes]
            frames = self._frames.of(gel, state)
            if frames is not None:
                back = to_torch(frames)[:, None, 3:] * self._inverse
                traction = rotated(back, traction)
            found.append(traction)
        return torch.stack(found, dim=1).float()

    def _first_nodes(self) -> list[int]:
        return [self._model.bodies[i].node_slice.start for i in self.gels]

    def _signal(
        self, k: int, mesh: TetMesh | QuadraticMesh, colors: Colors | None
    ) -> SignalTactile:
        model, background = colors(self.grids[k]) if colors else (None, None)
        return SignalTactile(
            mesh,
            self.grids[k],
            env_count=self._model.env_count,
            color_model=model,
            background_rgb=background,
            markers=MarkerLayout.from_points(mesh, marker_points_mm(self.grids[k])),
            first_node=self._first_nodes()[k],
            device=self._model.device,
        )

    def _rest_height(self, k: int, mesh: TetMesh | QuadraticMesh) -> torch.Tensor:
        device = self._model.device
        rest = SignalTactile(mesh, self.grids[k], env_count=1, device=device)
        rest.update(wp.array(mesh.nodes_m[None], dtype=wp.vec3d, device=device))
        return 1e3 * to_torch(rest.height_m)[0]

    def _put(self, values: Any) -> torch.Tensor:
        device = wp.device_to_torch(self._model.device)
        return torch.tensor(values, dtype=torch.float32, device=device)
