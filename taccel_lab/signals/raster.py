# SPDX-License-Identifier: Apache-2.0
"""Which triangle a pixel's ray meets: orthographic rasterisation in FP64.

The camera looks along +z through the gel, so a ray meets the surface of lowest z first, and only
triangles that face the ray's far side can be met. Pixel centres are tested with barycentric
coordinates, inclusive on edges, so that no pixel falls between two triangles.
"""

# Warp compiles the kernels from their source; its type stubs describe neither vectors' operators
# nor FP64 overloads.
# pyright: reportArgumentType=false, reportAssignmentType=false, reportCallIssue=false
# pyright: reportGeneralTypeIssues=false, reportIndexIssue=false, reportOperatorIssue=false

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from taccel_lab.geometry import PixelGrid
from taccel_lab.processes.start_warp import start_warp

wp.set_module_options({"enable_backward": False})

# Barycentric slack: a pixel exactly on a shared edge must belong to at least one triangle.
EDGE_SLACK = wp.constant(wp.float64(1e-10))
# Two passes evaluate the same z with possibly different rounding; a picometre is far below both
# the mesh and the light's resolution.
_TIE_M = wp.constant(wp.float64(1e-12))


@wp.struct
class GridMap:
    """Pixel (u, v) = xy [m] * scale + centre."""

    px_per_m: wp.vec2d
    center_px: wp.vec2d


@wp.func
def barycentric(p: wp.vec2d, a: wp.vec2d, b: wp.vec2d, c: wp.vec2d) -> wp.vec3d:
    """Barycentric coordinates of ``p`` in triangle ``abc`` (signed, sum one)."""
    ab = b - a
    ac = c - a
    ap = p - a
    area = ab[0] * ac[1] - ab[1] * ac[0]
    l1 = (ap[0] * ac[1] - ap[1] * ac[0]) / area
    l2 = (ab[0] * ap[1] - ab[1] * ap[0]) / area
    return wp.vec3d(wp.float64(1.0) - l1 - l2, l1, l2)


@wp.func
def xy_of(p: wp.vec3d) -> wp.vec2d:
    return wp.vec2d(p[0], p[1])


@wp.func
def place_xy(grid: GridMap, u: wp.float64, v: wp.float64) -> wp.vec2d:
    """Gel xy of pixel coordinates [m]."""
    return wp.vec2d(
        (u - grid.center_px[0]) / grid.px_per_m[0], (v - grid.center_px[1]) / grid.px_per_m[1]
    )


@wp.func
def pixel_xy(grid: GridMap, u: int, v: int) -> wp.vec2d:
    """Gel xy of a pixel centre [m]."""
    return place_xy(grid, wp.float64(u), wp.float64(v))


@wp.func
def pixel_of(grid: GridMap, p: wp.vec3d) -> wp.vec2d:
    """Pixel coordinates (u, v) of a point of the gel."""
    return wp.vec2d(
        p[0] * grid.px_per_m[0] + grid.center_px[0], p[1] * grid.px_per_m[1] + grid.center_px[1]
    )


