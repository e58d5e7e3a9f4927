# SPDX-License-Identifier: Apache-2.0
"""Which media lie between camera and gel, read from an optical design and its gel.

The gel's glued back is a plane or, behind a dome window, a sphere; the window fills the space
behind it. A camera inside one of them sees only the interfaces in front of it.
"""

from __future__ import annotations

import numpy as np

from taccel_lab.camera.refraction import DomeMedia, FlatMedia, Media
from taccel_lab.errors import InputError
from taccel_lab.geometry import QuadraticMesh, Region, TetMesh
from taccel_lab.profile.optical_design import OpticalDesign

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
