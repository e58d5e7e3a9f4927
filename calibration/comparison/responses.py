# SPDX-License-Identifier: Apache-2.0
"""What two profiles do, compared where they do it: image at rest, colours, depth, shape of the gel.

Weights of networks cannot be compared number by number. Their answers can: the colour change over
the hemisphere of normals at a few places of the image, and the normal that a colour is read as.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.report.color_discs import profile_discs
from taccel_lab.geometry import Region
from taccel_lab.profile import SensorProfile


@dataclass(frozen=True)
class ResponseDifference:
    """How far two profiles answer differently; None of what one of them cannot do."""

    background_l1_levels: float | None
    """Mean difference of the images at rest."""
    background_gain_rgb: tuple[float, float, float] | None
    """Ratio of the mean levels, b over a."""
    color_l1_levels: float | None
    """Mean difference of the colour change over all tilts up to 44 degrees at five places."""
    color_max_levels: float | None
    color_size_levels: float | None
    """Mean size of the change itself, to measure the difference by."""
    depth_response_max_mm: float | None
    """Largest difference of depth over the drops that both curves cover."""
    volume_relative: float
    """Difference of the gels' volumes over that of a."""
    contact_area_relative: float
    """Difference of the contact faces' areas over that of a."""


def compare_responses(a: SensorProfile, b: SensorProfile) -> ResponseDifference:
    """Compare what both profiles do; profiles of different image sizes compare no images."""
    background, gain = _compare_backgrounds(a, b)
    mean, worst, size = _compare_colors(a, b)
    volume = [float(_volume(p)) for p in (a, b)]
    area = [float(_contact_area(p)) for p in (a, b)]
    return ResponseDifference(
        background_l1_levels=background,
        background_gain_rgb=gain,
        color_l1_levels=mean,
        color_max_levels=worst,
        color_size_levels=size,
        depth_response_max_mm=_compare_depth(a, b),
        volume_relative=volume[1] / volume[0] - 1,
        contact_area_relative=area[1] / area[0] - 1,
    )


def _compare_backgrounds(
    a: SensorProfile, b: SensorProfile
) -> tuple[float | None, tuple[float, float, float] | None]:
    first, second = a.background_rgb, b.background_rgb
    if first is None or second is None or first.shape != second.shape:
        return None, None
    x, y = (image.astype(np.float64) for image in (first, second))
    gain = y.mean(axis=(0, 1)) / np.maximum(x.mean(axis=(0, 1)), 1e-9)
    return float(np.abs(x - y).mean()), (float(gain[0]), float(gain[1]), float(gain[2]))


def _compare_colors(
    a: SensorProfile, b: SensorProfile
) -> tuple[float | None, float | None, float | None]:
    first, second = profile_discs(a), profile_discs(b)
    if not first or not second:
        return None, None, None
    x, y = (np.stack([disc.delta_rgb for disc in discs]) for discs in (first, second))
    error = np.abs(x - y)
    return float(np.nanmean(error)), float(np.nanmax(error)), float(np.nanmean(np.abs(x)))


def _compare_depth(a: SensorProfile, b: SensorProfile) -> float | None:
    first, second = a.depth_response, b.depth_response
    if first is None or second is None:
        return None
    low = max(first.drop_levels[0], second.drop_levels[0])
    high = min(first.drop_levels[-1], second.drop_levels[-1])
    if high <= low:
        return None
    drop = np.linspace(low, high, 256)
    curves = [np.interp(drop, block.drop_levels, block.depth_mm) for block in (first, second)]
    return float(np.abs(curves[0] - curves[1]).max())


def _volume(profile: SensorProfile) -> float:
    corners = profile.mesh.nodes_m[profile.mesh.tets]
    edges = corners[:, 1:] - corners[:, :1]
    return float(np.linalg.det(edges).sum() / 6)


def _contact_area(profile: SensorProfile) -> float:
    corners = profile.mesh.nodes_m[profile.mesh.region_faces(Region.CONTACT)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(np.linalg.norm(normals, axis=1).sum() / 2)
