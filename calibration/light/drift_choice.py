# SPDX-License-Identifier: Apache-2.0
"""Whether the light's drift is taken off the frames: where that brings untouched gel much nearer.

Where it hardly matters, leaving it in averages the light over all captures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from taccel_lab.calibration.light.light import Light

DriftMode = Literal["auto", "on", "off"]
NEEDED_GAIN = 0.25
"""Share of the difference between untouched gel and background that ``auto`` has to take away: it
does 59 % of it on frames with automatic white balance, 4 and 14 % on two sets with fixed
settings."""


@dataclass(frozen=True)
class DriftChoice:
    """What was chosen, and the differences that it rests on."""

    remove: bool
    captured_levels: float
    """Mean difference of untouched gel from the background, median over the frames [levels]."""
    corrected_levels: float
    """The same with the drift of each frame taken off [levels]."""

    @classmethod
    def of(
        cls, differences: Sequence[tuple[float, float]], mode: DriftMode = "auto"
    ) -> DriftChoice:
        """From the differences [levels] of each frame, as captured and with its drift taken off;
        ``on`` and ``off`` decide themselves."""
        captured, corrected = (float(levels) for levels in np.median(differences, axis=0))
        pays = corrected < (1 - NEEDED_GAIN) * captured
        return cls(mode == "on" or (mode == "auto" and pays), captured, corrected)


def choose_drift(
    images: Sequence[np.ndarray],
    lights: Sequence[Light],
    untouched: Sequence[np.ndarray],
    background: np.ndarray,
    mode: DriftMode = "auto",
) -> DriftChoice:
    """Compare frames with the background where nothing touches the gel.

    Args:
        images: RGB levels, each of shape [height_px, width_px, 3].
        lights: Light of each against the background.
        untouched: Where each shows untouched gel, bool, each of shape [height_px, width_px].
        background: RGB levels, shape [height_px, width_px, 3].
        mode: ``on`` and ``off`` decide themselves.
    """
    differences = [
        (_difference(image, background, flat), _difference(light.remove(image), background, flat))
        for image, light, flat in zip(images, lights, untouched, strict=True)
    ]
    return DriftChoice.of(differences, mode)


def _difference(image: np.ndarray, background: np.ndarray, flat: np.ndarray) -> float:
    """Mean absolute difference [levels]; 0 where no gel is untouched."""
    if not flat.any():
        return 0.0
    seen, wanted = (picture[flat].astype(np.float32) for picture in (image, background))
    return float(np.abs(seen - wanted).mean())
