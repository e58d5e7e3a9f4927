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

Corners of quadratic elements where the face around them touches.

Of a load that is the same everywhere a corner of a quadratic triangle gets nothing: the integral of
its shape function is zero. So next to nothing holds a corner, and under the ridge of an object it
hangs as much as 40 um below the middles of the edges around it, at edges of 0.25 mm. No pressure
tells of that pit, and no correction of pressures closes it. Where all middles around a corner carry
and it hangs below the paraboloid through them, it goes there, which is off by the third order in
the edges' length.
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

from taccel_lab.geometry import PixelGrid, QuadraticMesh, Region, TetMesh
from taccel_lab.model import Model
from taccel_lab.model.env_rows import chosen_env
from taccel_lab.signals.markers import in_gel_frame
from taccel_lab.signals.raster import GridMap, barycentric, grid_map, pixel_xy, rasterize, xy_of
from taccel_lab.signals.surface_sampler import SurfaceSampler

wp.set_module_options({"enable_backward": False})

# Least d(x, y) / d(X, Y) that slopes are divided by: where the face stands upright, or the C1
# surface overhangs by a hair between points that do not, a slope is steep and not infinite.
_UPRIGHT = wp.constant(wp.float64(0.02))
REACH_MM = 2.0
"""How far from the image the gel that it shows may have been at rest."""


@wp.kernel
def _component_kernel(
    positions: wp.array2d(dtype=wp.vec3d),
    frames: wp.array(dtype=wp.transformd),
    envs: wp.array(dtype=wp.int32),
    node_idx: wp.array(dtype=wp.int32),
    axis: int,
    # Out
    values: wp.array2d(dtype=wp.float64),
):
    row, node = wp.tid()
    env = chosen_env(envs, row)
    values[row, node] = in_gel_frame(frames, env, positions[env, node_idx[node]])[axis]


@wp.kernel
def _net_points_kernel(
    x_field: wp.array3d(dtype=wp.vec3f),
    y_field: wp.array3d(dtype=wp.vec3f),
    z_field: wp.array3d(dtype=wp.vec3f),
    # Out
    points: wp.array2d(dtype=wp.vec3d),
):
    row, v, u = wp.tid()
    points[row, v * x_field.shape[2] + u] = wp.vec3d(
        wp.float64(x_field[row, v, u][2]),
        wp.float64(y_field[row, v, u][2]),
        wp.float64(z_field[row, v, u][2]),
    )


