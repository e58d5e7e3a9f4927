# SPDX-License-Identifier: Apache-2.0
"""Which patch of the contact surface each pixel shows, found from the one it shows at rest.

A gel's surface moves by a few elements at most, so each pixel walks from its triangle at rest to
the one that covers it now, across the edge that it lies beyond (a visibility walk: O. Devillers,
S. Pion, M. Teillaud, "Walking in a triangulation", IJFCS 13 (2002) 181-199). On a surface that is
connected and has no folded triangle a pixel lies in one triangle only, so the walk finds what the
rasteriser would, and what lies outside the rim shows nothing. What neither settles (folded
surfaces, pixels on the rim, a walk that ends at a dent of the rim) is rasterised, decided on the
device: the other environments skip that.

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

from taccel_lab.geometry import PixelGrid
from taccel_lab.signals.face_patches import (
    RECORD,
    evaluate_patch,
    load4,
    lowest_corner,
    patch_barycentric,
)
from taccel_lab.signals.gradient_recovery import ContactFaceMesh
from taccel_lab.signals.raster import FaceRaster, GridMap, grid_map, pixel_of, rasterize

wp.set_module_options({"enable_backward": False})

# A walk this long is going in circles.
_MOST_STEPS = wp.constant(100)
# Barycentric coordinates this little below zero count as inside; larger than FP32's rounding.
_SLACK = wp.constant(1e-5)
# Pixels this near to the rim [px] are left to the rasteriser.
_NEAR_RIM = wp.constant(wp.float64(1e-3))
# Threads that settle the pixels of an environment, if they have to.
_SETTLERS = 4096


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
def _settle_walk_kernel(
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


class PixelWalk:
    """Samples of the patches at the pixels, for up to ``env_count`` environments."""

    def __init__(
        self,
        surface: ContactFaceMesh,
        rest_points: np.ndarray,
        grid: PixelGrid,
        *,
        env_count: int,
        device: Any = "cpu",
    ) -> None:
        """
        Args:
            surface: Contact faces.
            rest_points: Surface nodes at rest [m], shape [surface_node, 3].
            grid: Pixels of the image.
            env_count: Most environments of one call.
            device: Warp device.
        """
        self.grid = grid
        self.device = device
        self._map = grid_map(grid)
        self._px_per_m = wp.vec2f(1e3 / grid.mm_per_px_x, 1e3 / grid.mm_per_px_y)
        raster = FaceRaster(surface.faces, grid, device=device)
        raster.update(wp.array(rest_points[None], dtype=wp.vec3d, device=device))
        self.faces = raster.faces
        """Triangles in surface numbering, Warp int32 array, shape [face, 3]."""
        across, one_piece = faces_across(surface.faces)
        face, corner = np.nonzero(across < 0)
        rim = np.stack([surface.faces[face, (corner + k) % 3] for k in (1, 2)], axis=-1)
        start_face = nearest_face(raster.face_at_pixel.numpy()[0])
        if not one_piece:
            # Pieces may lie one above the other, which no walk can tell.
            start_face[:] = -1
            rim = rim[:0]
        self._across = wp.array(across, dtype=wp.int32, device=device)
        self._rim = wp.array(rim, dtype=wp.int32, device=device)
        self._start_face = wp.array(start_face, dtype=wp.int32, device=device)
        shape = (env_count, grid.height_px, grid.width_px)
        self._unsettled = wp.zeros(env_count, dtype=wp.int32, device=device)
        self._face_at_pixel = wp.empty(shape, dtype=wp.int32, device=device)
        self._lowest_z = wp.empty(shape, dtype=wp.float64, device=device)

    @property
    def unsettled(self) -> np.ndarray:
        """Environments that the latest call had to rasterise, bool; waits for the device."""
        return self._unsettled.numpy() != 0

    def sample(
        self, points: wp.array, patches: wp.array, folded: wp.array, samples: wp.array
    ) -> None:
        """Evaluate the patches.

        Args:
            points: Surface nodes [m], vec3d, shape [env, surface_node].
            patches: Records of their faces, see ``face_patches``.
            folded: Nonzero for environments with a folded face, int32, shape [env].
            samples: Set to slope along x, slope along y and height [m], NaN beside the pad; vec3f,
                shape [env, height_px, width_px].
        """
        count = len(samples)
        self._unsettled.zero_()
        unsettled = self._unsettled[:count]
        self._launch(
            _sample_kernel,
            samples.shape,
            [
                points,
                patches,
                self._across,
                self._rim,
                self._start_face,
                folded,
                self._map,
                self._px_per_m,
            ],
            [samples, unsettled],
        )
        lowest_z, face_at_pixel = self._lowest_z[:count], self._face_at_pixel[:count]
        dim = (count, _SETTLERS)
        outputs = [lowest_z, face_at_pixel]
        self._launch(_prepare_raster_kernel, dim, [samples, unsettled], outputs)
        rasterize(points, self.faces, self.grid, unsettled, lowest_z, face_at_pixel)
        self._launch(
            _settle_walk_kernel,
            dim,
            [patches, len(self.faces), face_at_pixel, unsettled, self._px_per_m],
            [samples],
        )

    def _launch(self, kernel: Any, dim: Any, inputs: list[Any], outputs: list[Any]) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, outputs=outputs, device=self.device)


def nearest_face(face_at_pixel: np.ndarray) -> np.ndarray:
    """Give pixels without a face (-1) that of the nearest pixel with one, if there is any."""
    from scipy import ndimage

    if not (face_at_pixel >= 0).any():
        return face_at_pixel
    row, column = ndimage.distance_transform_edt(
        face_at_pixel < 0, return_distances=False, return_indices=True
    )
    return face_at_pixel[row, column]


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
