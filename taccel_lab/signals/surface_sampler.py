# SPDX-License-Identifier: Apache-2.0
"""Slopes and height of the contact surface at every pixel, from and to device arrays.

The device-resident counterpart of ``SurfaceInterpolant``. A gel's surface moves by a few elements
at most, so each pixel walks from its triangle at rest to the one that covers it now, across the
edge that it lies beyond (a visibility walk: O. Devillers, S. Pion, M. Teillaud, "Walking in a
triangulation", IJFCS 13 (2002) 181-199). On a surface that is connected and has no folded triangle
a pixel lies in one triangle only, so the walk finds what the rasteriser would, and what lies
outside the rim shows nothing. What neither settles (folded surfaces, pixels on the rim) is
rasterised, decided on the device: the other environments skip that.

Not seen are surfaces that cover themselves without a folded triangle, by a rim that overlaps the
rest of the face; a pad that is bonded at its back cannot do that.
"""

# Warp compiles the kernels from their source; its type stubs describe neither vectors' operators
# nor FP64 overloads.
# pyright: reportArgumentType=false, reportAssignmentType=false, reportCallIssue=false
# pyright: reportGeneralTypeIssues=false, reportIndexIssue=false, reportOperatorIssue=false

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from taccel_lab.geometry import PixelGrid, QuadraticMesh, TetMesh
from taccel_lab.signals.contact_surface import ContactSurface
from taccel_lab.signals.face_patches import (
    RECORD,
    build_patches_kernel,
    evaluate_patch,
    load4,
    lowest_corner,
    patch_barycentric,
)
from taccel_lab.signals.gradient_recovery import FEW_SWEEPS, NetworkScratch, recover_gradients
from taccel_lab.signals.height_map import SurfaceMode
from taccel_lab.signals.markers import in_gel_frame
from taccel_lab.signals.raster import (
    FaceRaster,
    GridMap,
    grid_map,
    pixel_of,
    rasterize,
    smallest_area2,
)

wp.set_module_options({"enable_backward": False})

# A walk this long is going in circles.
_MOST_STEPS = wp.constant(100)
# Barycentric coordinates this little below zero count as inside; larger than FP32's rounding.
_SLACK = wp.constant(1e-5)
# Pixels this near to the rim [px] are left to the rasteriser.
_NEAR_RIM = wp.constant(wp.float64(1e-3))
# Threads that settle the pixels of an environment, if they have to.
_SETTLERS = 4096


@wp.kernel
def _gather_surface_kernel(
    positions: wp.array2d(dtype=wp.vec3d),
    frames: wp.array(dtype=wp.transformd),
    node_idx: wp.array(dtype=wp.int32),
    # Out
    surface: wp.array2d(dtype=wp.vec3d),
    height: wp.array2d(dtype=wp.float64),
):
    env, node = wp.tid()
    point = in_gel_frame(frames, env, positions[env, node_idx[node]])
    surface[env, node] = point
    height[env, node] = point[2]


@wp.func
def _clearly_outside(
    positions: wp.array2d(dtype=wp.vec3d),
    rim: wp.array2d(dtype=wp.int32),
    grid: GridMap,
    env: int,
    u: int,
    v: int,
) -> bool:
    """True for a pixel outside the rim's polygons and not near them; by crossings of a ray."""
    here = wp.vec2d(wp.float64(u), wp.float64(v))
    outside = bool(True)
    for edge in range(rim.shape[0]):
        a = pixel_of(grid, positions[env, rim[edge, 0]]) - here
        b = pixel_of(grid, positions[env, rim[edge, 1]]) - here
        along = b - a
        t = wp.clamp(-wp.dot(a, along) / wp.dot(along, along), wp.float64(0.0), wp.float64(1.0))
        if not (wp.length(a + t * along) > _NEAR_RIM):
            return False
        if (a[1] > wp.float64(0.0)) != (b[1] > wp.float64(0.0)):
            if a[0] - a[1] * along[0] / along[1] > wp.float64(0.0):
                outside = not outside
    return outside


@wp.kernel
def _sample_kernel(
    positions: wp.array2d(dtype=wp.vec3d),
    patches: wp.array(dtype=wp.vec4f),
    across: wp.array2d(dtype=wp.int32),
    rim: wp.array2d(dtype=wp.int32),
    start_face: wp.array2d(dtype=wp.int32),
    folded: wp.array(dtype=wp.int32),
    grid: GridMap,
    px_per_m: wp.vec2f,
    # Out
    samples: wp.array3d(dtype=wp.vec3f),
    unsettled: wp.array(dtype=wp.int32),
):
    env, v, u = wp.tid()
    face = start_face[v, u]
    if folded[env] != 0:
        face = -1
    sample = wp.vec3f(wp.nan, wp.nan, wp.nan)
    steps = wp.int32(0)
    settled = wp.int32(0)
    while face >= 0 and steps < _MOST_STEPS:
        first = (env * across.shape[0] + face) * RECORD
        place = load4(patches, first)
        rest = load4(patches, first + 1)
        bary = patch_barycentric(place, rest, u, v)
        if wp.min(wp.min(bary[0], bary[1]), bary[2]) >= -_SLACK:
            sample = evaluate_patch(patches, first, place, rest, bary, px_per_m)
            settled = 1
            face = -1
        else:
            face = across[face, lowest_corner(bary)]
        steps += 1
    samples[env, v, u] = sample
    if settled == 0:
        # Without a rim, as for surfaces of several pieces, everything is rasterised.
        if folded[env] != 0 or rim.shape[0] == 0:
            unsettled[env] = 1
        elif not _clearly_outside(positions, rim, grid, env, u, v):
            unsettled[env] = 1


