# SPDX-License-Identifier: Apache-2.0
"""An image in its profile's light, and what a first look at it saw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.reading.frame_judge import JudgedFrame
from taccel_lab.reading.grey import GreyDepths
from taccel_lab.reading.heights import ReadHeights
from taccel_lab.reading.light import LightDrift
from taccel_lab.reading.rest import RestingPart


@dataclass(frozen=True)
class LitImage:
    """An image as it is read."""

    frame: JudgedFrame
    """The image as it came."""
    levels: np.ndarray
    """RGB levels in the profile's light, float32, shape [height_px, width_px, 3] of the grid, where
    dots are as the gel around them."""
    light: LightDrift
    """Its own light against the untouched sensor's."""
    still: LightDrift
    """The same if nothing touches: a contact takes part of a gradient of the light."""
    around: np.ndarray | None = None
    """Blocks (``blocks``) that a coarse look takes for touched, with those beside them, bool, which
    are read pixel by pixel; None for all."""
    rest: RestingPart | None = None
    """The part that heights are counted from; None where it is the whole border."""
    seen: ReadHeights | GreyDepths | None = None
    """What a coarse look saw of an image that shows no touch: there is no more to be read."""
    remark: str = ""
    """Which common change of all channels was taken off; empty where there was none."""
    dirt: str = ""
    """Which specks, or fading light, likewise."""
    feigned: float = 0.0
    """Standard deviation of a grey sensor's depths, as a part of them, that light may feign."""
