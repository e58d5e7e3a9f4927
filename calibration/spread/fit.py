# SPDX-License-Identifier: Apache-2.0
"""From the frames of a capture folder, and from profiles of units, to their spread."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.background.fit import calibrate_background
from taccel_lab.calibration.background.result import BackgroundCalibration, FrameLight
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.spread.result import SpreadCalibration
from taccel_lab.calibration.spread.units import spread_of_units
from taccel_lab.profile import SensorProfile
from taccel_lab.progress import Progress, silent


@dataclass(frozen=True)
class SpreadOptions:
    """What is compared besides the frames of the folder."""

    units: tuple[SensorProfile, ...] = ()
    """Profiles of several units of one design, the one at hand among them where it is known."""


def calibrate_spread(
    folder: CaptureFolder,
    base: SensorProfile,
    options: SpreadOptions = SpreadOptions(),
    progress: Progress = silent,
) -> SpreadCalibration:
    """How far the light of the folder's untouched images differs, or of its presses where there are
    fewer than two; and units where profiles are given. Nothing of ``base`` is compared.

    Raises:
        InputError: Fewer than two frames and no profiles, or profiles that cannot be compared.
    """
    units = spread_of_units(options.units) if options.units else None
    light = calibrate_background(folder, base, progress)
    return SpreadCalibration(
        tuple(frame.drift for frame in _compared_frames(light)),
        light.noise_levels,
        units,
        light.image.astype(np.float64).mean(axis=(0, 1)),
        dict(light.inputs),
        light.source,
        folder.sensor,
    )


def _compared_frames(light: BackgroundCalibration) -> list[FrameLight]:
    """The untouched frames, or the presses where there are fewer than two of them."""
    untouched = [frame for frame in light.frames if frame.kind == "untouched"]
    presses = [frame for frame in light.frames if frame.kind == "press"]
    return untouched if len(untouched) > 1 else presses
