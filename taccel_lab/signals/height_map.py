# SPDX-License-Identifier: Apache-2.0
"""Height map and normals of the deformed contact surface, on the pixels of the tactile image.

The gel's elements are larger than a pixel, so its piecewise-linear surface (``FACET``, the exact
reference) would show as facets under grazing light. ``SMOOTH`` rebuilds a C1 surface from the same
nodes: gradients by quadratic patch fits (``gradient_recovery``), then Clough-Tocher cubics
(``clough_tocher``); its normals come from the interpolant, not from pixel differences.
"""

from __future__ import annotations

import enum
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, QuadraticMesh, TetMesh
from taccel_lab.signals.clough_tocher import evaluate_on_pixels
from taccel_lab.signals.contact_surface import ContactSurface
from taccel_lab.signals.gradient_recovery import recover_gradients
from taccel_lab.signals.normals import normals_from_slopes
from taccel_lab.signals.raster import FaceRaster


class SurfaceMode(enum.Enum):
    """How the surface between the nodes is rebuilt."""

    FACET = "facet"
    SMOOTH = "smooth"


class SurfaceInterpolant:
    """Nodal fields of the contact surface evaluated at the pixel centres.

    The shared part of the surface signals: ``place(positions)`` locates the pixels in the deformed
    triangulation, ``evaluate(values)`` interpolates any nodal field there with its gradient.
    """

    def __init__(
        self,
        surface: ContactSurface,
        grid: PixelGrid,
        *,
        mode: SurfaceMode = SurfaceMode.SMOOTH,
        device: str = "cpu",
    ) -> None:
        self.surface = surface
        self.grid = grid
        self.mode = mode
        self.device = device
        self._raster = FaceRaster(surface.faces, grid, device=device)
        self._ring_start = wp.array(surface.ring_start, dtype=wp.int32, device=device)
        self._ring_nodes = wp.array(surface.ring_nodes, dtype=wp.int32, device=device)
        self._positions: Any = None

    def place(self, surface_positions: np.ndarray) -> None:
        """Locate the pixels; ``surface_positions`` [m], shape [env, surface_node, 3].

        Raises:
            InputError: An environment in which no contact face covers any pixel.
        """
        self._positions = wp.array(surface_positions, dtype=wp.vec3d, device=self.device)
        self._raster.update(self._positions)
        covered = (self._raster.face_at_pixel.numpy() >= 0).any(axis=(1, 2))
        if not covered.all():
            raise InputError(
                "no contact face covers a pixel in environments "
                f"{np.flatnonzero(~covered).tolist()}: the surface is folded, flat in projection "
                "or outside the image"
            )

    def evaluate(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Interpolate a nodal field, shape [env, surface_node].

        Returns:
            Value, shape [env, height_px, width_px], and gradient over xy [1/m], the same with a
            last axis of 2; NaN outside the pad.
        """
        if self._positions is None:
            raise RuntimeError("place() must be called before evaluate()")
        field = wp.array(values, dtype=wp.float64, device=self.device)
        gradients = None
        if self.mode is SurfaceMode.SMOOTH:
            gradients = recover_gradients(
                self._positions, field, self._ring_start, self._ring_nodes
            )
        value, slope = evaluate_on_pixels(
            self._positions,
            field,
            gradients,
            self._raster.faces,
            self._raster.face_at_pixel,
            self._raster.map,
        )
        return value.numpy(), slope.numpy()


class SignalHeightMap:
    """Height map and normals of the gel's contact surface.

    Construct with the mesh and the pixel grid, call ``update(positions)`` and read ``height_m``
    [m], shape [env, height_px, width_px], ``slope`` (dh/dx, dh/dy), [..., 2], and ``normals``,
    [..., 3]; all NaN outside the pad. The rest surface is the same call with the rest positions.
    """

    def __init__(
        self,
        mesh: TetMesh | QuadraticMesh,
        grid: PixelGrid,
        *,
        mode: SurfaceMode = SurfaceMode.SMOOTH,
        device: str = "cpu",
    ) -> None:
        """
        Args:
            mesh: Gel pad whose faces of region CONTACT are shown.
            grid: Pixels of the image.
            mode: ``SMOOTH`` for images, ``FACET`` for the exact finite-element surface.
            device: Warp device of the kernels.
        """
        self.grid = grid
        self.surface = ContactSurface.from_mesh(mesh)
        self._interpolant = SurfaceInterpolant(self.surface, grid, mode=mode, device=device)
        self._height_m: np.ndarray | None = None
        self._slope: np.ndarray | None = None
        self._normals: np.ndarray | None = None

    def update(self, positions: Any) -> None:
        """Read node positions in the gel frame [m], shape [env, node, 3], numpy or Warp.

        Raises:
            InputError: Wrong shape, NaN, or a surface that covers no pixel.
        """
        points = self.surface.surface_positions(positions)
        self._interpolant.place(points)
        self._height_m, self._slope = self._interpolant.evaluate(points[..., 2])
        self._normals = None

    @property
    def height_m(self) -> np.ndarray:
        """Height of the contact surface [m], shape [env, height_px, width_px], NaN outside."""
        return _read(self._height_m)

    @property
    def slope(self) -> np.ndarray:
        """dh/dx and dh/dy, shape [env, height_px, width_px, 2]."""
        return _read(self._slope)

    @property
    def normals(self) -> np.ndarray:
        """Outward unit normals in the gel frame, shape [env, height_px, width_px, 3]."""
        if self._normals is None:
            self._normals = normals_from_slopes(self.slope)
        return self._normals


def _read(value: np.ndarray | None) -> np.ndarray:
    if value is None:
        raise RuntimeError("update() must be called before a signal is read")
    return value
