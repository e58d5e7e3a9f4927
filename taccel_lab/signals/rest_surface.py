# SPDX-License-Identifier: Apache-2.0
"""The undeformed contact face on a pixel grid, from the mesh of a profile, without a simulation.

The same surface as of a pressed gel (``SurfaceSampler``). A flat face gives zero exactly. Pixels
beside the pad take the height and slope of the nearest pixel over it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid, Region, TetMesh
from taccel_lab.signals.normals import normals_from_slopes
from taccel_lab.signals.surface_sampler import SurfaceSampler

FLAT_M = 1e-9
"""A face whose heights differ by less is flat."""


@dataclass(frozen=True)
class RestSurface:
    """Undeformed contact face, gel frame."""

    height_m: np.ndarray
    """z [m], shape [height_px, width_px]."""
    normals: np.ndarray
    """Outward unit normals, shape [height_px, width_px, 3]."""
    covered: np.ndarray
    """Pixels that lie over the pad, bool, shape [height_px, width_px]."""

    @cached_property
    def samples(self) -> np.ndarray:
        """Slopes along x and y and height [m], [height_px, width_px, 3]; not to be changed."""
        slope = -self.normals[..., :2] / self.normals[..., 2:]
        return np.concatenate([slope, self.height_m[..., None]], axis=-1)

    @property
    def is_flat(self) -> bool:
        return bool((self.normals[..., 2] == 1.0).all())

    def left_out_by(self, meshed: np.ndarray) -> np.ndarray:
        """What the mesh of a press leaves out of this face: to be added to what it shows.

        A mesh that is fine around a contact draws far parts of a curved pad with long chords. Its
        displacements are right all the same, so the deformed surface is the designed one plus the
        difference between the mesh deformed and the mesh at rest, at the same pixel: to first
        order, since chords and displacements are nowhere large together.

        Args:
            meshed: Samples of the mesh at rest, as ``samples``; NaN where it has no face.

        Returns:
            Samples, NaN where only the mesh has no face, 0 beside this one.
        """
        samples = self.samples
        known = self.covered & np.isfinite(samples).all(axis=-1)
        return np.where(known[..., None], samples - meshed, 0.0)


def flat_rest(grid: PixelGrid) -> RestSurface:
    """A flat face at z = 0 under every pixel."""
    shape = (grid.height_px, grid.width_px)
    normals = np.zeros((*shape, 3))
    normals[..., 2] = 1.0
    return RestSurface(np.zeros(shape), normals, np.ones(shape, dtype=bool))


def rest_surface(mesh: TetMesh, grid: PixelGrid) -> RestSurface:
    """The contact face of ``mesh`` [m] under the pixels of ``grid``.

    Raises InputError when the mesh has no contact face, or none under the image.
    """
    nodes = mesh.region_nodes(Region.CONTACT)
    if len(nodes) == 0:
        raise InputError("the profile's mesh has no contact face (face region 1)")
    if np.ptp(mesh.nodes_m[nodes, 2]) < FLAT_M:
        return flat_rest(grid)
    samples = SurfaceSampler(mesh, grid, env_count=1).rest_samples.numpy().astype(np.float64)
    covered = np.isfinite(samples).all(axis=-1)
    if not covered.any():
        raise InputError("no pixel of the image lies over the profile's contact face")
    (samples,) = from_nearest(covered, samples)
    return RestSurface(samples[..., 2], normals_from_slopes(samples[..., :2]), covered)


def from_nearest(covered: np.ndarray, *maps: np.ndarray) -> tuple[np.ndarray, ...]:
    """``maps`` [height_px, width_px, ...] with pixels that are not ``covered`` [height_px,
    width_px] as the nearest that is."""
    if covered.all():
        return maps
    from scipy.ndimage import distance_transform_edt

    nearest: Any = distance_transform_edt(~covered, return_distances=False, return_indices=True)
    return tuple(values[tuple(nearest)] for values in maps)