@wp.func
def signed_area2(a: wp.vec3d, b: wp.vec3d, c: wp.vec3d) -> wp.float64:
    """Twice the signed area of the xy projection [m^2]."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


@wp.kernel
def _rasterize_faces_kernel(
    positions: wp.array2d(dtype=wp.vec3d),
    faces: wp.array2d(dtype=wp.int32),
    grid: GridMap,
    active: wp.array(dtype=wp.int32),
    facing: wp.float64,
    min_area2: wp.float64,
    write_faces: int,
    # Out
    lowest_z: wp.array3d(dtype=wp.float64),
    face_at_pixel: wp.array3d(dtype=wp.int32),
):
    env, face = wp.tid()
    if active[env] == 0:
        return
    a = positions[env, faces[face, 0]]
    b = positions[env, faces[face, 1]]
    c = positions[env, faces[face, 2]]
    # Written so that NaN is not drawn.
    if not (facing * signed_area2(a, b, c) > min_area2):
        return
    low = wp.min(wp.min(xy_of(a), xy_of(b)), xy_of(c))
    high = wp.max(wp.max(xy_of(a), xy_of(b)), xy_of(c))
    slack = wp.float64(1e-6)
    u0 = wp.max(int(wp.ceil(low[0] * grid.px_per_m[0] + grid.center_px[0] - slack)), 0)
    v0 = wp.max(int(wp.ceil(low[1] * grid.px_per_m[1] + grid.center_px[1] - slack)), 0)
    u1 = wp.min(
        int(wp.floor(high[0] * grid.px_per_m[0] + grid.center_px[0] + slack)),
        lowest_z.shape[2] - 1,
    )
    v1 = wp.min(
        int(wp.floor(high[1] * grid.px_per_m[1] + grid.center_px[1] + slack)),
        lowest_z.shape[1] - 1,
    )
    for v in range(v0, v1 + 1):
        for u in range(u0, u1 + 1):
            bary = barycentric(pixel_xy(grid, u, v), xy_of(a), xy_of(b), xy_of(c))
            if wp.min(wp.min(bary[0], bary[1]), bary[2]) >= -EDGE_SLACK:
                z = bary[0] * a[2] + bary[1] * b[2] + bary[2] * c[2]
                if write_faces == 0:
                    wp.atomic_min(lowest_z, env, v, u, z)
                elif z <= lowest_z[env, v, u] + _TIE_M:
                    # The larger index wins a shared edge: the same on every run and device.
                    wp.atomic_max(face_at_pixel, env, v, u, face)


def grid_map(grid: PixelGrid) -> Any:
    """The kernel-side form of a pixel grid."""
    value = GridMap()
    value.px_per_m = wp.vec2d(1e3 / grid.mm_per_px_x, 1e3 / grid.mm_per_px_y)
    value.center_px = wp.vec2d(grid.center_u_px, grid.center_v_px)
    return value


def smallest_area2(grid: PixelGrid) -> float:
    """Twice the projected area [m^2] up to which a triangle is not drawn.

    A triangle thinner than a millionth of a pixel cannot hold a pixel centre but would divide by
    nearly zero.
    """
    return 1e-12 * grid.mm_per_px_x * grid.mm_per_px_y


def rasterize(
    positions: Any,
    faces: Any,
    grid: PixelGrid,
    active: Any,
    lowest_z: Any,
    face_at_pixel: Any,
    *,
    faces_up: bool = True,
) -> None:
    """Find the first triangle that each pixel's ray meets.

    Args:
        positions: Nodes [m], Warp array of vec3d, shape [env, node].
        faces: Triangles, Warp int32 array, shape [face, 3].
        grid: Pixels of the image.
        active: Environments to look at, Warp int32 array, shape [env], zero for the others.
        lowest_z: Height of what each pixel is known to meet [m], infinite for nothing; lowered
            here. Warp float64 array, shape [env, height_px, width_px].
        face_at_pixel: Set where ``lowest_z`` is met; holds -1 before. Warp int32 array, same shape.
        faces_up: See ``FaceRaster``.
    """
    # The first pass finds the lowest z, the second names the triangle that holds it.
    for write_faces in (0, 1):
        wp.launch(
            _rasterize_faces_kernel,
            dim=(positions.shape[0], len(faces)),
            inputs=[
                positions,
                faces,
                grid_map(grid),
                active,
                1.0 if faces_up else -1.0,
                smallest_area2(grid),
                write_faces,
            ],
            outputs=[lowest_z, face_at_pixel],
            device=faces.device,
        )


class FaceRaster:
    """Finds for each pixel the first triangle that a ray from the camera meets.

    Construct with the triangulation and the pixel grid, call ``update(positions)``, read
    ``lowest_z`` [m] (infinite where there is no triangle) and ``face_at_pixel`` (-1 there), both
    of shape [env, height_px, width_px].
    """

    def __init__(
        self,
        faces: np.ndarray,
        grid: PixelGrid,
        *,
        faces_up: bool = True,
        device: str = "cpu",
    ) -> None:
        """
        Args:
            faces: Triangles, shape [face_count, 3].
            grid: Pixel grid of the image.
            faces_up: True for triangles whose outward normal has positive z (a gel seen from
                inside), False for the underside of an object that rests on the gel.
            device: Warp device.
        """
        self.grid = grid
        start_warp()
        self.device = device
        self.faces = wp.array(np.ascontiguousarray(faces, dtype=np.int32), device=device)
        self.map = grid_map(grid)
        self.lowest_z: Any = None
        self.face_at_pixel: Any = None
        self._faces_up = faces_up

    def update(self, positions: Any) -> None:
        """Rasterise nodes at ``positions`` [m], Warp array of vec3d, shape [env, node]."""
        env_count = positions.shape[0]
        shape = (env_count, self.grid.height_px, self.grid.width_px)
        self.lowest_z = wp.full(shape, np.inf, dtype=wp.float64, device=self.device)
        self.face_at_pixel = wp.full(shape, -1, dtype=wp.int32, device=self.device)
        rasterize(
            positions,
            self.faces,
            self.grid,
            wp.full(env_count, 1, dtype=wp.int32, device=self.device),
            self.lowest_z,
            self.face_at_pixel,
            faces_up=self._faces_up,
        )
