# SPDX-License-Identifier: Apache-2.0
"""Heights and slopes of the underside of a rigid body over a gel, at the pixels, in many
environments.

A mesh is rasterised where its vertices are, a ball is its lower half. Slopes of a mesh are those of
the surface that it stands for (``corner_normals``): facets of a curved surface do not show, edges
do. A texture stands out of either along the gel's z, by its relief at the point of the body that is
there.
"""

# Warp compiles the kernels from their source; its type stubs describe neither vectors' operators
# nor FP64 overloads.
# pyright: reportArgumentType=false, reportAssignmentType=false, reportCallIssue=false
# pyright: reportGeneralTypeIssues=false, reportIndexIssue=false, reportOperatorIssue=false

from __future__ import annotations

import math
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.bodies.bodies import AffineBody, KinematicBody
from taccel_lab.bodies.primitives import Ball, TriangleMesh
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.geometry.shading_normals import corner_normals
from taccel_lab.model import Model
from taccel_lab.model.env_rows import chosen_env
from taccel_lab.signals.markers import in_gel_frame
from taccel_lab.signals.raster import (
    GridMap,
    barycentric,
    grid_map,
    pixel_xy,
    rasterize,
    xy_of,
)
from taccel_lab.signals.texture import Texture
from taccel_lab.state import State

wp.set_module_options({"enable_backward": False})

_WALL = wp.constant(wp.float64(math.cos(math.radians(82.0))))
"""z of normals of faces that are too steep to be followed, at most: a pixel spans as much of them
as an element of the gel does."""
_LEAST_DOWN = wp.constant(wp.float64(0.05))
"""Least size of z of interpolated normals, which is below zero: slopes up to 87 degrees."""


@wp.kernel
def _gather_vertices_kernel(
    positions: wp.array2d(dtype=wp.vec3d),
    frames: wp.array(dtype=wp.transformd),
    envs: wp.array(dtype=wp.int32),
    first: int,
    # Out
    vertices: wp.array2d(dtype=wp.vec3d),
):
    row, i = wp.tid()
    env = chosen_env(envs, row)
    vertices[row, i] = in_gel_frame(frames, env, positions[env, first + i])


@wp.kernel
def _ball_heights_kernel(
    center: wp.array2d(dtype=wp.vec3d),
    radius: wp.float64,
    grid: GridMap,
    # Out
    heights: wp.array3d(dtype=wp.float64),
    slopes: wp.array3d(dtype=wp.vec2f),
):
    env, v, u = wp.tid()
    c = center[env, 0]
    xy = pixel_xy(grid, u, v)
    dx = xy[0] - c[0]
    dy = xy[1] - c[1]
    below = radius * radius - dx * dx - dy * dy
    height = wp.float64(wp.inf)
    slope = wp.vec2f(wp.nan, wp.nan)
    if below > wp.float64(0.0):
        height = c[2] - wp.sqrt(below)
        if below > _WALL * _WALL * radius * radius:
            slope = wp.vec2f(float(dx / wp.sqrt(below)), float(dy / wp.sqrt(below)))
    heights[env, v, u] = height
    slopes[env, v, u] = slope


@wp.func
def _turned(v: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d) -> wp.vec3d:
    """Turns a vector from the axes of a triangle, its first side, across it and normal, to those it
    lies in."""
    along = wp.normalize(b - a)
    normal = wp.normalize(wp.cross(b - a, c - a))
    return v[0] * along + v[1] * wp.cross(normal, along) + v[2] * normal


