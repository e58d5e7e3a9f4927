# SPDX-License-Identifier: Apache-2.0
r"""Height map finer than the mesh: the object's own surface where the gel touches it.

In contact the gel takes the shape of the object, so the image shows the object, not the chords of
the elements. The fused surface is

    h = w h_A + (1 - w) h_B

- ``h_A``: the object's surface lowered by the interpolated gap, ``gap = max(s, 0)^(3/2)``
  (``contact_edge``); exact in contact, right slope at its edge,
- ``h_B``: the C1 surface through the gel's nodes (``height_map``),
- ``w``: one up to about an element outside the edge, zero from some elements on, C1 in between.
  Both surfaces pass through the open nodes, so the blend only trades interpolation errors.

IPC keeps the gel a barrier gap away from the object, and straight edges under a convex object keep
its nodes a little further. Neither is part of the sensor: nodes are lifted by them (fading with
distance) before anything is interpolated. Measured on 640x480 px with 0.2 mm elements: 0.05 to
0.1 s a frame; on exact data of ball presses up to 64 degrees steep 0.2 to 0.6 degrees (rms) in
contact, 0.4 to 0.9 around it, contact radius 0.003 to 0.012 mm small.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, TetMesh
from taccel_lab.signals.contact_edge import EdgeField, edge_field
from taccel_lab.signals.contact_surface import ContactSurface
from taccel_lab.signals.height_map import SurfaceInterpolant, SurfaceMode
from taccel_lab.signals.nodal_filter import filter_nodes
from taccel_lab.signals.normals import normals_from_slopes
from taccel_lab.signals.rigid_surface import RigidSurface

# The blend starts and ends this many elements outside the contact's edge.
_BLEND_ELEMENTS = (1.0, 3.0)
# The lift fades over this many barrier gaps, slow enough to add no visible slope (< 1/100).
_LIFT_FADE = 100.0
# Gel nodes up to this many edges from contact are filtered in terms of their gap.
_BESIDE_EDGES = 3


class SignalFusedSurface:
    """Height map, normals and contact of gel and object together.

    Construct with mesh and grid, call ``update(positions, surface)``, read the arrays.
    """

    def __init__(
        self,
        mesh: TetMesh,
        grid: PixelGrid,
        *,
        contact_gap_m: float,
        rest_positions_m: np.ndarray | None = None,
        filter_ripple: bool = True,
        device: str = "cpu",
    ) -> None:
        """
        Args:
            mesh: Gel pad whose faces of region CONTACT are shown.
            grid: Pixels of the image.
            contact_gap_m: Gap at which the barrier force ends (dhat) [m]; a node nearer than that
                is in contact.
            device: Warp device of the kernels.
        """
        if not (math.isfinite(contact_gap_m) and contact_gap_m >= 0):
            raise InputError(f"contact_gap_m must be a length >= 0 in metres, got {contact_gap_m}")
        self.grid = grid
        self.contact_gap_m = float(contact_gap_m)
        self.filter_ripple = filter_ripple
        self.surface = ContactSurface.from_mesh(mesh)
        self._interpolant = SurfaceInterpolant(
            self.surface, grid, mode=SurfaceMode.SMOOTH, device=device
        )
        rest = mesh.nodes_m if rest_positions_m is None else rest_positions_m
        self._rest_z = self.surface.surface_positions(rest)[..., 2]
        self._pixel_area_m2 = grid.mm_per_px_x * grid.mm_per_px_y * 1e-6
        shape = (0, grid.height_px, grid.width_px)
        self.height_m = np.zeros(shape)
        """Fused height [m], shape [env, height_px, width_px], NaN outside the pad."""
        self.slope = np.zeros((*shape, 2))
        """dh/dx and dh/dy of it, shape [env, height_px, width_px, 2]."""
        self.normals = np.zeros((*shape, 3))
        """Outward unit normals, shape [env, height_px, width_px, 3]."""
        self.gap_m = np.zeros(shape)
        """Gap to the object [m], zero in contact, NaN beyond the blend, [env, h, w]."""
        self.contact_mask = np.zeros(shape, dtype=bool)
        """Pixels in contact, shape [env, height_px, width_px]."""
        self.contact_radius_m = np.zeros(0)
        """Radius of the disc whose area the contact has [m], zero without contact, [env]."""
        self.contact_clipped = np.zeros(0, dtype=bool)
        """True where the contact reaches the image's border and the radius is too small, [env]."""

    def update(self, positions: Any, surface: RigidSurface) -> None:
        """Read node positions [m], shape [env, node, 3], and the object's surface.

        Raises:
            InputError: Wrong shape, NaN, or a surface that covers no pixel.
        """
        points = self.surface.surface_positions(positions)
        points, gap = self._prepare(points, surface)
        fields = [edge_field(self.surface, p[:, :2], g) for p, g in zip(points, gap, strict=True)]
        nodal_s = np.stack([np.zeros(len(gap[0])) if f is None else f.s for f in fields])
        # Nodes that touch but lie outside the edge go where the edge field sees them.
        seen = np.where(gap == 0.0, np.maximum(nodal_s, 0.0) ** 1.5, np.nan)
        points = _at_gap(points, seen, surface)
        self._interpolant.place(points)
        self.height_m, self.slope = self._interpolant.evaluate(points[..., 2])
        shape = self.height_m.shape
        self.gap_m = np.full(shape, np.nan)
        self.contact_mask = np.zeros(shape, dtype=bool)
        self.contact_radius_m = np.zeros(len(points))
        self.contact_clipped = np.zeros(len(points), dtype=bool)
        if any(field is not None for field in fields):
            s, s_slope = self._interpolant.evaluate(nodal_s)
            for env, field in enumerate(fields):
                if field is not None:
                    self._fuse(env, surface, field, s[env], s_slope[env])
                    self._measure_contact(env, s[env], s_slope[env])
        self.normals = normals_from_slopes(self.slope)

    def _prepare(self, points: np.ndarray, surface: RigidSurface) -> tuple[np.ndarray, np.ndarray]:
        """Nodes lifted by the barrier gap and filtered where open, and what is left of their gap.

        Returns:
            Positions [m], shape [env, node, 3], and gap [m], shape [env, node]: zero in contact.
        """
        gap = surface.gap(points)
        # In contact the straight edges touch and the nodes hang below them.
        touching = gap <= self.contact_gap_m + self._chord_gap(points, gap, surface)
        touched = np.asarray(touching.any(axis=1))
        # Open nodes ride on the barrier's layer; it fades too slowly to tilt them.
        reach = _LIFT_FADE * max(self.contact_gap_m, 1e-12)
        layer = self.contact_gap_m * np.exp(-np.maximum(gap - self.contact_gap_m, 0.0) / reach)
        lifted_gap = np.where(touching, 0.0, gap - layer)
        lifted = _at_gap(points, lifted_gap, surface)
        fixed = touching.copy()
        for env in np.flatnonzero(touched) if self.filter_ripple else ():
            rest_z = self._rest_z[min(env, len(self._rest_z) - 1)]
            fixed[env] |= self._filter_open_nodes(lifted[env], lifted_gap[env], rest_z)
        lifted_gap = np.where(fixed, lifted_gap, np.maximum(surface.gap(lifted), 0.0))
        lifted = _at_gap(lifted, lifted_gap, surface)
        # Environments without contact stay as they are.
        return (
            np.where(touched[:, None, None], lifted, points),
            np.where(touched[:, None], lifted_gap, gap),
        )

    def _chord_gap(self, points: np.ndarray, gap: np.ndarray, surface: RigidSurface) -> np.ndarray:
        """How far nodes hang below a convex object that their straight edges touch [m]."""
        first, second = self.surface.edges.T
        middle = surface.gap(0.5 * (points[:, first] + points[:, second]))
        dip = np.nan_to_num(0.5 * (gap[:, first] + gap[:, second]) - middle)
        total = np.zeros_like(gap)
        for ends in (first, second):
            np.add.at(total.T, ends, dip.T)
        edge_count = np.diff(self.surface.ring_start)
        return np.maximum(total / edge_count, 0.0)

    def _filter_open_nodes(
        self, points: np.ndarray, gap: np.ndarray, rest_z: np.ndarray
    ) -> np.ndarray:
        """Take the mesh's ripple out of the open nodes of one environment, in place.

        Beside the contact the smooth quantity is s (``contact_edge``) and ``gap`` changes; further
        out it is the height above the rest surface, which leaves the pad's own shape alone, and
        ``points`` change.

        Returns:
            The nodes beside the contact, shape [node].
        """
        open_nodes = gap != 0.0
        measured = open_nodes & np.isfinite(gap)
        beside = measured & self._near(~open_nodes)
        s = filter_nodes(self.surface, points[:, :2], np.cbrt(gap) ** 2, measured)
        rise = points[:, 2] - rest_z
        rise = filter_nodes(self.surface, points[:, :2], rise, open_nodes, passes=2)
        gap[beside] = np.maximum(s[beside], 0.0) ** 1.5
        far = open_nodes & ~beside
        points[far, 2] = (rest_z + rise)[far]
        return beside

    def _near(self, nodes: np.ndarray) -> np.ndarray:
        """Nodes at most ``_BESIDE_EDGES`` edges from the given ones."""
        first, second = self.surface.edges.T
        near = nodes.copy()
        for _ in range(_BESIDE_EDGES):
            reached = near.copy()
            reached[first[near[second]]] = True
            reached[second[near[first]]] = True
            near = reached
        return near

    def _measure_contact(self, env: int, s: np.ndarray, s_slope: np.ndarray) -> None:
        """Contact mask, and the radius of the disc of equal area with pixels cut by the edge.

        The object must be there: beside its silhouette the edge field is a mere continuation.
        """
        under_object = np.isfinite(self.gap_m[env])
        pixel_m = math.sqrt(self._pixel_area_m2)
        steepness = np.maximum(np.hypot(s_slope[..., 0], s_slope[..., 1]), 1e-30)
        covered = np.clip(0.5 - s / (steepness * pixel_m), 0.0, 1.0)
        covered = np.where(under_object, covered, 0.0)
        self.contact_mask[env] = under_object & (s < 0)
        self.contact_radius_m[env] = math.sqrt(covered.sum() * self._pixel_area_m2 / math.pi)
        rim = np.concatenate([covered[0], covered[-1], covered[:, 0], covered[:, -1]])
        self.contact_clipped[env] = bool((rim > 0).any())

    def _fuse(
        self,
        env: int,
        surface: RigidSurface,
        field: EdgeField,
        s: np.ndarray,
        s_slope: np.ndarray,
    ) -> None:
        """Blend the object's surface into the gel's, in place, where the weight is not zero."""
        start, end = (n * field.element_m * field.growth for n in _BLEND_ELEMENTS)
        pixels = np.flatnonzero(s.ravel() < end)
        s_near, slope_near = s.ravel()[pixels], s_slope.reshape(-1, 2)[pixels]
        opened = np.sqrt(np.maximum(s_near, 0.0))
        gap = opened**3
        gap_slope = 1.5 * opened[:, None] * slope_near
        height, slope = surface.offset_height(env, pixels, gap, gap_slope)
        known = np.isfinite(height) & np.isfinite(slope).all(axis=1)
        t = np.clip((s_near - start) / (end - start), 0.0, 1.0)
        weight = np.where(known, 1.0 - t * t * (3.0 - 2.0 * t), 0.0)
        weight_slope = np.where(known, -6.0 * t * (1.0 - t) / (end - start), 0.0)
        height, slope = np.nan_to_num(height), np.nan_to_num(slope)
        gel_height = self.height_m[env].reshape(-1)
        gel_slope = self.slope[env].reshape(-1, 2)
        difference = height - gel_height[pixels]
        gel_slope[pixels] += (
            weight[:, None] * (slope - gel_slope[pixels])
            + (difference * weight_slope)[:, None] * slope_near
        )
        gel_height[pixels] += weight * difference
        self.gap_m[env].reshape(-1)[pixels] = np.where(known, gap, np.nan)


def _at_gap(points: np.ndarray, gap: np.ndarray, surface: RigidSurface) -> np.ndarray:
    """Points moved vertically to a gap; those that have none stay."""
    height = surface.height_at_gap(points, gap)
    moved = points.copy()
    moved[..., 2] = np.where(np.isfinite(height), height, points[..., 2])
    return moved