@wp.kernel
def _prepare_raster_kernel(
    samples: wp.array3d(dtype=wp.vec3f),
    unsettled: wp.array(dtype=wp.int32),
    # Out
    lowest_z: wp.array3d(dtype=wp.float64),
    face_at_pixel: wp.array3d(dtype=wp.int32),
):
    env, lane = wp.tid()
    if unsettled[env] == 0:
        return
    width = samples.shape[2]
    for pixel in range(lane, samples.shape[1] * width, _SETTLERS):
        v = pixel // width
        u = pixel % width
        face_at_pixel[env, v, u] = -1
        # A settled pixel is lower than anything that the rasteriser may find there.
        lowest_z[env, v, u] = wp.where(
            wp.isnan(samples[env, v, u][2]), wp.float64(wp.inf), -wp.float64(wp.inf)
        )


@wp.kernel
def _settle_kernel(
    patches: wp.array(dtype=wp.vec4f),
    face_count: int,
    face_at_pixel: wp.array3d(dtype=wp.int32),
    unsettled: wp.array(dtype=wp.int32),
    px_per_m: wp.vec2f,
    # Out
    samples: wp.array3d(dtype=wp.vec3f),
):
    env, lane = wp.tid()
    if unsettled[env] == 0:
        return
    width = samples.shape[2]
    for pixel in range(lane, samples.shape[1] * width, _SETTLERS):
        v = pixel // width
        u = pixel % width
        face = face_at_pixel[env, v, u]
        if face >= 0:
            first = (env * face_count + face) * RECORD
            place = load4(patches, first)
            rest = load4(patches, first + 1)
            bary = patch_barycentric(place, rest, u, v)
            samples[env, v, u] = evaluate_patch(patches, first, place, rest, bary, px_per_m)


