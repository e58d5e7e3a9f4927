# SPDX-License-Identifier: Apache-2.0
"""The image of a height map in a profile's colours or grey values, without a simulation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import eight_bit
from taccel_lab.guards import require_shape
from taccel_lab.profile import SensorProfile
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.depth_response import DepthResponse
from taccel_lab.signals.normals import normals_from_slopes, slopes_from_height
from taccel_lab.signals.rest_surface import rest_surface
from taccel_lab.signals.tactile_image import tactile_image


@dataclass(frozen=True)
class _Face:
    """A ``PressedFace``."""

    height_m: np.ndarray
    rest_height_m: np.ndarray
    normals: np.ndarray
    rest_normals: np.ndarray


def image_of_heights(profile: SensorProfile, height_m: np.ndarray) -> np.ndarray:
    """``levels_of_heights`` as a camera gives them, uint8; arguments and errors are the same."""
    return eight_bit(levels_of_heights(profile, height_m))


def levels_of_heights(profile: SensorProfile, height_m: np.ndarray) -> np.ndarray:
    """Render what the sensor sees of a surface; its markers stay where they rest.

    Args:
        profile: With a background, and a ``color`` block or a ``depth_response`` block.
        height_m: z of the contact face [m] in the gel frame, [height_px, width_px]; NaN where there
            is none, which shows the background.

    Returns:
        RGB levels, float, [height_px, width_px, 3].

    Raises:
        InputError: A profile without these blocks, a map of another size, or heights that go past
            the gel.
    """
    model, grey = ColorModel.from_profile(profile), profile.depth_response
    if profile.background_rgb is None or (model is None and grey is None):
        raise InputError(
            f"the profile of {profile.sensor.name} has no color or depth_response block to render "
            "heights with; fit one with taccel-lab calibrate color (colour sensors) or calibrate "
            "depth (grey ones)"
        )
    height_m = np.asarray(height_m, dtype=np.float64)
    grid = profile.grid()
    require_shape("height_m", height_m, (grid.height_px, grid.width_px), finite=False)
    rest = rest_surface(profile.mesh, grid)
    rise_m = height_m - rest.height_m
    most_m = 1e-3 * profile.gel.thickness_mm
    if np.nanmax(np.abs(rise_m), initial=0.0) > most_m:
        deepest = float(np.nanmax(np.abs(rise_m)))
        raise InputError(
            f"height_m differs from the resting face by up to {deepest:.3g} m, and the gel is "
            f"{most_m:.3g} m thick; heights are metres in the gel frame"
        )
    if model is None:
        response = DepthResponse.from_profile(profile)
        assert response is not None
        depth_mm = np.where(np.isfinite(rise_m), -1e3 * rise_m, 0.0)
        return response.render(depth_mm, profile.background_rgb)
    # The rest's own slopes: what has not moved shows the background exactly.
    slope = slopes_from_height(rise_m, grid) + rest.samples[..., :2]
    face = _Face(height_m, rest.height_m, normals_from_slopes(slope), rest.normals)
    return tactile_image(model, profile.background_rgb, face)