@wp.kernel
def _shade_kernel(
    vertices: wp.array2d(dtype=wp.vec3d),
    faces: wp.array2d(dtype=wp.int32),
    normals: wp.array2d(dtype=wp.vec3d),
    face_at_pixel: wp.array3d(dtype=wp.int32),
    grid: GridMap,
    # In and out
    heights: wp.array3d(dtype=wp.float64),
    # Out
    slopes: wp.array3d(dtype=wp.vec2f),
):
    row, v, u = wp.tid()
    face = face_at_pixel[row, v, u]
    slope = wp.vec2f(wp.nan, wp.nan)
    if face >= 0:
        a = vertices[row, faces[face, 0]]
        b = vertices[row, faces[face, 1]]
        c = vertices[row, faces[face, 2]]
        if wp.abs(wp.normalize(wp.cross(b - a, c - a))[2]) < _WALL:
            # Of a tool that leans by a degree a pixel shows millimetres of a wall.
            heights[row, v, u] = wp.float64(wp.inf)
        else:
            share = barycentric(pixel_xy(grid, u, v), xy_of(a), xy_of(b), xy_of(c))
            own = share[0] * normals[face, 0] + share[1] * normals[face, 1]
            own = wp.normalize(_turned(own + share[2] * normals[face, 2], a, b, c))
            down = wp.min(own[2], -_LEAST_DOWN)
            slope = wp.vec2f(float(-own[0] / down), float(-own[1] / down))
    slopes[row, v, u] = slope


@wp.func
def _between(relief: wp.array2d(dtype=wp.float32), x: wp.float64, y: wp.float64) -> wp.float64:
    """Bilinear between the centres of pixels of a map that is repeated."""
    rows = relief.shape[0]
    columns = relief.shape[1]
    i = int(wp.floor(x))
    j = int(wp.floor(y))
    s = x - wp.float64(i)
    t = y - wp.float64(j)
    one = wp.float64(1.0)
    left = ((i % columns) + columns) % columns
    upper = ((j % rows) + rows) % rows
    right = (left + 1) % columns
    lower = (upper + 1) % rows
    return (one - t) * (
        (one - s) * wp.float64(relief[upper, left]) + s * wp.float64(relief[upper, right])
    ) + t * ((one - s) * wp.float64(relief[lower, left]) + s * wp.float64(relief[lower, right]))


@wp.kernel
def _texture_kernel(
    relief: wp.array2d(dtype=wp.float32),
    px_per_m: wp.float64,
    poses: wp.array2d(dtype=wp.transformd),
    body: int,
    frames: wp.array(dtype=wp.transformd),
    envs: wp.array(dtype=wp.int32),
    grid: GridMap,
    # In and out
    heights: wp.array3d(dtype=wp.float64),
    slopes: wp.array3d(dtype=wp.vec2f),
):
    row, v, u = wp.tid()
    env = chosen_env(envs, row)
    slopes[row, v, u] = wp.vec2f(wp.nan, wp.nan)
    z = heights[row, v, u]
    if wp.isinf(z):
        return
    xy = pixel_xy(grid, u, v)
    point = wp.vec3d(xy[0], xy[1], z)
    if frames.shape[0] > 0:
        point = wp.transform_point(frames[env], point)
    own = wp.transform_point(wp.transform_inverse(poses[env, body]), point)
    half = wp.float64(0.5)
    x = own[0] * px_per_m + half * wp.float64(relief.shape[1] - 1)
    y = own[1] * px_per_m + half * wp.float64(relief.shape[0] - 1)
    heights[row, v, u] = z - _between(relief, x, y)