class SurfaceSampler:
    """Samples (slope along x, slope along y, height [m]) of up to ``env_count`` environments."""

    def __init__(
        self,
        mesh: TetMesh | QuadraticMesh,
        grid: PixelGrid,
        *,
        env_count: int,
        first_node: int = 0,
        mode: SurfaceMode = SurfaceMode.SMOOTH,
        device: Any = "cpu",
    ) -> None:
        """
        Args:
            mesh: Gel pad at rest; its faces of region CONTACT are shown.
            grid: Pixels of the image.
            env_count: Most environments of one call.
            first_node: Of this gel in the arrays of positions.
            mode: How the surface between the nodes is rebuilt.
            device: Warp device.
        """
        self.surface = surface = ContactSurface.from_mesh(mesh)
        self.grid = grid
        self.device = device
        self._map = grid_map(grid)
        self._px_per_m = wp.vec2f(1e3 / grid.mm_per_px_x, 1e3 / grid.mm_per_px_y)
        node_count = surface.node_count
        self._node_idx = wp.array(surface.node_idx + first_node, dtype=wp.int32, device=device)
        self._ring_start = wp.array(surface.ring_start, dtype=wp.int32, device=device)
        self._ring_nodes = wp.array(surface.ring_nodes, dtype=wp.int32, device=device)
        self._points = wp.empty((env_count, node_count), dtype=wp.vec3d, device=device)
        self._height = wp.empty((env_count, node_count), dtype=wp.float64, device=device)
        self._network: NetworkScratch | None = None
        if mode is SurfaceMode.SMOOTH:
            self._network = NetworkScratch.empty(
                env_count, node_count, len(surface.ring_nodes), device
            )
        self._flat = wp.empty((0, 0), dtype=wp.vec2d, device=device)
        rest = mesh.nodes_m[surface.node_idx]
        raster = FaceRaster(surface.faces, grid, device=device)
        raster.update(wp.array(rest[None], dtype=wp.vec3d, device=device))
        self._faces = raster.faces
        across, one_piece = faces_across(surface.faces)
        self._across = wp.array(across, dtype=wp.int32, device=device)
        face, corner = np.nonzero(across < 0)
        rim = np.stack([surface.faces[face, (corner + k) % 3] for k in (1, 2)], axis=-1)
        self._rim = wp.array(rim if one_piece else rim[:0], dtype=wp.int32, device=device)
        self._start_face = raster.face_at_pixel[0]
        if not one_piece:
            # Pieces may lie one above the other, which no walk can tell.
            self._start_face.fill_(-1)
        shape = (env_count, grid.height_px, grid.width_px)
        record_count = env_count * len(surface.faces) * RECORD
        self._patches = wp.empty(record_count, dtype=wp.vec4f, device=device)
        self._flags = wp.empty((2, env_count), dtype=wp.int32, device=device)
        self._face_at_pixel = wp.empty(shape, dtype=wp.int32, device=device)
        self._lowest_z = wp.empty(shape, dtype=wp.float64, device=device)
        self._samples = wp.empty(shape, dtype=wp.vec3f, device=device)
        at_rest = np.zeros((1, first_node + mesh.node_count, 3))
        at_rest[0, first_node:] = mesh.nodes_m
        no_frames = wp.empty(0, dtype=wp.transformd, device=device)
        samples = self.sample(wp.array(at_rest, dtype=wp.vec3d, device=device), no_frames)
        self.rest_samples = wp.clone(samples[0])
        """Samples of the undeformed gel, vec3f, shape [height_px, width_px]."""

    @property
    def unsettled(self) -> np.ndarray:
        """Environments that the latest call had to rasterise, bool; waits for the device."""
        return self._flags[1].numpy() != 0

    def sample(self, positions: wp.array, frames: wp.array) -> wp.array:
        """Sample the surface.

        Args:
            positions: Node positions [m], vec3d, shape [env, node].
            frames: world_from_gel, transformd, shape [env]; of length 0 when positions are in the
                gel frame.

        Returns:
            vec3f, shape [env, height_px, width_px], NaN beside the pad; valid until the next call.
        """
        count = positions.shape[0]
        points, height = self._points[:count], self._height[:count]
        self._launch(
            _gather_surface_kernel,
            points.shape,
            [positions, frames, self._node_idx],
            [points, height],
        )
        gradients = self._flat
        if self._network is not None:
            gradients = recover_gradients(
                points, height, self._ring_start, self._ring_nodes, self._network, FEW_SWEEPS
            )
        self._flags.zero_()
        folded, unsettled = self._flags[0][:count], self._flags[1][:count]
        self._launch(
            build_patches_kernel,
            (count, len(self._faces)),
            [points, height, gradients, self._faces, self._map, smallest_area2(self.grid)],
            [self._patches, folded],
        )
        samples = self._samples[:count]
        self._launch(
            _sample_kernel,
            samples.shape,
            [
                points,
                self._patches,
                self._across,
                self._rim,
                self._start_face,
                folded,
                self._map,
                self._px_per_m,
            ],
            [samples, unsettled],
        )
        self._settle(points, samples, unsettled)
        return samples

    def _settle(self, points: wp.array, samples: wp.array, unsettled: wp.array) -> None:
        """Rasterise the pixels that the walk left open, in the environments that have some."""
        count = len(samples)
        lowest_z, face_at_pixel = self._lowest_z[:count], self._face_at_pixel[:count]
        dim = (count, _SETTLERS)
        outputs = [lowest_z, face_at_pixel]
        self._launch(_prepare_raster_kernel, dim, [samples, unsettled], outputs)
        rasterize(points, self._faces, self.grid, unsettled, lowest_z, face_at_pixel)
        self._launch(
            _settle_kernel,
            dim,
            [self._patches, len(self._faces), face_at_pixel, unsettled, self._px_per_m],
            [samples],
        )

    def _launch(self, kernel: Any, dim: Any, inputs: list[Any], outputs: list[Any]) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self.device)


def faces_across(faces: np.ndarray) -> tuple[np.ndarray, bool]:
    """Neighbours of faces across their edges.

    Args:
        faces: Triangles, shape [face, 3].

    Returns:
        Neighbour across the edge opposite to each corner, -1 on the rim, int32, [face, 3]; and
        whether the faces are one piece in which at most two faces share an edge.
    """
    from scipy import sparse

    count = len(faces)
    edges = np.sort(np.stack([faces[:, [1, 2]], faces[:, [2, 0]], faces[:, [0, 1]]], axis=1), -1)
    _, edge_id, uses = np.unique(
        edges.reshape(-1, 2), axis=0, return_inverse=True, return_counts=True
    )
    order = np.argsort(edge_id.ravel(), kind="stable")
    ends = np.cumsum(uses)[uses == 2]
    first, second = order[ends - 2], order[ends - 1]
    across = np.full(3 * count, -1, dtype=np.int32)
    across[first], across[second] = second // 3, first // 3
    graph = sparse.coo_array((np.ones(len(first)), (first // 3, second // 3)), shape=(count, count))
    pieces = sparse.csgraph.connected_components(graph, directed=False, return_labels=False)
    return across.reshape(-1, 3), bool(pieces == 1 and uses.max() <= 2)
