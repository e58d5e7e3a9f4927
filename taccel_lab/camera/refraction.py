# SPDX-License-Identifier: Apache-2.0
"""Refraction of sight lines on their way from the camera into the gel: air, window, gel.

Flat media are planes of constant z, domes are concentric spheres; both bend rays by Snell's law in
vector form (A. S. Glassner, "An Introduction to Ray Tracing", 1989, section 2.4). Backwards, from a
gel point to the direction in which the camera sees it, flat media have one unknown per point, the
conserved p = n sin(theta), and a dome two, which Newton's method finds by shooting.

Which media there are is read from an optical design and its gel. The gel's glued back is a plane
or, behind a dome window, a sphere; the window fills the space behind it. A camera inside one of
them sees only the interfaces in front of it.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import QuadraticMesh, Region, TetMesh
from taccel_lab.profile.optical_design import OpticalDesign

_NEWTON_STEPS = 60


def refract(
    directions: np.ndarray, normals: np.ndarray, n_from: float, n_to: float
) -> tuple[np.ndarray, np.ndarray]:
    """Snell's law in vector form with Fresnel's transmittance.

    Args:
        directions: Unit rays, shape [..., 3].
        normals: Unit normals of the interface, either way round, shape [..., 3].
        n_from: Index that the rays come from.
        n_to: Index that they go into.

    Returns:
        Unit directions beyond the interface, NaN on total reflection, and the unpolarised
        transmittance, 0 there.
    """
    cos_in = np.sum(directions * normals, axis=-1)
    normals = np.where((cos_in < 0)[..., None], -normals, normals)
    cos_in = np.abs(cos_in)
    ratio = n_from / n_to
    with np.errstate(invalid="ignore"):
        sin2 = ratio * ratio * (1 - cos_in * cos_in)
        cos_out = np.sqrt(np.where(sin2 <= 1, 1 - sin2, np.nan))
        bent = ratio * directions + (cos_out - ratio * cos_in)[..., None] * normals
        across = (n_from * cos_in - n_to * cos_out) / (n_from * cos_in + n_to * cos_out)
        along = (n_to * cos_in - n_from * cos_out) / (n_to * cos_in + n_from * cos_out)
    transmitted = np.nan_to_num(1 - 0.5 * (across**2 + along**2), nan=0.0)
    return bent, transmitted


@dataclass(frozen=True)
class FlatMedia:
    """Layers of constant z between a camera at lower z and the gel; no planes for none."""

    planes_mm: tuple[float, ...]
    """z of the interfaces, ascending."""
    indices: tuple[float, ...]
    """Refractive indices from the camera's medium to the gel, one more than planes."""

    def __post_init__(self) -> None:
        if len(self.indices) != len(self.planes_mm) + 1:
            raise InputError(
                f"{len(self.planes_mm)} interfaces separate {len(self.planes_mm) + 1} media, got "
                f"{len(self.indices)} refractive indices"
            )
        if list(self.planes_mm) != sorted(self.planes_mm):
            raise InputError(f"interfaces must ascend in z, got {self.planes_mm}")

    def trace(
        self, origin_mm: np.ndarray, directions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rays from ``origin_mm`` [3] or [..., 3] along unit ``directions`` [..., 3], in the gel.

        Returns:
            Where each ray enters the gel [mm] and its unit direction there, both [..., 3] and NaN
            for a ray that never gets there, and the share of light that the interfaces let through
            (Fresnel, unpolarised), [...].
        """
        direction = np.array(directions, dtype=np.float64)
        point = np.broadcast_to(np.asarray(origin_mm, dtype=np.float64), direction.shape).copy()
        share = np.ones(direction.shape[:-1])
        up = np.array([0.0, 0.0, 1.0])
        for plane, n_from, n_to in zip(
            self.planes_mm, self.indices[:-1], self.indices[1:], strict=True
        ):
            rise = np.where(direction[..., 2] > 0, direction[..., 2], np.nan)
            point = point + direction * ((plane - point[..., 2]) / rise)[..., None]
            direction, passed = refract(direction, np.broadcast_to(up, point.shape), n_from, n_to)
            share = share * passed
        return point, direction, np.where(np.isnan(direction[..., 0]), 0.0, share)

    def sight(self, origin_mm: np.ndarray, points_mm: np.ndarray) -> np.ndarray:
        """Unit direction at ``origin_mm`` [3] in which gel points [..., 3] are seen."""
        offset = np.asarray(points_mm, dtype=np.float64) - origin_mm
        across = np.linalg.norm(offset[..., :2], axis=-1)
        edges = [float(np.asarray(origin_mm)[2]), *self.planes_mm]
        heights = [np.full_like(across, b - a) for a, b in itertools.pairwise(edges)]
        heights.append(np.asarray(points_mm, dtype=np.float64)[..., 2] - edges[-1])
        p = snell_invariant(across, heights, list(self.indices))
        sine = p / self.indices[0]
        with np.errstate(divide="ignore", invalid="ignore"):
            flat = np.where((across > 0)[..., None], offset[..., :2] / across[..., None], 0.0)
        return np.concatenate([flat * sine[..., None], np.sqrt(1 - sine**2)[..., None]], axis=-1)


def snell_invariant(
    across_mm: np.ndarray, heights_mm: list[np.ndarray], indices: list[float]
) -> np.ndarray:
    """p = n sin(theta) of the ray that crosses flat layers with a given horizontal offset.

    Solves ``sum_i h_i p / sqrt(n_i^2 - p^2) = r`` for the tangent t in the layer of least index
    among those that the ray crosses. The sum is concave and rises with t, so Newton's method
    climbs to the root from the straight line's t, which lies below it.

    Args:
        across_mm: Horizontal offset r, shape [...].
        heights_mm: Height of each layer, each of shape [...]; 0 for a layer that is not crossed.
        indices: Refractive index of each layer.
    """
    layers = list(zip(heights_mm, indices, strict=True))
    least = np.min([np.where(h > 0, n, np.inf) for h, n in layers], axis=0)
    total = np.sum(heights_mm, axis=0)
    if np.any(total <= 0):
        raise InputError("the camera must lie below the gel points that it is to see")
    tangent = across_mm / total
    for _ in range(_NEWTON_STEPS):
        secant = np.sqrt(1 + tangent**2)
        p = least * tangent / secant
        reach, slope = np.zeros_like(p), np.zeros_like(p)
        for height, n in layers:
            root2 = np.where(height > 0, n * n - p * p, 1.0)
            reach += height * p / np.sqrt(root2)
            slope += height * n * n / root2**1.5 * (least / secant**3)
        step = (across_mm - reach) / slope
        tangent = tangent + step
        if np.max(np.abs(step) / (1 + np.abs(tangent)), initial=0.0) < 1e-15:
            break
    else:
        worst = float(np.max(np.abs(across_mm - reach), initial=0.0))
        if worst > 1e-9 * float(np.max(total)):
            raise InputError(f"Snell's equation left {worst:g} mm after {_NEWTON_STEPS} steps")
    return least * tangent / np.sqrt(1 + tangent**2)


@dataclass(frozen=True)
class DomeMedia:
    """Concentric spheres around the camera: what is inside the window, the window, the gel."""

    centre_mm: tuple[float, float, float]
    radii_mm: tuple[float, ...]
    """Radii of the interfaces, ascending; the camera lies inside the first."""
    indices: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.indices) != len(self.radii_mm) + 1:
            raise InputError(
                f"{len(self.radii_mm)} interfaces separate {len(self.radii_mm) + 1} media, got "
                f"{len(self.indices)} refractive indices"
            )
        if list(self.radii_mm) != sorted(self.radii_mm) or min(self.radii_mm, default=1.0) <= 0:
            raise InputError(f"radii must be positive and ascend, got {self.radii_mm}")

    def trace(
        self, origin_mm: np.ndarray, directions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rays in the gel; as ``FlatMedia.trace``."""
        direction = np.array(directions, dtype=np.float64)
        centre = np.array(self.centre_mm)
        point = np.broadcast_to(np.asarray(origin_mm, dtype=np.float64), direction.shape) - centre
        share = np.ones(direction.shape[:-1])
        for radius, n_from, n_to in zip(
            self.radii_mm, self.indices[:-1], self.indices[1:], strict=True
        ):
            along = np.sum(point * direction, axis=-1)
            root2 = along**2 - np.sum(point * point, axis=-1) + radius**2
            reach = -along + np.sqrt(np.where(root2 > 0, root2, np.nan))
            point = point + direction * reach[..., None]
            direction, passed = refract(direction, point / radius, n_from, n_to)
            share = share * passed
        return point + centre, direction, np.where(np.isnan(direction[..., 0]), 0.0, share)

    def sight(self, origin_mm: np.ndarray, points_mm: np.ndarray) -> np.ndarray:
        """Unit direction at ``origin_mm`` [3] in which gel points [..., 3] are seen.

        The miss of a ray is where it passes its point, in the plane across the ray at the point.
        """
        points = np.asarray(points_mm, dtype=np.float64)
        direct = points - origin_mm
        distance = np.linalg.norm(direct, axis=-1, keepdims=True)
        direct = direct / distance
        helper = np.where(np.abs(direct[..., :1]) < 0.7, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
        first = np.cross(direct, helper)
        first /= np.linalg.norm(first, axis=-1, keepdims=True)
        second = np.cross(direct, first)

        def shoot(slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            aim = direct + slopes[..., :1] * first + slopes[..., 1:] * second
            aim = aim / np.linalg.norm(aim, axis=-1, keepdims=True)
            entry, direction, _ = self.trace(np.asarray(origin_mm), aim)
            along = np.sum((points - entry) * direction, axis=-1, keepdims=True)
            away = entry + along * direction - points
            return aim, np.stack([np.sum(away * first, -1), np.sum(away * second, -1)], -1)

        slopes, step = np.zeros((*points.shape[:-1], 2)), 1e-6
        for _ in range(_NEWTON_STEPS):
            aim, miss = shoot(slopes)
            if np.nanmax(np.abs(miss), initial=0.0) < 1e-11:
                break
            a = (shoot(slopes + [step, 0.0])[1] - miss) / step
            b = (shoot(slopes + [0.0, step])[1] - miss) / step
            det = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
            slopes = slopes - np.stack(
                [
                    (b[..., 1] * miss[..., 0] - b[..., 0] * miss[..., 1]) / det,
                    (a[..., 0] * miss[..., 1] - a[..., 1] * miss[..., 0]) / det,
                ],
                axis=-1,
            )
        aim, miss = shoot(slopes)
        return np.where(np.all(np.abs(miss) < 1e-7, axis=-1, keepdims=True), aim, np.nan)


Media = FlatMedia | DomeMedia
"""What lies between the camera and the gel."""


OUTSIDE_INDEX = 1.0
"""Air between the camera and what stands in front of it."""
_FLAT_MM = 0.02
"""Greatest deviation of a glued back from its plane or sphere."""


def glued_back_mm(mesh: TetMesh | QuadraticMesh) -> np.ndarray:
    """Nodes [mm] of the back that the camera looks through: its window, else all that is glued.

    Of ten-node tets the corners alone: on a curved back their middle nodes lie on its chords.
    """
    mesh = mesh.base if isinstance(mesh, QuadraticMesh) else mesh
    nodes = mesh.region_nodes(Region.WINDOW)
    if len(nodes) == 0:
        nodes = mesh.region_nodes(Region.BOND)
    if len(nodes) == 0:
        raise InputError("the gel has no face of region WINDOW or BOND for the camera to look in")
    return mesh.nodes_m[nodes] * 1e3


def flat_back_z_mm(back_mm: np.ndarray) -> float | None:
    """z of a flat back, None when it is not flat."""
    z = back_mm[:, 2]
    return float(np.median(z)) if np.ptp(z) < _FLAT_MM else None


def media_between(design: OpticalDesign, back_mm: np.ndarray) -> Media:
    """Media from the camera to the gel.

    Args:
        design: Camera, window and indices.
        back_mm: Points on the gel's glued back [mm], shape [n, 3].

    Raises:
        InputError: The back is neither flat nor the sphere of a dome window.
    """
    window, n_gel = design.window, design.gel_refractive_index
    camera_mm = np.array(design.camera.position_mm)
    if window is not None and window.shape == "dome":
        centre = _sphere_centre_mm(back_mm, window.outer_radius_mm)
        outer = window.outer_radius_mm
        distance = float(np.linalg.norm(camera_mm - centre))
        surfaces = [
            (outer - window.thickness_mm, OUTSIDE_INDEX),
            (outer, window.refractive_index),
        ]
        ahead = [(radius, index) for radius, index in surfaces if radius > distance]
        return DomeMedia(
            tuple(centre.tolist()),
            tuple(radius for radius, _ in ahead),
            (*(index for _, index in ahead), n_gel),
        )
    back_z = flat_back_z_mm(back_mm)
    if back_z is None:
        if window is None:
            # A camera that is cast into the gel.
            return FlatMedia((), (n_gel,))
        raise InputError(
            f"the window is a plate but the gel's back spans {np.ptp(back_mm[:, 2]):.3g} mm in z; "
            "flat backs take a plate, spherical ones a dome"
        )
    planes = [(back_z, OUTSIDE_INDEX)]
    if window is not None:
        planes = [
            (back_z - window.thickness_mm, OUTSIDE_INDEX),
            (back_z, window.refractive_index),
        ]
    ahead = [(z, index) for z, index in planes if z > camera_mm[2]]
    return FlatMedia(tuple(z for z, _ in ahead), (*(index for _, index in ahead), n_gel))


def without_refraction(media: Media) -> Media:
    """The same interfaces with one index throughout: straight sight lines."""
    same = (1.0,) * len(media.indices)
    if isinstance(media, DomeMedia):
        return DomeMedia(media.centre_mm, media.radii_mm, same)
    return FlatMedia(media.planes_mm, same)


def _sphere_centre_mm(back_mm: np.ndarray, radius_mm: float) -> np.ndarray:
    """Centre on the z axis of the sphere that the cap of the glued back lies on.

    A dome's back may continue as a cylinder below its equator, so that only the part ahead of the
    centre is checked.
    """
    apex_z = float(back_mm[:, 2].max())
    centre = np.array([0.0, 0.0, apex_z - radius_mm])
    ahead = back_mm[back_mm[:, 2] > centre[2]]
    error = np.abs(np.linalg.norm(ahead - centre, axis=1) - radius_mm)
    worst = float(error.max())
    if worst > max(_FLAT_MM, 0.01 * radius_mm):
        raise InputError(
            f"the gel's back is up to {worst:.3g} mm off the dome window's sphere of "
            f"{radius_mm:g} mm radius with its top at z = {apex_z:.3g} mm"
        )
    return centre
