# SPDX-License-Identifier: Apache-2.0
"""Markers painted on the gel: points of its contact faces, seen by the camera.

A marker keeps its place in its face, so its position is the same weighted mean of the face's nodes
in every shape of the gel, which is where finite elements put that material point.
"""

# Warp compiles the kernels from their source; its type stubs describe neither vectors' operators
# nor FP64 overloads.
# pyright: reportArgumentType=false, reportAssignmentType=false, reportCallIssue=false
# pyright: reportGeneralTypeIssues=false, reportIndexIssue=false, reportOperatorIssue=false

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.camera.gel_camera import View
from taccel_lab.errors import InputError
from taccel_lab.geometry import QuadraticMesh, Region, TetMesh
from taccel_lab.model.env_rows import chosen_env
from taccel_lab.signals.eye import Eye, eye_of, seen_at
from taccel_lab.typed import typed

wp.set_module_options({"enable_backward": False})

# A marker on the rim of the face must not be lost to rounding.
_INSIDE = -1e-9


@typed
@dataclass(frozen=True)
class MarkerLayout:
    """Which point of which contact face each marker is."""

    nodes: np.ndarray
    """Mesh nodes of the marker's face, int32, shape [marker, 3]; [rest_count, marker, 3] where
    environments have gels of other shapes, whose cells lie elsewhere."""
    weights: np.ndarray
    """Their weights, sum one, float64, of the same shape."""
    lifts_m: np.ndarray | None = None
    """How far the designed face stands over the mesh's at rest, along z [m], float64, of the shape
    but for the last axis: a coarse mesh draws a curved face with chords. 0 when None."""

    @property
    def count(self) -> int:
        return self.nodes.shape[-2]

    def by_rest(self) -> tuple[np.ndarray, np.ndarray]:
        """Return nodes and weights, [rest_count, marker, 3] both."""
        if self.nodes.ndim == 2:
            return self.nodes[None], self.weights[None]
        return self.nodes, self.weights

    def lifts_by_rest(self) -> np.ndarray:
        """``lifts_m``, [rest_count, marker]."""
        nodes, _ = self.by_rest()
        lifts = np.zeros(nodes.shape[:-1]) if self.lifts_m is None else self.lifts_m
        return lifts.reshape(nodes.shape[:-1])

    def over(
        self,
        designed: TetMesh | QuadraticMesh,
        xy_mm: np.ndarray,
        mesh: TetMesh | QuadraticMesh,
        rest_positions_m: np.ndarray | None = None,
    ) -> MarkerLayout:
        """Place the same markers at ``xy_mm`` [marker, 2], on the face of the ``designed`` gel,
        which ``mesh``, or those of ``rest_positions_m``, draw more coarsely."""
        flat, there = MarkerLayout.where_on(designed, xy_mm)
        height_m = np.full(len(there), np.nan)
        height_m[there] = 1e-3 * flat.places_mm(designed.nodes_m)[:, 2]
        nodes, weights = self.by_rest()
        rests = mesh.nodes_m[None] if rest_positions_m is None else rest_positions_m
        meshed = [
            (rest[of, 2] * weight).sum(axis=-1)
            for rest, of, weight in zip(rests, nodes, weights, strict=False)
        ]
        lifts = np.nan_to_num(height_m - np.stack(meshed))
        return replace(self, lifts_m=lifts.reshape(self.nodes.shape[:-1]))

    @classmethod
    def seen_on(
        cls,
        mesh: TetMesh | QuadraticMesh,
        xy_mm: np.ndarray,
        view: View,
        rest_positions_m: np.ndarray | None = None,
        designed: TetMesh | QuadraticMesh | None = None,
    ) -> tuple[MarkerLayout, np.ndarray]:
        """Place the markers that lie on the undeformed contact face, in every environment, and that
        a view shows there.

        Arguments and results are those of ``where_on``; ``designed``: see ``over``.
        """
        xy = np.asarray(xy_mm, dtype=np.float64)
        layout, chosen = cls.where_on(mesh, xy, rest_positions_m)
        if designed is not None and designed is not mesh:
            layout = layout.over(designed, xy[chosen], mesh, rest_positions_m)
        rest_m = mesh.nodes_m if rest_positions_m is None else rest_positions_m[0]
        shown = view.contains(layout.places_mm(rest_m))
        chosen[chosen] = shown
        lifts = None if layout.lifts_m is None else layout.lifts_m[..., shown]
        return cls(layout.nodes[..., shown, :], layout.weights[..., shown, :], lifts), chosen

    def places_mm(self, positions_m: np.ndarray, gel: int = 0) -> np.ndarray:
        """Return where the markers are [mm], [..., marker, 3], with nodes at ``positions_m``
        [..., node, 3]; ``gel``: which of the rest shapes the gel has."""
        nodes, weights = self.by_rest()
        gel %= len(nodes)
        corners = np.asarray(positions_m, dtype=np.float64)[..., nodes[gel], :]
        places = (corners * weights[gel][..., None]).sum(axis=-2)
        places[..., 2] += self.lifts_by_rest()[gel]
        return 1e3 * places

    @classmethod
    @typed
    def from_points(
        cls,
        mesh: TetMesh | QuadraticMesh,
        xy_mm: np.ndarray,
        rest_positions_m: np.ndarray | None = None,
    ) -> MarkerLayout:
        """Place markers on the undeformed contact face.

        Args:
            mesh: Gel pad; a face of region CONTACT must lie under each marker.
            xy_mm: Gel xy of the markers [mm], shape [marker, 2].
            rest_positions_m: Nodes at rest where they are not those of ``mesh``, shape
                [rest_count, node, 3]: ``SoftBody.nodal_rest_m``.

        Raises:
            InputError: Wrong shape, or a marker beside the contact face.
        """
        layout, on_face = cls.where_on(mesh, xy_mm, rest_positions_m)
        if not on_face.all():
            index = int(np.argmin(on_face))
            raise InputError(
                f"marker {index} at {xy_mm[index]} mm lies beside the gel's contact face"
            )
        return layout

    @classmethod
    def where_on(
        cls,
        mesh: TetMesh | QuadraticMesh,
        xy_mm: np.ndarray,
        rest_positions_m: np.ndarray | None = None,
    ) -> tuple[MarkerLayout, np.ndarray]:
        """Place the markers that lie on the undeformed contact face, in every environment.

        Arguments are those of ``from_points``.

        Returns:
            Layout of those markers, and which they are, bool, shape [marker].
        """
        points = np.asarray(xy_mm, dtype=np.float64) * 1e-3
        if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
            raise InputError(f"xy_mm must be finite, shape [marker, 2], got {points.shape}")
        faces = mesh.region_faces(Region.CONTACT).astype(np.int32)
        rests = mesh.nodes_m[None] if rest_positions_m is None else rest_positions_m
        # Many environments share a shape.
        alike: dict[bytes, int] = {}
        corners = [rest[faces] for rest in rests]
        which = [alike.setdefault(at.tobytes(), row) for row, at in enumerate(corners)]
        found = {row: _placed(corners[row], faces, points) for row in alike.values()}
        if len(found) == 1:
            nodes, weights = found[0]
        else:
            nodes, weights = (np.stack([found[row][k] for row in which]) for k in range(2))
        on_face: np.ndarray = np.all(nodes >= 0, axis=(*range(nodes.ndim - 2), -1))
        return cls(nodes[..., on_face, :], weights[..., on_face, :]), on_face