class ObjectHeights:
    """Underside of one rigid body of a model's scene."""

    def __init__(
        self,
        model: Model,
        body: str,
        grid: PixelGrid,
        *,
        rows: int,
        texture: Texture | None = None,
    ) -> None:
        """
        Args:
            model: Of the scene.
            body: Name of a kinematic or affine body, a ball or a mesh of triangles.
            grid: Pixels.
            rows: Most environments of one call.
            texture: Of a kinematic body, whose own shape is its mean surface.

        Raises:
            InputError: No such body, a plane, a texture of an affine body.
        """
        scene, device = model.scene, model.device
        index, found = _rigid_body(model, body)
        if not isinstance(found.shape, Ball | TriangleMesh):
            raise InputError(f"{body!r} must be a ball or a mesh of triangles")
        if texture is not None and not isinstance(found, KinematicBody):
            raise InputError(f"{body!r} has a texture, which needs a kinematic body")
        self._shape, self._grid, self._map = found.shape, grid, grid_map(grid)
        placed = model.bodies[len(scene.soft_bodies) + index]
        self._first = placed.nodes[0]
        self._kinematic = index - len(scene.affine_bodies)
        count = placed.nodes[1] - placed.nodes[0]
        self._vertices = wp.empty((rows, count), dtype=wp.vec3d, device=device)
        shape = (rows, grid.height_px, grid.width_px)
        self._heights = wp.empty(shape, dtype=wp.float64, device=device)
        self._slopes = wp.empty(shape, dtype=wp.vec2f, device=device)
        self._smooth = wp.empty(shape if texture else (0, 0, 0), dtype=wp.float64, device=device)
        self._device = device
        self._faces: Any = None
        if isinstance(found.shape, TriangleMesh):
            self._faces = wp.array(np.ascontiguousarray(found.shape.faces), dtype=wp.int32,
                                   device=device)  # fmt: skip
            normals = _in_triangles(found.shape)
            self._normals = wp.array(normals, dtype=wp.vec3d, device=device)
            self._face_at_pixel = wp.empty(shape, dtype=wp.int32, device=device)
            self._everyone = wp.full(rows, 1, dtype=wp.int32, device=device)
        self._relief: Any = None
        if texture is not None:
            relief = texture.relief_m().astype(np.float32)
            self._relief = wp.array(relief, dtype=wp.float32, device=device)
            self._px_per_m = relief.shape[1] / texture.width_m

    def read(
        self, state: State, frames: wp.array, envs: wp.array
    ) -> tuple[wp.array, wp.array, wp.array]:
        """z of the lowest point of the body over each pixel in the gel's frame [m], infinite where
        there is none or only a wall, float64, [row, height_px, width_px]; the same without the
        texture; and dz/dx and dz/dy of the first, vec2f, NaN where only its heights say. Valid
        until the next call.

        Args:
            state: Where everything is.
            frames: world_from_gel, transformd, [env_count]; of length 0 where the gel's frame is
                the world's.
            envs: The environments of the rows, int32.
        """
        count = len(envs)
        vertices, heights = self._vertices[:count], self._heights[:count]
        slopes = self._slopes[:count]
        self._launch(
            _gather_vertices_kernel,
            vertices.shape,
            [state.positions, frames, envs, self._first],
            [vertices],
        )
        if isinstance(self._shape, Ball):
            inputs = [vertices, self._shape.radius_m, self._map]
            self._launch(_ball_heights_kernel, heights.shape, inputs, [heights, slopes])
        else:
            at, everyone = self._face_at_pixel[:count], self._everyone[:count]
            heights.fill_(np.inf)
            at.fill_(-1)
            rasterize(vertices, self._faces, self._grid, everyone, heights, at, faces_up=False)
            inputs = [vertices, self._faces, self._normals, at, self._map]
            self._launch(_shade_kernel, heights.shape, inputs, [heights, slopes])
        if self._relief is None:
            return heights, heights, slopes
        smooth = self._smooth[:count]
        wp.copy(smooth, heights)
        inputs = [self._relief, self._px_per_m, state.poses, self._kinematic, frames, envs]
        self._launch(_texture_kernel, heights.shape, [*inputs, self._map], [heights, slopes])
        return heights, smooth, slopes

    def _launch(self, kernel: Any, dim: Any, inputs: list[Any], outputs: list[Any]) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self._device)


def is_ball(model: Model, body: str) -> bool:
    """Whether a rigid body has no edges."""
    return isinstance(_rigid_body(model, body)[1].shape, Ball)


def _rigid_body(model: Model, body: str) -> tuple[int, AffineBody | KinematicBody]:
    """Its place among affine and kinematic bodies, and itself; InputError where there is none."""
    rigid = [*model.scene.affine_bodies, *model.scene.kinematic_bodies]
    names = [one.name for one in rigid]
    if body not in names:
        raise InputError(
            f"there is no rigid body {body!r}; there are {', '.join(map(repr, names))}"
        )
    return names.index(body), rigid[names.index(body)]


def _in_triangles(mesh: TriangleMesh) -> np.ndarray:
    """``corner_normals`` in the axes of their triangles, see ``_turned``, [face, corner, 3]: they
    move with triangles wherever these are moved to."""
    a, b, c = (mesh.vertices_m[mesh.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    axes = np.stack([b - a, np.cross(normal, b - a), normal], axis=1)
    axes /= np.maximum(np.linalg.norm(axes, axis=2, keepdims=True), np.finfo(float).tiny)
    return np.einsum("fik,fck->fci", axes, corner_normals(mesh.vertices_m, mesh.faces))