@wp.func
def _between(
    row: int, field: wp.array3d(dtype=wp.vec3f), corners: wp.vec3i, bary: wp.vec3d
) -> wp.vec3d:
    """A field with its derivatives over the xy at rest, between three points of the net."""
    total = wp.vec3d()
    for k in range(3):
        sample = field[row, corners[k] // field.shape[2], corners[k] % field.shape[2]]
        total += bary[k] * wp.vec3d(
            wp.float64(sample[0]), wp.float64(sample[1]), wp.float64(sample[2])
        )
    return total


@wp.kernel
def _pixels_kernel(
    x_field: wp.array3d(dtype=wp.vec3f),
    y_field: wp.array3d(dtype=wp.vec3f),
    z_field: wp.array3d(dtype=wp.vec3f),
    points: wp.array2d(dtype=wp.vec3d),
    triangles: wp.array2d(dtype=wp.int32),
    triangle_at_pixel: wp.array3d(dtype=wp.int32),
    grid: GridMap,
    # Out
    samples: wp.array3d(dtype=wp.vec3f),
):
    row, v, u = wp.tid()
    triangle = triangle_at_pixel[row, v, u]
    if triangle < 0:
        samples[row, v, u] = wp.vec3f(wp.nan, wp.nan, wp.nan)
        return
    corners = wp.vec3i(triangles[triangle, 0], triangles[triangle, 1], triangles[triangle, 2])
    bary = barycentric(
        pixel_xy(grid, u, v),
        xy_of(points[row, corners[0]]),
        xy_of(points[row, corners[1]]),
        xy_of(points[row, corners[2]]),
    )
    x = _between(row, x_field, corners, bary)
    y = _between(row, y_field, corners, bary)
    z = _between(row, z_field, corners, bary)
    area = wp.max(x[0] * y[1] - x[1] * y[0], _UPRIGHT)
    samples[row, v, u] = wp.vec3f(
        float((z[0] * y[1] - z[1] * y[0]) / area),
        float((z[1] * x[0] - z[0] * x[1]) / area),
        float(z[2]),
    )


class DeformedFace:
    """Samples (slope along x, slope along y, height [m]) of up to ``env_count`` environments, as
    those of ``SurfaceSampler``."""

    def __init__(
        self,
        mesh: TetMesh | QuadraticMesh,
        grid: PixelGrid,
        *,
        env_count: int = 1,
        first_node: int = 0,
        rest_positions: wp.array | None = None,
        net_px: float = 1.0,
        device: Any = "cpu",
    ) -> None:
        """
        Args:
            mesh: Gel pad at rest, whose faces of region CONTACT are shown.
            grid: Pixels of the image.
            env_count: Most environments of one call.
            first_node: Of this gel in the arrays of positions.
            rest_positions: Where each environment's nodes are at rest [m], vec3d, arrays like those
                of positions; those of ``mesh`` when None.
            net_px: Width at rest of the cells of the net, in pixels.
            device: Warp device.
        """
        self._mesh, self._grid, self._net_px, self._device = mesh, grid, net_px, device
        self._rows, self._first_node = env_count, first_node
        self._rest = rest_positions
        self._no_frames = wp.empty(0, dtype=wp.transformd, device=device)
        shape = (env_count, grid.height_px, grid.width_px)
        self._samples = wp.empty(shape, dtype=wp.vec3f, device=device)
        self._lowest_z = wp.empty(shape, dtype=wp.float64, device=device)
        self._triangle_at_pixel = wp.empty(shape, dtype=wp.int32, device=device)
        self._everyone = wp.full(env_count, 1, dtype=wp.int32, device=device)
        self._all_envs = wp.array(np.arange(env_count), dtype=wp.int32, device=device)
        self._net: PixelGrid | None = None

    def sample(
        self, positions: wp.array, frames: wp.array | None = None, envs: wp.array | None = None
    ) -> wp.array:
        """Samples the face as of ``SurfaceSampler``."""
        frames = self._no_frames if frames is None else frames
        envs = self._all_envs[: positions.shape[0]] if envs is None else envs
        if self._net is None:
            self._cast(len(frames) > 0, positions)
        count = len(envs)
        self._sampler.place(self._rest, frames, envs)
        values, fields = self._values[:count], [field[:count] for field in self._fields]
        for axis, field in enumerate(fields):
            inputs = [positions, frames, envs, self._node_idx, axis]
            self._launch(_component_kernel, values.shape, inputs, [values])
            wp.copy(field, self._sampler.sample_field(values))
        points, samples = self._points[:count], self._samples[:count]
        self._launch(_net_points_kernel, fields[0].shape, fields, [points])
        lowest_z, at = self._lowest_z[:count], self._triangle_at_pixel[:count]
        lowest_z.fill_(np.inf)
        at.fill_(-1)
        rasterize(points, self._triangles, self._grid, self._everyone[:count], lowest_z, at)
        inputs = [*fields, points, self._triangles, at, grid_map(self._grid)]
        self._launch(_pixels_kernel, samples.shape, inputs, [samples])
        return samples

    def _cast(self, turned: bool, positions: wp.array) -> None:
        """Make the net: what the image shows at rest and ``REACH_MM`` around it, no more than the
        face has where its frame is not turned."""
        grid, device = self._grid, self._device
        low = np.array([grid.x_mm()[0], grid.y_mm()[0]]) - REACH_MM
        high = np.array([grid.x_mm()[-1], grid.y_mm()[-1]]) + REACH_MM
        if self._rest is None:
            rest = np.zeros((self._rows, positions.shape[1], 3))
            end = self._first_node + self._mesh.node_count
            rest[:, self._first_node : end] = self._mesh.nodes_m
            self._rest = wp.array(rest, dtype=wp.vec3d, device=device)
        if not turned:
            face = self._first_node + self._mesh.region_nodes(Region.CONTACT)
            xy = 1e3 * self._rest.numpy()[:, face, :2].reshape(-1, 2)
            low, high = np.maximum(low, xy.min(axis=0)), np.minimum(high, xy.max(axis=0))
        step = self._net_px * np.array([grid.mm_per_px_x, grid.mm_per_px_y])
        width, height = (max(2, math.ceil(n) + 1) for n in (high - low) / step)
        net = self._net = PixelGrid(width, height, *step.tolist(), *(-low / step).tolist())
        rows = self._rows
        self._sampler = SurfaceSampler(
            self._mesh, net, env_count=rows, first_node=self._first_node, device=device
        )
        surface = self._sampler.surface
        node_idx = surface.node_idx + self._first_node
        self._node_idx = wp.array(node_idx, dtype=wp.int32, device=device)
        self._values = wp.empty((rows, surface.node_count), dtype=wp.float64, device=device)
        self._fields = [
            wp.empty((rows, height, width), dtype=wp.vec3f, device=device) for _ in range(3)
        ]
        self._points = wp.empty((rows, width * height), dtype=wp.vec3d, device=device)
        triangles = _net_triangles(width, height)
        self._triangles = wp.array(triangles, dtype=wp.int32, device=device)

    def _launch(self, kernel: Any, dim: Any, inputs: list[Any], outputs: list[Any]) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self._device)


