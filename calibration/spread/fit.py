# SPDX-License-Identifier: Apache-2.0
"""From the frames of a capture folder, and from profiles of units, to their spread."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.background.fit import calibrate_background
from taccel_lab.calibration.background.result import BackgroundCalibration, FrameLight
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.light.light import Light
from taccel_lab.calibration.spread.result import SpreadCalibration
from taccel_lab.calibration.spread.units import UnitSpread, spread_of_units
from taccel_lab.errors import InputError
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
    """How far the light of the folder's frames differs, and units where profiles are given.

    Args:
        folder: Its untouched images are compared, or its presses where there are fewer than two.
        base: Profile that the result extends; nothing of it is compared.
        options: Profiles of units.
        progress: Told of the frames.

    Raises:
        InputError: Fewer than two frames and no profiles, or profiles that cannot be compared.
    """
    units = spread_of_units(options.units) if options.units else None
    light = calibrate_background(folder, base, progress)
    return fit_spread(
        [frame.drift for frame in _compared_frames(light)],
        units,
        light.image,
        inputs=light.inputs,
        source=light.source,
        noise_levels=light.noise_levels,
        sensor=folder.sensor,
    )


def _compared_frames(light: BackgroundCalibration) -> list[FrameLight]:
    """The untouched frames, or the presses where there are fewer than two of them."""
    untouched = [frame for frame in light.frames if frame.kind == "untouched"]
    presses = [frame for frame in light.frames if frame.kind == "press"]
    return untouched if len(untouched) > 1 else presses


def fit_spread(
    frame_drifts: Sequence[Light],
    units: UnitSpread | None,
    background: np.ndarray,
    *,
    inputs: dict[str, str],
    source: str,
    noise_levels: float | None = None,
    sensor: str = "",
) -> SpreadCalibration:
    """Combine what was measured; InputError when there is nothing to take a spread of.

    Args:
        frame_drifts: Light of each frame of one unit against its background.
        units: Spread between units, if there are profiles of several.
        background: RGB levels of the untouched sensor, shape [height_px, width_px, 3].
        inputs: SHA-256 of what was measured, by name.
        source: Where it comes from.
        noise_levels: Standard deviation of a pixel between frames in one light [levels].
        sensor: Its family, for the page.
    """
    if len(frame_drifts) < 2 and units is None:
        raise InputError(
            f"a spread needs at least 2 frames or 2 profiles of units, got {len(frame_drifts)} "
            "frames and no profiles"
        )
    pivot = background.astype(np.float64).mean(axis=(0, 1))
    return SpreadCalibration(
        tuple(frame_drifts), noise_levels, units, pivot, dict(inputs), source, sensor
    )