def _placed(
    corners: np.ndarray, faces: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of the face under each of ``points`` [marker, 2], -1 where there is none, and weights,
    [marker, 3] both; ``corners`` [face, 3, 3] are where ``faces`` have their nodes."""
    a, ab, ac = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    up = area > 0
    faces, a, ab, ac, area = faces[up], a[up], ab[up], ac[up], area[up]
    z = corners[up, :, 2]
    chosen = np.full(len(points), -1)
    weights = np.zeros((len(points), 3))
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
    return np.where((chosen >= 0)[:, None], faces[chosen], np.int32(-1)), weights


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
    nodes: wp.array3d(dtype=wp.int32),
    weights: wp.array2d(dtype=wp.vec3d),
    lifts: wp.array2d(dtype=wp.float64),
    eye: Eye,
    # Out
    markers_px: wp.array2d(dtype=wp.vec2f),
):
    row, marker = wp.tid()
    env = chosen_env(envs, row)
    gel = env % nodes.shape[0]
    w = weights[gel, marker]
    point = w[0] * positions[env, nodes[gel, marker, 0]]
    point += w[1] * positions[env, nodes[gel, marker, 1]]
    point += w[2] * positions[env, nodes[gel, marker, 2]]
    point = in_gel_frame(frames, env, point)
    point[2] += lifts[gel, marker]
    pixel = seen_at(eye, point)
    markers_px[row, marker] = wp.vec2f(wp.float32(pixel[0]), wp.float32(pixel[1]))


class MarkerProjection:
    """Pixel positions of markers; one launch for all environments that are requested."""

    def __init__(
        self, layout: MarkerLayout, view: View, *, env_count: int, first_node: int, device: Any
    ) -> None:
        """
        Args:
            layout: Where the markers are painted.
            view: The camera that sees them.
            env_count: Number of environments.
            first_node: Of the gel in the arrays of positions.
            device: Warp device.

        Raises:
            InputError: The layout is of another number of gels.
        """
        self._eye = eye_of(view)
        nodes, weights = layout.by_rest()
        if len(nodes) not in (1, env_count):
            raise InputError(f"markers of {len(nodes)} gels, but there are {env_count}")
        self._nodes = wp.array(nodes + first_node, dtype=wp.int32, device=device)
        self._weights = wp.array(weights, dtype=wp.vec3d, device=device)
        self._lifts = wp.array(layout.lifts_by_rest(), dtype=wp.float64, device=device)
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
            inputs=[positions, frames, envs, self._nodes, self._weights, self._lifts, self._eye],
            outputs=[self.markers_px],
            device=self.markers_px.device,
        )
