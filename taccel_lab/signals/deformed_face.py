# SPDX-License-Identifier: Apache-2.0
r"""The contact face as it lies now, at the pixels, by way of where its points were at rest.

Beside the edge of a punch the gel climbs a wall. Over the image its triangles are slivers there,
and a height that is interpolated over the image between their corners overshoots by the height of
the wall, one way on this triangle, the other on the next. At rest the same triangles are well
shaped, and how far their points have moved is smooth. So the three coordinates of the deformed face
are interpolated over its xy at rest, C1 as in ``SurfaceSampler``, and the face they describe is
looked at from the camera: each pixel shows the point that the rasteriser finds on a net finer than
the pixels, with the slopes of the surface, by the chain rule,

    (dh/dx, dh/dy) = (dz/dX, dz/dY) J^-1,    J = d(x, y) / d(X, Y).

A 4 mm square punch 1 mm deep, heights beside it: 0.1 mm above the gel at rest to 0.1 mm below the
punch when interpolated over the image, monotonous within 5 um here.
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

from taccel_lab.geometry import PixelGrid, QuadraticMesh, TetMesh
from taccel_lab.signals.contact_surface import ContactSurface
from taccel_lab.signals.raster import FaceRaster, GridMap, barycentric, grid_map, pixel_xy, xy_of
from taccel_lab.signals.surface_sampler import SurfaceSampler

wp.set_module_options({"enable_backward": False})

# Least d(x, y) / d(X, Y) that slopes are divided by: where the face stands upright, or the C1
# surface overhangs by a hair between points that do not, a slope is steep and not infinite.
_UPRIGHT = wp.constant(wp.float64(0.02))


@wp.kernel
def _net_points_kernel(
    samples: wp.array3d(dtype=wp.vec3f),
    # Out
    points: wp.array2d(dtype=wp.vec3d),
):
    v, u = wp.tid()
    points[0, v * samples.shape[2] + u] = wp.vec3d(
        wp.float64(samples[0, v, u][2]),
        wp.float64(samples[1, v, u][2]),
        wp.float64(samples[2, v, u][2]),
    )


@wp.func
def _between(field: wp.array2d(dtype=wp.vec3f), corners: wp.vec3i, bary: wp.vec3d) -> wp.vec3d:
    """A field with its derivatives over the xy at rest, between three points of the net."""
    total = wp.vec3d()
    for k in range(3):
        sample = field[corners[k] // field.shape[1], corners[k] % field.shape[1]]
        total += bary[k] * wp.vec3d(
            wp.float64(sample[0]), wp.float64(sample[1]), wp.float64(sample[2])
        )
    return total


@wp.kernel
def _pixels_kernel(
    x_field: wp.array2d(dtype=wp.vec3f),
    y_field: wp.array2d(dtype=wp.vec3f),
    field: wp.array2d(dtype=wp.vec3f),
    points: wp.array2d(dtype=wp.vec3d),
    triangles: wp.array2d(dtype=wp.int32),
    triangle_at_pixel: wp.array3d(dtype=wp.int32),
    grid: GridMap,
    # Out
    seen: wp.array2d(dtype=wp.vec3d),
):
    v, u = wp.tid()
    triangle = triangle_at_pixel[0, v, u]
    if triangle < 0:
        seen[v, u] = wp.vec3d(wp.float64(wp.nan), wp.float64(wp.nan), wp.float64(wp.nan))
        return
    corners = wp.vec3i(triangles[triangle, 0], triangles[triangle, 1], triangles[triangle, 2])
    bary = barycentric(
        pixel_xy(grid, u, v),
        xy_of(points[0, corners[0]]),
        xy_of(points[0, corners[1]]),
        xy_of(points[0, corners[2]]),
    )
    x = _between(x_field, corners, bary)
    y = _between(y_field, corners, bary)
    f = _between(field, corners, bary)
    area = wp.max(x[0] * y[1] - x[1] * y[0], _UPRIGHT)
    seen[v, u] = wp.vec3d(
        (f[0] * y[1] - f[1] * y[0]) / area, (f[1] * x[0] - f[0] * x[1]) / area, f[2]
    )


class DeformedFace:
    """Height, slope and other nodal fields of one deformed contact face at the pixels."""

    def __init__(
        self,
        mesh: TetMesh | QuadraticMesh,
        grid: PixelGrid,
        *,
        net_px: float = 0.5,
        device: str = "cpu",
    ) -> None:
        """
        Args:
            mesh: Gel pad at rest, whose faces of region CONTACT are shown.
            grid: Pixels of the image.
            net_px: Width at rest of the cells of the net, in pixels.
            device: Warp device.
        """
        self.surface = ContactSurface.from_mesh(mesh)
        """Topology of the contact face."""
        self.mesh, self.grid, self.net_px, self.device = mesh, grid, net_px, device
        self._rest = mesh.nodes_m[self.surface.node_idx]
        self._net: _Net | None = None

    def sample(self, nodes_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Height and slope of the face through surface nodes [m], shape [surface_node, 3].

        Returns:
            z [m], shape [height_px, width_px], and dz/dx, dz/dy, [height_px, width_px, 2]; NaN
            where no face covers a pixel.
        """
        low, high = self._shown(nodes_m)
        if self._net is None or not self._net.covers(low, high):
            self._net = _Net(self, low, high)
        self._net.move(nodes_m)
        return self._net.height()

    def sample_field(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Another nodal field on the face of the latest ``sample``, shape [surface_node].

        Returns:
            Its value and gradient over xy [unit of ``values`` / m], as of ``sample``.
        """
        assert self._net is not None, "sample comes first"
        return self._net.field(values)

    def _shown(self, nodes_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Least and greatest xy at rest [m] of the triangles that reach into the image."""
        u, v = np.moveaxis(self.grid.pixel_from_gel(nodes_m[:, :2] * 1e3), -1, 0)
        u, v = u[self.surface.faces], v[self.surface.faces]
        inside = (u.max(axis=1) >= 0) & (u.min(axis=1) <= self.grid.width_px - 1)
        inside &= (v.max(axis=1) >= 0) & (v.min(axis=1) <= self.grid.height_px - 1)
        xy = self._rest[self.surface.faces[inside if inside.any() else slice(None)], :2]
        return xy.min(axis=(0, 1)), xy.max(axis=(0, 1))


class _Net:
    """A net of points over a part of the face at rest, and where they are now."""

    def __init__(self, face: DeformedFace, low: np.ndarray, high: np.ndarray) -> None:
        """``low`` and ``high`` bound the xy at rest that it is to cover [m]."""
        self._low, self._high = low, high
        mesh, grid, device = face.mesh, face.grid, face.device
        step = face.net_px * np.array([grid.mm_per_px_x, grid.mm_per_px_y])
        width, height = (max(2, math.ceil(n) + 1) for n in 1e3 * (high - low) / step)
        net = PixelGrid(width, height, *step, *(-1e3 * low / step))
        self._sampler = SurfaceSampler(mesh, net, env_count=3, device=device)
        at_rest = np.broadcast_to(mesh.nodes_m, (3, *mesh.nodes_m.shape))
        self._xyz = self._sampler.sample(wp.array(at_rest, dtype=wp.vec3d, device=device))
        self._points = wp.empty((1, width * height), dtype=wp.vec3d, device=device)
        self._raster = FaceRaster(_net_triangles(width, height), grid, device=device)

    def covers(self, low: np.ndarray, high: np.ndarray) -> bool:
        return bool((low >= self._low).all() and (high <= self._high).all())

    def move(self, nodes_m: np.ndarray) -> None:
        """To surface nodes at [m], shape [surface_node, 3]."""
        # A copy, as fields are sampled into the same memory.
        self._xyz = wp.clone(self._sampler.sample_field(np.ascontiguousarray(nodes_m.T)))
        wp.launch(
            _net_points_kernel,
            dim=self._xyz.shape[1:],
            inputs=[self._xyz],
            outputs=[self._points],
            device=self._raster.device,
        )
        self._raster.update(self._points)

    def height(self) -> tuple[np.ndarray, np.ndarray]:
        """Height and slope at the pixels."""
        return self._at_pixels(self._xyz[2])

    def field(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Another field and its gradient over xy at the pixels."""
        return self._at_pixels(self._sampler.sample_field(values[None])[0])

    def _at_pixels(self, samples: wp.array) -> tuple[np.ndarray, np.ndarray]:
        raster = self._raster
        grid = raster.grid
        seen = wp.empty((grid.height_px, grid.width_px), dtype=wp.vec3d, device=raster.device)
        wp.launch(
            _pixels_kernel,
            dim=seen.shape,
            inputs=[
                self._xyz[0],
                self._xyz[1],
                samples,
                self._points,
                raster.faces,
                raster.face_at_pixel,
                grid_map(grid),
            ],
            outputs=[seen],
            device=raster.device,
        )
        values: Any = seen.numpy()
        return values[..., 2], values[..., :2]


def _net_triangles(width: int, height: int) -> np.ndarray:
    """Two triangles for each cell of a net of width x height points, shape [n, 3]."""
    node = np.arange(width * height).reshape(height, width)
    a, b, c, d = (
        corner.ravel() for corner in (node[:-1, :-1], node[:-1, 1:], node[1:, :-1], node[1:, 1:])
    )
    return np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)])
