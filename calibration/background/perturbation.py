# SPDX-License-Identifier: Apache-2.0
"""How far units and frames differ: the profile's ``perturbation`` block from measured spread.

Images at rest of several units already hold one draw of the drift each, so that their spread is
the whole one; where they are missing, the drift between the frames of one unit stands in.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from taccel_lab.calibration.light_drift import drift_spread
from taccel_lab.calibration.remarks import TOO_FEW
from taccel_lab.calibration.result import calibrated
from taccel_lab.errors import InputError
from taccel_lab.printable import counted
from taccel_lab.profile import PerturbationBlock, SensorProfile
from taccel_lab.reading.light import LightDrift, fit_light, triple
from taccel_lab.report.remark import Remark

FEW = 5
"""Count of frames or units below which a standard deviation is off by a third or more."""
MEASURED = ("measured", "calibrated")
"""Kinds of blocks whose values say something about the unit at hand."""


@dataclass(frozen=True)
class UnitSpread:
    """Standard deviations between units, from their profiles."""

    unit_count: int
    lights: tuple[LightDrift, ...]
    """Light of each unit against the mean of all images at rest; empty without images."""
    values: dict[str, float]
    """Standard deviations of scale, place, modulus and friction, by the block's fields; only those
    that two profiles measured."""


def spread_of_units(profiles: Sequence[SensorProfile]) -> UnitSpread:
    """Compare units of one family; values that were assumed or published count for nothing.

    Raises:
        InputError: Fewer than two profiles, profiles of different families, or one and the same
            calibration twice.
    """
    if len(profiles) < 2:
        raise InputError(f"the spread between units needs at least 2 profiles, got {len(profiles)}")
    families = sorted({profile.sensor.family for profile in profiles})
    if len(families) > 1:
        raise InputError(f"the profiles are of different families: {', '.join(families)}")
    for k, other in enumerate(profiles):
        for i, one in enumerate(profiles[:k]):
            shared = _shared_measurement(one, other)
            if shared is not None:
                raise InputError(
                    f"profiles {i + 1} and {k + 1} of the units hold the same {shared}: they are "
                    "of one unit, whose spread would come out too small. Give each unit once"
                )
    cameras = [p.camera for p in profiles if p.camera.provenance.kind in MEASURED]
    materials = [p.material for p in profiles if p.material.provenance.kind in MEASURED]
    values = {}
    if len(cameras) > 1:
        values["mm_per_px_relative"] = _relative(
            [math.sqrt(c.mm_per_px_x * c.mm_per_px_y) for c in cameras]
        )
        centers = np.array([(c.center_u_px, c.center_v_px) for c in cameras])
        values["center_px"] = float(np.sqrt(centers.var(axis=0, ddof=1).mean()))
    if len(materials) > 1:
        values["young_modulus_relative"] = _relative([m.young_modulus_pa for m in materials])
        frictions = [m.friction_coefficient for m in materials]
        values["friction_coefficient"] = float(np.std(frictions, ddof=1))
    return UnitSpread(len(profiles), _lights(profiles), values)


def _shared_measurement(one: SensorProfile, other: SensorProfile) -> str | None:
    """What both profiles took from one and the same measurement; None if nothing."""
    if (
        one.background_rgb is not None
        and other.background_rgb is not None
        and np.array_equal(one.background_rgb, other.background_rgb)
    ):
        return "image at rest"
    for key in ("camera", "material"):
        inputs = [getattr(p, key).provenance.inputs for p in (one, other)]
        if getattr(one, key).provenance.kind in MEASURED and inputs[0] and inputs[0] == inputs[1]:
            return f"captures behind the block {key}"
    return None


def _relative(values: Sequence[float]) -> float:
    return float(np.std(values, ddof=1) / np.mean(values))


def _lights(profiles: Sequence[SensorProfile]) -> tuple[LightDrift, ...]:
    images = [p.background_rgb for p in profiles if p.background_rgb is not None]
    if len(images) < 2 or len({image.shape for image in images}) > 1:
        return ()
    mean = np.mean([image.astype(np.float64) for image in images], axis=0)
    return tuple(fit_light(image.astype(np.float64), mean) for image in images)


def perturbation_block(
    frames: Sequence[LightDrift],
    units: UnitSpread | None,
    noise_levels: float | None,
    pivot: np.ndarray,
    inputs: dict[str, str],
    source: str,
) -> PerturbationBlock | None:
    """The block of frames of one unit, and of units where they are known; None where there are
    neither two frames nor two units. ``pivot`` [3]: mean level of the background by channel."""
    if len(frames) < 2 and units is None:
        return None
    between_units = units is not None and bool(units.lights)
    lights = units.lights if units is not None and units.lights else frames
    values: dict[str, Any] = light_spread(lights, pivot)
    if noise_levels is not None:
        values["noise_levels"] = noise_levels
    values |= {} if units is None else units.values
    unit_count = 0 if units is None else units.unit_count
    count = len(lights) or unit_count
    error = relative_error(count)
    spread = {k: error * v for k, v in values.items() if isinstance(v, float)}
    for name in ("gain_rgb", "offset_rgb", "gradient_rgb"):
        if name in values:
            spread[name] = error * float(np.mean(values[name]))
    residuals = [light.noise_levels for light in lights]
    remarks = _remarks(0 if between_units else len(frames), unit_count)
    return PerturbationBlock(
        **values,
        provenance=calibrated(
            remarks,
            method="standard deviation of the light (gain, offset, gradient against the mean "
            f"image, robust fit) between {'units' if between_units else 'frames'}; of scale, "
            "place, modulus and friction between units",
            source=source,
            inputs=inputs,
            residuals={"light_fit_levels": float(np.mean(residuals)) if residuals else 0.0},
            spread=spread,
            valid_region={"sample_count": (float(count), float(count))},
        ),
    )


def _remarks(frame_count: int, unit_count: int) -> list[Remark]:
    return [
        TOO_FEW(
            found=counted(count, what),
            wanted=f"each standard deviation is itself uncertain by {relative_error(count):.0%}; "
            f"{FEW} or more would halve that",
        )
        for what, count in (("frame", frame_count), ("unit", unit_count))
        if 0 < count < FEW
    ]


def light_spread(
    lights: Sequence[LightDrift], pivot: np.ndarray
) -> dict[str, tuple[float, float, float]]:
    """Standard deviations of gain, offset and gradient between lights, by channel.

    The offset is that at the level ``pivot`` [3]: about the mean level of the image it varies
    independently of the gain, at zero it would repeat it.
    """
    if len(lights) < 2:
        return {}
    gain = np.array([light.gain for light in lights]).std(axis=0, ddof=1)
    offset = drift_spread(lights, pivot[None, None]).shift_levels
    gradient = np.array([light.gradient for light in lights])
    # One figure for both directions: the root mean square of their standard deviations.
    plane = np.sqrt(gradient.var(axis=0, ddof=1).mean(axis=1))
    return {
        "gain_rgb": triple(gain),
        "pivot_rgb": triple(pivot),
        "offset_rgb": offset,
        "gradient_rgb": triple(plane),
    }


def relative_error(count: int) -> float:
    """Standard error of a standard deviation from ``count`` samples, as a part of it."""
    return 1.0 if count < 2 else 1 / math.sqrt(2 * (count - 1))
