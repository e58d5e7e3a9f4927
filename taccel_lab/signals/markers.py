# SPDX-License-Identifier: Apache-2.0
"""Markers painted on the gel: points of its contact faces, seen by the camera.

A marker keeps its place in its face, so its position is the same weighted mean of the face's nodes
in every shape of the gel, which is where finite elements put that material point. The camera of a
profile is orthographic (``PixelGrid``).
"""

# Warp compiles the kernels from their source; its type stubs describe neither vectors' operators
# nor FP64 overloads.
# pyright: reportArgumentType=false, reportAssignmentType=false, reportCallIssue=false
# pyright: reportGeneralTypeIssues=false, reportIndexIssue=false, reportOperatorIssue=false

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, QuadraticMesh, Region, TetMesh
from taccel_lab.model.env_rows import chosen_env
from taccel_lab.signals.raster import GridMap, grid_map, pixel_of

wp.set_module_options({"enable_backward": False})

# A marker on the rim of the face must not be lost to rounding.
_INSIDE = -1e-9


@dataclass(frozen=True)
class MarkerLayout:
    """Which point of which contact face each marker is."""

    nodes: np.ndarray
    """Mesh nodes of the marker's face, int32, shape [marker, 3]."""
    weights: np.ndarray
    """Their weights, sum one, float64, shape [marker, 3]."""

    @property
    def count(self) -> int:
        return len(self.nodes)

    @classmethod
    def from_points(cls, mesh: TetMesh | QuadraticMesh, xy_mm: np.ndarray) -> MarkerLayout:
        """Place markers on the undeformed contact face.

        Args:
            mesh: Gel pad; a face of region CONTACT must lie under each marker.
            xy_mm: Gel xy of the markers [mm], shape [marker, 2].

        Raises:
            InputError: Wrong shape, or a marker beside the contact face.
        """
        layout, on_face = cls.where_on(mesh, xy_mm)
        if not on_face.all():
            index = int(np.argmin(on_face))
            raise InputError(
                f"marker {index} at {xy_mm[index]} mm lies beside the gel's contact face"
            )
        return layout

    @classmethod
    def where_on(
        cls, mesh: TetMesh | QuadraticMesh, xy_mm: np.ndarray
    ) -> tuple[MarkerLayout, np.ndarray]:
        """Place the markers that lie on the undeformed contact face.

        Returns:
            Layout of those markers, and which they are, bool, shape [marker].
        """
        points = np.asarray(xy_mm, dtype=np.float64) * 1e-3
        if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
            raise InputError(f"xy_mm must be finite, shape [marker, 2], got {points.shape}")
        faces = mesh.region_faces(Region.CONTACT)
        corners = mesh.nodes_m[faces]
        a, ab, ac = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
        up = area > 0
        faces, a, ab, ac, area = faces[up], a[up], ab[up], ac[up], area[up]
        z = corners[up, :, 2]
        chosen = np.full(len(points), -1)
        weights = np.empty((len(points), 3))
        for index, point in enumerate(points):
            ap = point - a[:, :2]
            second = (ap[:, 0] * ac[:, 1] - ap[:, 1] * ac[:, 0]) / area
            third = (ab[:, 0] * ap[:, 1] - ab[:, 1] * ap[:, 0]) / area
            bary = np.stack([1.0 - second - third, second, third], axis=1)
            inside = np.flatnonzero(bary.min(axis=1) >= _INSIDE)
            if len(inside) == 0:
                continue
            # The camera looks through the gel and meets the lowest layer first.
            height = (bary[inside] * z[inside]).sum(axis=1)
            chosen[index] = inside[np.argmin(height)]
            weights[index] = bary[chosen[index]]
        on_face = chosen >= 0
        return cls(faces[chosen[on_face]].astype(np.int32), weights[on_face]), on_face


@wp.func
def in_gel_frame(frames: wp.array(dtype=wp.transformd), env: int, point: wp.vec3d) -> wp.vec3d:
    """A point given in the world, or already in the gel frame where there are no frames."""
    if frames.shape[0] == 0:
        return point
    return wp.transform_point(wp.transform_inverse(frames[env]), point)


@wp.kernel
def _project_markers_kernel(
    positions: wp.array2d(dtype=wp.vec3d),
    frames: wp.array(dtype=wp.transformd),
    envs: wp.array(dtype=wp.int32),
    nodes: wp.array2d(dtype=wp.int32),
    weights: wp.array(dtype=wp.vec3d),
    grid: GridMap,
    # Out
    markers_px: wp.array2d(dtype=wp.vec2f),
):
    row, marker = wp.tid()
    env = chosen_env(envs, row)
    w = weights[marker]
    point = w[0] * positions[env, nodes[marker, 0]]
    point += w[1] * positions[env, nodes[marker, 1]]
    point += w[2] * positions[env, nodes[marker, 2]]
    point = in_gel_frame(frames, env, point)
    pixel = pixel_of(grid, point)
    markers_px[row, marker] = wp.vec2f(wp.float32(pixel[0]), wp.float32(pixel[1]))


class MarkerProjection:
    """Pixel positions of markers; one launch for all environments that are asked for."""

    def __init__(
        self, layout: MarkerLayout, grid: PixelGrid, *, env_count: int, first_node: int, device: Any
    ) -> None:
        """
        Args:
            layout: Where the markers are painted.
            grid: Pixels of the image.
            env_count: Number of environments.
            first_node: Of the gel in the arrays of positions.
            device: Warp device.
        """
        self._grid = grid_map(grid)
        self._nodes = wp.array(layout.nodes + first_node, dtype=wp.int32, device=device)
        self._weights = wp.array(layout.weights, dtype=wp.vec3d, device=device)
        self.markers_px = wp.empty((env_count, layout.count), dtype=wp.vec2f, device=device)
        """Columns and rows (u, v) [px], vec2f, shape [env, marker]."""

    def update(self, positions: wp.array, frames: wp.array, envs: wp.array, count: int) -> None:
        """Read node positions [m], vec3d, [env, node], and world_from_gel, transformd, [env] (of
        length 0 when positions are in the gel frame).

        ``envs``: the environments that the first ``count`` rows are to be of, int32; of length 0
        for all.
        """
        wp.launch(
            _project_markers_kernel,
            dim=(count, self.markers_px.shape[1]),
            inputs=[positions, frames, envs, self._nodes, self._weights, self._grid],
            outputs=[self.markers_px],
            device=self.markers_px.device,
        )