def _net_triangles(width: int, height: int) -> np.ndarray:
    """Two triangles for each cell of a net of width x height points, shape [n, 3]."""
    node = np.arange(width * height).reshape(height, width)
    a, b, c, d = (
        corner.ravel() for corner in (node[:-1, :-1], node[:-1, 1:], node[1:, :-1], node[1:, 1:])
    )
    return np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)])


PARABOLOID = 6
"""Numbers that it has."""


@wp.kernel
def _lift_kernel(
    contact_gradient: wp.array2d(dtype=wp.vec3d),
    corners: wp.array(dtype=wp.int32),
    starts: wp.array(dtype=wp.int32),
    middles: wp.array(dtype=wp.int32),
    shares: wp.array2d(dtype=wp.float64),
    # In and out
    positions: wp.array2d(dtype=wp.vec3d),
):
    env, i = wp.tid()
    total = wp.vec3d()
    load = wp.vec3d()
    for k in range(starts[i], starts[i + 1]):
        gradient = contact_gradient[env, middles[k]]
        if wp.length_sq(gradient) == wp.float64(0.0):
            return
        load -= gradient
        total += shares[env % shares.shape[0], k] * positions[env, middles[k]]
    if wp.dot(positions[env, corners[i]] - total, load) > wp.float64(0.0):
        positions[env, corners[i]] = total


class HangingCorners:
    """Corners of the contact face of one gel of a model; none where its elements are linear."""

    def __init__(self, model: Model, gel: int) -> None:
        body = model.scene.soft_bodies[gel]
        mesh = body.nodal_mesh
        rings = _rings(mesh) if isinstance(mesh, QuadraticMesh) else {}
        first = int(model.bodies[gel].nodes[0])
        middles = np.array([node for ring in rings.values() for node in ring], dtype=np.int32)
        starts = np.cumsum([0, *map(len, rings.values())])
        # Gels of environments may be graded for their own contacts.
        xy = body.nodal_rest_m[..., :2]
        shares = np.empty((len(xy), len(middles)))
        for size in {len(ring) for ring in rings.values()}:
            alike = [i for i, ring in enumerate(rings.values()) if len(ring) == size]
            where = starts[alike][:, None] + np.arange(size)
            corners = np.array(list(rings))[alike]
            shares[:, where] = _shares(xy[:, middles[where]] - xy[:, corners, None])

        def on_device(values: object, dtype: type) -> wp.array:
            return wp.array(np.asarray(values), dtype=dtype, device=model.device)

        self._count = len(rings)
        self._arrays = [
            on_device([first + corner for corner in rings], wp.int32),
            on_device(starts, wp.int32),
            on_device(first + middles, wp.int32),
            on_device(shares, wp.float64),
        ]

    def lift(self, positions: wp.array, contact_gradient: wp.array) -> None:
        """Move corners that hang, all others stay.

        Args:
            positions: Of all nodes [m], vec3d, [env_count, node_count]; in place.
            contact_gradient: Of the contact's energy [N], zero at nodes that do not touch, the
                same type and shape.
        """
        wp.launch(
            _lift_kernel,
            dim=(positions.shape[0], self._count),
            inputs=[contact_gradient, *self._arrays],
            outputs=[positions],
            device=positions.device,
        )


def _rings(mesh: QuadraticMesh) -> dict[int, list[int]]:
    """Middles of all edges of the contact faces around each corner that has enough of them."""
    rings: dict[int, set[int]] = {}
    for parts in mesh.region_faces(Region.CONTACT).reshape(-1, 12):
        a, ab, ca, _, b, bc, _, _, c, *_ = parts.tolist()
        for corner in (a, b, c):
            rings.setdefault(corner, set()).update((ab, bc, ca))
    return {
        corner: sorted(ring) for corner, ring in sorted(rings.items()) if len(ring) > PARABOLOID
    }


def _shares(offsets: np.ndarray) -> np.ndarray:
    """Weights of values at ``offsets`` [..., n, 2] in the least-squares paraboloid through them, at
    (0, 0), [..., n]."""
    x, y = np.moveaxis(offsets / np.abs(offsets).max(axis=(-2, -1), keepdims=True), -1, 0)
    design = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
    # Squared, as they are here, a ring on a conic has an eigenvalue of rounding.
    normal = np.linalg.pinv(np.swapaxes(design, -1, -2) @ design, rcond=1e-10, hermitian=True)
    return (design @ normal)[..., 0]
