# SPDX-License-Identifier: Apache-2.0
"""The pitch of the dots in a picture, for a scale from dots of known distance."""

from __future__ import annotations

import numpy as np

from taccel_lab.calibration.markers.finding import find_markers
from taccel_lab.calibration.markers.layout import PITCH_X, PITCH_Y
from taccel_lab.errors import InputError


def marker_pitch_px(image: np.ndarray) -> tuple[float, float, float]:
    """Mean distance of neighbouring dots along the rows and across them, and its uncertainty.

    Args:
        image: RGB or grey levels at rest, shape [height_px, width_px] or [.., 3].

    Returns:
        Pitch along the row direction nearest to +u and across it [px], and the larger of their
        standard deviations [px]. In a hexagonal lattice the second is the distance of the rows.

    Raises:
        InputError: No dots, or dots that form no lattice.
    """
    layout = find_markers(image).layout_px
    if layout is None:
        raise InputError("the dots in the picture form no lattice, so that they have no pitch")
    return *layout.pitch, max(layout.sigma(PITCH_X), layout.sigma(PITCH_Y))
