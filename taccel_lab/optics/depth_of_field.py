# SPDX-License-Identifier: Apache-2.0
"""Depth of field of a thin lens for a blur of one pixel.

With the aperture A, focal length f in pixels and focus at s, a point at distance d blurs over ``f A
|1/d - 1/s|`` pixels (e.g. Hecht, "Optics", thin lens equation); the limits solve that for 1 px.
Distances are those in air: a layer of height h and index n counts as h / n.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.camera.refraction import FlatMedia

if TYPE_CHECKING:
    from taccel_lab.optics.render import LightField, OpticalModel


@dataclass(frozen=True)
class DepthOfField:
    """Where the image is sharp to one pixel."""

    near_mm: float
    """Nearest sharp distance from the camera along its axis, in air [mm]."""
    far_mm: float
    """Farthest; infinite beyond the hyperfocal distance."""
    depth_in_gel_mm: float
    """The range between them, stretched by the gel's index [mm]."""
    sharp_fraction: float
    """Part of the seen gel at rest within the range."""
    worst_blur_px: float
    """Largest diameter of the blur on the seen gel [px]."""


def sharp_range_mm(focal_px: float, aperture_mm: float, focus_mm: float) -> tuple[float, float]:
    """Nearest and farthest distance with a blur of at most one pixel [mm]."""
    margin = 1.0 / (focal_px * aperture_mm)
    inverse_far = 1.0 / focus_mm - margin
    near = 1.0 / (1.0 / focus_mm + margin)
    return near, (1.0 / inverse_far if inverse_far > 0 else math.inf)


def blur_px(
    distance_mm: np.ndarray, focal_px: float, aperture_mm: float, focus_mm: float
) -> np.ndarray:
    """Diameter of the blur of points at distances along the axis [px]."""
    return focal_px * aperture_mm * np.abs(1.0 / distance_mm - 1.0 / focus_mm)


def depth_of_field(model: OpticalModel, light: LightField) -> DepthOfField | None:
    """Depth of field over the seen gel; None when aperture or focus is unknown."""
    camera = model.camera.camera
    if camera.aperture_mm == 0 or camera.focus_mm == 0:
        return None
    focal = math.sqrt(camera.fx_px * camera.fy_px)
    near, far = sharp_range_mm(focal, camera.aperture_mm, camera.focus_mm)
    points = light.points_mm[light.mask].astype(np.float64)
    distance = _distance_in_air(model, points)
    return DepthOfField(
        near_mm=near,
        far_mm=far,
        depth_in_gel_mm=(far - near) * model.design.gel_refractive_index,
        sharp_fraction=float(((distance >= near) & (distance <= far)).mean()),
        worst_blur_px=float(blur_px(distance, focal, camera.aperture_mm, camera.focus_mm).max()),
    )


def _distance_in_air(model: OpticalModel, points_mm: np.ndarray) -> np.ndarray:
    """Paraxial distance along the optical axis, layers of flat media shortened by their index."""
    camera = model.camera
    axis = camera.gel_from_camera[:, 2]
    offset = points_mm - camera.position_mm
    depth = offset @ axis
    if not isinstance(model.media, FlatMedia) or not model.media.planes_mm:
        return depth / model.media.indices[-1]
    edges = [camera.position_mm[2], *model.media.planes_mm]
    ahead = sum(
        (high - low) / index
        for low, high, index in zip(edges[:-1], edges[1:], model.media.indices[:-1], strict=True)
    )
    vertical = ahead + (points_mm[:, 2] - edges[-1]) / model.media.indices[-1]
    return depth * vertical / offset[:, 2]
