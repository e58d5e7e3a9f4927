# SPDX-License-Identifier: Apache-2.0
"""The contact surface at the pixels in numpy and FP64: the referee of ``SurfaceSampler``.

The reduced Clough-Tocher element written a second time, from its definition: control points from
the corners' values and gradients, the derivative across each outer edge linear along it, and de
Casteljau's algorithm. Which face a pixel meets and the gradients at the nodes are the product's,
which have tests of their own.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, QuadraticMesh, TetMesh
from taccel_lab.signals import ContactFaceMesh, normals_from_slopes
from taccel_lab.signals.gradient_recovery import recover_gradients
from taccel_lab.signals.raster import FaceRaster


class HeightMapReferee:
    """Height and normals of the gel's contact surface, NaN outside the pad, in numpy."""

    def __init__(self, mesh: TetMesh | QuadraticMesh, grid: PixelGrid) -> None:
        self.surface, self.grid = ContactFaceMesh.from_mesh(mesh), grid

    def update(self, positions: Any) -> None:
        """Read node positions [m], shape [env, node, 3], numpy or Warp."""
        nodes = positions.numpy() if hasattr(positions, "numpy") else np.asarray(positions)
        nodes = nodes.reshape(-1, *nodes.shape[-2:])
        points = np.ascontiguousarray(nodes[:, self.surface.node_idx], dtype=np.float64)
        on_device = wp.array(points, dtype=wp.vec3d, device="cpu")
        raster = FaceRaster(self.surface.faces, self.grid)
        raster.update(on_device)
        height = np.ascontiguousarray(points[..., 2])
        gradients = recover_gradients(
            on_device,
            wp.array(height, dtype=wp.float64, device="cpu"),
            wp.array(self.surface.ring_start, dtype=wp.int32, device="cpu"),
            wp.array(self.surface.ring_nodes, dtype=wp.int32, device="cpu"),
        ).numpy()
        pixels = raster.face_at_pixel.numpy()
        covered = (pixels >= 0).any(axis=(1, 2))
        if not covered.all():
            raise InputError(f"no face covers a pixel in {np.flatnonzero(~covered)}: it is folded")
        found = [self._on_pixels(*each) for each in zip(points, gradients, pixels, strict=True)]
        self.height_m = np.stack([height for height, _ in found])
        """Height [m], shape [env, height_px, width_px]."""
        self.slope = np.stack([slope for _, slope in found])
        """dh/dx and dh/dy, shape [env, height_px, width_px, 2]."""
        self.normals = normals_from_slopes(self.slope)
        """Outward unit normals, shape [env, height_px, width_px, 3]."""

    def _on_pixels(
        self, points: np.ndarray, gradients: np.ndarray, face_at_pixel: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        height = np.full(face_at_pixel.shape, np.nan)
        slope = np.full((*face_at_pixel.shape, 2), np.nan)
        row, column = np.nonzero(face_at_pixel >= 0)
        corners = self.surface.faces[face_at_pixel[row, column]]
        here = np.stack([self.grid.x_mm()[column], self.grid.y_mm()[row]], axis=-1) * 1e-3
        xy, z = points[corners, :2], points[corners, 2]
        turns = np.stack([xy[:, 1] - xy[:, 0], xy[:, 2] - xy[:, 0]], axis=-1)
        inverse = np.linalg.inv(turns)
        first = np.einsum("nij,nj->ni", inverse, here - xy[:, 0])
        barycentric = np.concatenate([1 - first.sum(axis=1, keepdims=True), first], axis=1)
        rates = np.concatenate([-inverse.sum(axis=1, keepdims=True), inverse], axis=1)
        value, derivative = _clough_tocher(xy, z, gradients[corners], barycentric)
        height[row, column] = value
        slope[row, column] = np.einsum("nc,ncx->nx", derivative, rates)
        return height, slope


def _clough_tocher(
    xy: np.ndarray, f: np.ndarray, g: np.ndarray, barycentric: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Value and derivatives to the three barycentric coordinates, from the sub-triangle opposite
    to the corner with the least of them; arguments have n rows."""
    # The corners in the order P, Q (of the sub-triangle) and the corner opposite to it.
    low = barycentric.argmin(axis=1)
    order = (low[:, None] + [1, 2, 3]) % 3
    xy, g = (np.take_along_axis(a, order[..., None], axis=1) for a in (xy, g))
    f, b = (np.take_along_axis(a, order, axis=1) for a in (f, barycentric))

    def towards(i: int, j: int) -> np.ndarray:
        return f[:, i] + np.einsum("nx,nx->n", g[:, i], xy[:, j] - xy[:, i]) / 3

    around = [(f[:, i] + sum(towards(i, j) for j in range(3) if j != i)) / 3 for i in range(3)]

    def inner(i: int, j: int) -> np.ndarray:
        edge, to_centre = xy[:, j] - xy[:, i], xy.mean(axis=1) - xy[:, i]
        t = np.einsum("nx,nx->n", to_centre, edge) / np.einsum("nx,nx->n", edge, edge)
        # Across the edge the direction is (t - 1, -t, 1) in the sub-triangle's coordinates.
        ends = [
            (t - 1) * a - t * c + e
            for a, c, e in (
                (f[:, i], towards(i, j), around[i]),
                (towards(j, i), f[:, j], around[j]),
            )
        ]
        return sum(ends) / 2 - (t - 1) * towards(i, j) + t * towards(j, i)

    middle = {frozenset(e): inner(*e) for e in ((0, 1), (1, 2), (2, 0))}
    spokes = [
        (around[i] + sum(middle[frozenset((i, j))] for j in range(3) if j != i)) / 3
        for i in range(3)
    ]
    cubic = {
        (3, 0, 0): f[:, 0],
        (2, 1, 0): towards(0, 1),
        (1, 2, 0): towards(1, 0),
        (0, 3, 0): f[:, 1],
        (2, 0, 1): around[0],
        (1, 1, 1): middle[frozenset((0, 1))],
        (0, 2, 1): around[1],
        (1, 0, 2): spokes[0],
        (0, 1, 2): spokes[1],
        (0, 0, 3): sum(spokes) / 3,
    }
    p, q, r = b[:, 0] - b[:, 2], b[:, 1] - b[:, 2], 3 * b[:, 2]
    steps = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
    level = cubic
    while len(level) > 3:
        degree = sum(next(iter(level))) - 1
        level = {
            (i, j, degree - i - j): sum(
                weight * level[i + a, j + c, degree - i - j + d]
                for weight, (a, c, d) in zip((p, q, r), steps, strict=True)
            )
            for i in range(degree + 1)
            for j in range(degree + 1 - i)
        }
    rates = [3 * level[step] for step in steps]
    value = (p * rates[0] + q * rates[1] + r * rates[2]) / 3
    # p = b_P - b_low, q = b_Q - b_low, r = 3 b_low.
    by_order = np.stack([rates[0], rates[1], 3 * rates[2] - rates[0] - rates[1]], axis=-1)
    derivative = np.empty_like(by_order)
    np.put_along_axis(derivative, order, by_order, axis=1)
    return value, derivative
