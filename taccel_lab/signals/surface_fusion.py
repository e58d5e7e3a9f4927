# SPDX-License-Identifier: Apache-2.0
r"""Height map finer than the mesh: the object's own shape where the gel touches it.

In contact the gel takes the shape of the object, so the image shows the object, not the chords of
the elements. The fused surface is

    h = w h_A + (1 - w) h_B

- ``h_A``: the object's surface lowered by the gap, ``gap = g0 + max(s, 0)^(3/2)``
  (``contact_edge``); follows the object in contact and leaves it with the right slope,
- ``h_B``: the C1 surface through the gel's nodes (``DeformedFace``),
- ``w``: one up to half an element outside the edge, zero from one and a half on, C1 in between;
  also zero where the object is so steep that it hides behind its silhouette.

``g0`` is the gap at the rim of the contact: IPC keeps the gel a barrier gap away from the object,
and straight edges under a convex object keep its nodes a little further. With it both surfaces pass
through the open nodes, so the blend trades interpolation errors only. Lifting the contact to the
object itself instead draws a moat around it: 25 um over an element are 5 degrees.

What is in contact is told by the recovered pressure, not by a gap below the barrier's range: nodes
hang below chords by more than a short range, and then a contact of 1.4 mm seemed to be one of 0.3
to 0.7 mm. Nodes with more than half of the largest pressure of their patch are in contact; those
that are a quarter further from the object than any of them are open; between lies the edge, where
the open gaps say. Where that opens nodes well within the loaded ones, a part is pressed weakly
beside a strong one, and all such nodes are in contact: a roller whose ends press hard into a fine
mesh seemed to touch over a quarter of its contact.

Contact radius of balls of 2 and 8 mm, 0.4 to 1 mm deep, quadratic tets, 3 to 5 elements to the
largest contact radius, dhat 20 to 2 um, at the same force: within 1.3 % of their mean. That of the
2 mm ball 0.4 mm deep is 1.5 to 3.8 % less than on a mesh of 37,000 nodes, most with dhat 20 um on
the coarse mesh. In contact the slope is that of the ball to 1.3 degrees (that of g0). Figures of
tools with edges are in docs/signals.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, QuadraticMesh, TetMesh
from taccel_lab.signals.contact_edge import EdgeField, edge_field
from taccel_lab.signals.deformed_face import DeformedFace
from taccel_lab.signals.normals import normals_from_slopes
from taccel_lab.signals.rest_surface import RestCorrection, RestSurface
from taccel_lab.signals.rigid_surface import RigidSurface

# The blend starts and ends this many elements outside the contact's edge.
_BLEND_ELEMENTS = (0.5, 1.5)
# A node is in contact for sure above this part of the largest pressure of its patch: recovered
# pressures reach an element beyond the edge, with less than half of it.
_CORE_PRESSURE = 0.5
# So are those this many edges of the surface, two to a quadratic element, within the loaded nodes,
# where one of them seems open by its gap: under the corners of a tool the pressure is many times
# that in between, and the gap a part of it.
_WITHIN_EDGES = 3
# A node is open for sure beyond this many of the largest gap of such nodes: the barrier's range, or
# how far they hang below chords that touch. Nodes between are told by those beside them. With 1.5,
# nodes beside a contact with friction 1 that carried nothing were told by what lies further out,
# and the fused surface was 0.5 degrees off that of the nodes an element further.
_OPEN_GAPS = 1.25


class SignalFusedSurface:
    """Height map, normals and contact of gel and object together, and the gel at rest.

    Construct with mesh and grid, call ``update(positions, surface, pressures_pa)``, read the
    arrays. Numpy arrays, one environment after the other: for presses, not for thousands of
    environments.
    """

    def __init__(
        self,
        mesh: TetMesh | QuadraticMesh,
        grid: PixelGrid,
        *,
        designed_rest: RestSurface | None = None,
        points: int = 1,
        device: str = "cpu",
    ) -> None:
        """
        Args:
            mesh: Gel pad whose faces of region CONTACT are shown.
            grid: Pixels of the image.
            designed_rest: The pad's contact face on ``grid`` where ``mesh`` draws it more coarsely,
                see ``RestCorrection``.
            points: A pixel shows the mean over ``points`` x ``points`` of heights and of normals,
                with which Lambert's light goes. One is enough where the surface bends little within
                a pixel, as under balls, not for tools with edges.
            device: Warp device of the kernels.
        """
        self.grid = grid
        self._points = points
        self.sample_grid = grid.refined(points)
        """Where surface and object are looked at: what objects are to be given on."""
        self._face = DeformedFace(mesh, self.sample_grid, net_px=0.5 * points, device=device)
        self.surface = self._face.surface
        """Topology of the contact face."""
        at_rest = self._face.sample(mesh.nodes_m[self.surface.node_idx])
        self.rest_height_m, slope = self._pixel_means(*at_rest)
        """Height of the gel at rest [m], shape [height_px, width_px], NaN outside the pad."""
        self._correction: RestCorrection | None = None
        if designed_rest is not None:
            self._correction = RestCorrection.of(designed_rest, self.rest_height_m, slope)
            self.rest_height_m, slope = self._correction.corrected(self.rest_height_m, slope)
        self.rest_normals = normals_from_slopes(slope)
        """Outward unit normals at rest, shape [height_px, width_px, 3]."""
        self._sample_area_m2 = grid.mm_per_px_x * grid.mm_per_px_y * 1e-6 / points**2
        shape = (0, grid.height_px, grid.width_px)
        self.height_m = np.zeros(shape)
        """Fused height [m], shape [env, height_px, width_px], NaN outside the pad."""
        self.slope = np.zeros((*shape, 2))
        """dh/dx and dh/dy that go with ``normals``, shape [env, height_px, width_px, 2]."""
        self.normals = np.zeros((*shape, 3))
        """Outward unit normals, shape [env, height_px, width_px, 3]."""
        self.contact_mask = np.zeros(shape, dtype=bool)
        """Pixels at least half of which is in contact, shape [env, height_px, width_px]."""
        self.contact_radius_m = np.zeros(0)
        """Radius of the disc whose area the contact has [m], zero without contact, [env]."""

    def update(self, positions: Any, surface: RigidSurface, pressures_pa: np.ndarray) -> None:
        """Read node positions [m], shape [env, node, 3], the object's surface and the contact
        pressures at the nodes [Pa], shape [env, node] (``SurfaceLoad.pressures``).

        Raises:
            InputError: Wrong shape, NaN, or a surface that covers no pixel.
        """
        points = self.surface.surface_positions(positions)
        shape = (len(points), self.surface.node_count_total)
        if np.shape(pressures_pa) != shape or not np.isfinite(pressures_pa).all():
            raise InputError(
                f"pressures_pa has shape {np.shape(pressures_pa)}; {list(shape)} finite pressures "
                "are needed, one for each node of positions"
            )
        pressures = np.asarray(pressures_pa, dtype=np.float64)[:, self.surface.node_idx]
        gap, layer = self._open_gap(points, pressures, surface)
        shape = (len(points), self.grid.height_px, self.grid.width_px)
        self.height_m, self.slope = np.empty(shape), np.empty((*shape, 2))
        self.contact_mask = np.zeros(shape, dtype=bool)
        self.contact_radius_m = np.zeros(len(points))
        for env, nodes in enumerate(points):
            seen = self._sampled_gel(env, nodes)
            field = edge_field(self.surface, nodes[:, :2], gap[env])
            if field is not None:
                edge = _Edge(field, *self._face.sample_field(field.s))
                under_object = _fuse(seen, env, surface, edge, layer[env])
                self._measure_contact(env, edge, under_object)
            self.height_m[env], self.slope[env] = self._pixel_means(seen.height_m, seen.slope)
            if self._correction is not None:
                self.height_m[env], self.slope[env] = self._correction.corrected(
                    self.height_m[env], self.slope[env], self.contact_mask[env]
                )
        self.normals = normals_from_slopes(self.slope)

    def _sampled_gel(self, env: int, nodes: np.ndarray) -> _Sampled:
        """The surface through its nodes [m], shape [surface_node, 3]."""
        height, slope = self._face.sample(nodes)
        if not np.isfinite(height).any():
            raise InputError(
                f"no contact face covers a pixel in environment {env}: the surface is folded, flat "
                "in projection or outside the image"
            )
        return _Sampled(height, slope)

    def _pixel_means(self, height: np.ndarray, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean height and slope of the mean normal over each pixel's points that have them."""
        if self._points == 1:
            return height, slope
        known = np.isfinite(slope[..., 0]) & np.isfinite(slope[..., 1])
        count = self._pixel_sums(known)
        heights = self._pixel_sums(np.where(known, height, 0.0))
        normals = self._pixel_sums(np.where(known[..., None], normals_from_slopes(slope), 0.0))
        with np.errstate(invalid="ignore"):
            return heights / count, -normals[..., :2] / normals[..., 2:]

    def _pixel_sums(self, values: np.ndarray) -> np.ndarray:
        """Sums over each pixel's points."""
        rows, columns = self.grid.height_px, self.grid.width_px
        shape = (rows, self._points, columns, self._points, *values.shape[2:])
        return np.add.reduce(values.reshape(shape), axis=(1, 3), dtype=np.float64)

    def _open_gap(
        self, points: np.ndarray, pressures: np.ndarray, surface: RigidSurface
    ) -> tuple[np.ndarray, np.ndarray]:
        """Gap of the nodes beyond the contact's own, and that.

        Returns:
            Gap [m], shape [env, node]: zero in contact, NaN where neither pressure nor gap decide
            or the object is not above the node; and the contact's own gap [m], shape [env].
        """
        gap = surface.gap(points)
        layer = np.zeros(len(points))
        for env, pressure in enumerate(pressures):
            core, within = self._core(pressure)
            held = core & np.isfinite(gap[env])
            if not held.any():
                gap[env] = np.where(core, 0.0, np.nan)
                continue
            if (gap[env, within] > _OPEN_GAPS * gap[env, held].max()).any():
                core |= within
                held = core & np.isfinite(gap[env])
            layer[env] = _gap_without_pressure(gap[env, held], pressure[held])
            opened = gap[env] > _OPEN_GAPS * gap[env, held].max()
            gap[env] = np.where(core, 0.0, np.where(opened, gap[env] - layer[env], np.nan))
        return gap, layer

    def _core(self, pressure: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nodes with most of the largest pressure of their own patch of contact, and nodes well
        within the loaded ones, each of shape [node]."""
        from scipy import sparse

        loaded = pressure > 0
        first, second = self.surface.edges.T
        joined = self.surface.edges[loaded[self.surface.edges].all(axis=1)]
        count = len(pressure)
        graph = sparse.coo_array((np.ones(len(joined)), tuple(joined.T)), shape=(count, count))
        _, label = sparse.csgraph.connected_components(graph, directed=False)
        largest = np.zeros(count)
        np.maximum.at(largest, label, pressure)
        within = loaded.copy()
        for _ in range(_WITHIN_EDGES):
            within[np.concatenate([first[~within[second]], second[~within[first]]])] = False
        return loaded & (pressure > _CORE_PRESSURE * largest[label]), within

    def _measure_contact(self, env: int, edge: _Edge, under_object: np.ndarray) -> None:
        """Contact mask, and the radius of the disc of equal area with points cut by the edge.

        The object must be there: beside its silhouette the edge field is a mere continuation.
        """
        side_m = math.sqrt(self._sample_area_m2)
        steepness = np.maximum(np.hypot(edge.slope[..., 0], edge.slope[..., 1]), 1e-30)
        covered = np.clip(0.5 - edge.s / (steepness * side_m), 0.0, 1.0)
        covered = np.where(under_object, covered, 0.0)
        touching = self._pixel_sums(under_object & (edge.s < 0))
        self.contact_mask[env] = 2 * touching >= self._points**2
        self.contact_radius_m[env] = math.sqrt(covered.sum() * self._sample_area_m2 / math.pi)


@dataclass
class _Sampled:
    """One surface on the grid of samples."""

    height_m: np.ndarray
    slope: np.ndarray


@dataclass(frozen=True)
class _Edge:
    """The edge field on the grid of samples."""

    field: EdgeField
    s: np.ndarray
    slope: np.ndarray


def _fuse(
    gel: _Sampled, env: int, surface: RigidSurface, edge: _Edge, layer_m: float
) -> np.ndarray:
    """Blend the object's surface into the gel's, in place, where the weight is not zero.

    Returns:
        Where the object is known there, bool, as large as the gel's height.
    """
    field = edge.field
    start, end = (n * field.element_m * field.growth for n in _BLEND_ELEMENTS)
    pixels = np.flatnonzero(edge.s.ravel() < end)
    s_near, slope_near = edge.s.ravel()[pixels], edge.slope.reshape(-1, 2)[pixels]
    opened = np.sqrt(np.maximum(s_near, 0.0))
    gap = opened**3
    gap_slope = 1.5 * opened[:, None] * slope_near
    height, slope = surface.offset_height(env, pixels, layer_m + gap, gap_slope)
    seen, seen_slope = surface.seen(env, pixels, layer_m + gap, gap_slope)
    known = np.isfinite(height) & np.isfinite(slope).all(axis=1)
    gel_height, gel_slope = gel.height_m.reshape(-1), gel.slope.reshape(-1, 2)
    t = np.clip((s_near - start) / (end - start), 0.0, 1.0)
    near = 1.0 - t * t * (3.0 - 2.0 * t)
    near_slope = (-6.0 * t * (1.0 - t) / (end - start))[:, None] * slope_near
    weight = near * seen
    weight_slope = near_slope * seen[:, None] + near[:, None] * seen_slope
    # Not a product with zero: the object may have no height there.
    lift = np.where(known, height - gel_height[pixels], 0.0)
    lift_slope = np.where(known[:, None], slope - gel_slope[pixels], 0.0)
    gel_height[pixels] += weight * lift
    gel_slope[pixels] += weight[:, None] * lift_slope + lift[:, None] * weight_slope
    under_object = np.zeros(gel.height_m.shape, dtype=bool)
    under_object.reshape(-1)[pixels] = known
    return under_object


def _gap_without_pressure(gap: np.ndarray, pressure: np.ndarray) -> float:
    """Gap at which the pressure in a contact would end [m], from gaps and pressures of its nodes.

    A straight line through them, as a barrier keeps nodes under pressure nearer; not below their
    mean, nor more than a quarter beyond the largest gap.
    """
    mean, spread = gap.mean(), pressure - pressure.mean()
    variance = (spread**2).sum()
    if variance <= 1e-4 * (pressure**2).sum():
        return float(mean)
    slope = (spread * gap).sum() / variance
    return float(np.clip(mean - slope * pressure.mean(), mean, 1.25 * gap.max()))
