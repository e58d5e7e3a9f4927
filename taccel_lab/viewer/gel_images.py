# SPDX-License-Identifier: Apache-2.0
"""Frames of a gel as images for a page: tactile image, depth and pressure with their bars."""

from __future__ import annotations

import numpy as np

from taccel_lab.viewer.gel_states import Field, SensorImages

LEAST_MM, LEAST_KPA = 0.01, 0.1
"""Least reach of the colour bars: less is noise."""
SHARE = 0.999
"""Of pixels that the bar of the depth reaches: a face that folds over shows a few far away."""


def gel_images(
    rgb: np.ndarray, depth_m: np.ndarray, pressure_pa: np.ndarray, markers_px: np.ndarray
) -> SensorImages:
    """Images of a row of states.

    Args:
        rgb: Tactile images, uint8 [state, height, width, 3].
        depth_m: [state, height, width]; negative where the face rose.
        pressure_pa: [state, height, width].
        markers_px: [state, marker, 2], at rest in the first.
    """
    depth_mm, pressure_kpa = 1e3 * depth_m, 1e-3 * pressure_pa
    known = depth_mm[np.isfinite(depth_mm)]
    low, high = np.quantile(known, (1 - SHARE, SHARE)) if known.size else (0.0, 0.0)
    top = float(np.nanmax(pressure_kpa, initial=0.0))
    maps = (
        Field("depth", "mm", depth_mm, (min(float(low), 0.0), max(float(high), LEAST_MM))),
        Field("contact pressure", "kPa", pressure_kpa, (0.0, max(top, LEAST_KPA))),
    )
    return SensorImages(rgb, markers_px, maps)
