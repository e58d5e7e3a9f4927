# SPDX-License-Identifier: Apache-2.0
"""The light of a newer background against that of the profile: another day, or another unit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from taccel_lab.calibration.frame_light import fit_light
from taccel_lab.calibration.light_drift import LightDrift

SAME_PATTERN = 0.25
"""Part of the background's own variation that may be left once the light is alike, where both show
the same gel: frames of one unit leave 0.01 to 0.1, those of two units of a kind 0.4 to 1.5."""


def light_of_background(
    background: np.ndarray, known: np.ndarray, mask: np.ndarray | None = None
) -> LightDrift:
    """Light of ``background`` against that of the profile, RGB levels [height, width, 3].

    Of one gel on two days it is gain, offset and gradient. Of another unit, whose lamps throw
    another pattern, it is the gain of each channel's mean: a lamp that is brighter by a part makes
    the untouched gel and the colours of a slope brighter by that part.
    """
    counted = slice(None) if mask is None else mask
    means = [image[counted].reshape(-1, 3).mean(axis=0) for image in (background, known)]
    ratio = np.maximum(means[0], 1.0) / np.maximum(means[1], 1.0)
    # What a background does not tell, an even one above all, is a lamp's brightness, not an offset.
    light = fit_light(background, known * ratio, mask)
    light = replace(light, gain=light.gain * ratio)
    left = background - light.apply(known)
    own = known - np.median(known, axis=(0, 1))
    spread, whole = (float(np.median(np.abs(part[counted]))) for part in (left, own))
    if spread <= SAME_PATTERN * whole:
        return light
    return LightDrift(ratio, np.zeros(3))
