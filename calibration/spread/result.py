# SPDX-License-Identifier: Apache-2.0
"""The perturbation block: drift over the frames of one unit, and units side by side.

Images at rest of several units already hold one draw of the drift each, so that their spread is
the whole one; where they are missing, the drift between the frames of one unit stands in.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from taccel_lab.calibration.light.drift import drift_spread, triple
from taccel_lab.calibration.light.light import LightDrift
from taccel_lab.calibration.result import ResultSummary
from taccel_lab.calibration.shared_remarks import TOO_FEW
from taccel_lab.calibration.spread.units import UnitSpread
from taccel_lab.errors import InputError
from taccel_lab.profile import PerturbationBlock, Provenance, SensorProfile
from taccel_lab.report.remark import Remark, judge

FEW = 5
"""Below this many frames or units a standard deviation is off by a third or more."""


@dataclass(frozen=True, repr=False)
class SpreadCalibration(ResultSummary):
    """A perturbation block with what it rests on."""

    frame_drifts: tuple[LightDrift, ...]
    """Light of each frame against the background."""
    frame_noise_levels: float | None
    units: UnitSpread | None
    pivot: np.ndarray
    """Mean level of each channel of the background [levels], shape [3]."""
    inputs: dict[str, str]
    source: str
    sensor: str = ""
    """Family of the sensor, for the title of the page."""

    def __post_init__(self) -> None:
        if len(self.frame_drifts) < 2 and self.units is None:
            raise InputError(
                "a spread needs at least 2 frames or 2 profiles of units, got "
                f"{len(self.frame_drifts)} frames and no profiles"
            )

    def values(self) -> dict[str, Any]:
        """Fields of the block."""
        units = self.units
        values: dict[str, Any] = light_spread(self.lights, self.pivot)
        if self.frame_noise_levels is not None:
            values["noise_levels"] = self.frame_noise_levels
        if units is not None:
            for name in (
                "mm_per_px_relative",
                "center_px",
                "young_modulus_relative",
                "friction_coefficient",
            ):
                if getattr(units, name) is not None:
                    values[name] = getattr(units, name)
        return values

    @property
    def lights(self) -> tuple[LightDrift, ...]:
        """The lights whose spread is taken: of the units where there are several, else frames."""
        if self.units is not None and self.units.lights:
            return self.units.lights
        return self.frame_drifts

    @property
    def remarks(self) -> tuple[Remark, ...]:
        found = []
        frame_count = len(self.frame_drifts) if self.lights is self.frame_drifts else 0
        for what, count in (
            ("frames", frame_count),
            ("units", 0 if self.units is None else self.units.unit_count),
        ):
            if 0 < count < FEW:
                error = relative_error(count)
                wanted = (
                    f"each standard deviation is itself uncertain by {error:.0%}; {FEW} or more "
                    "would halve that"
                )
                found.append(TOO_FEW(count=count, what=what, wanted=wanted))
        return tuple(found)

    def figures(self) -> dict[str, Any]:
        """Everything measured, ready for JSON."""
        return {
            "perturbation": self.values(),
            "frame_count": len(self.frame_drifts),
            "unit_count": 0 if self.units is None else self.units.unit_count,
            "frames": [_drift_figures(d) for d in self.frame_drifts],
            "unit_lights": [_drift_figures(d) for d in self.units.lights] if self.units else [],
        }

    def apply_to(self, profile: SensorProfile) -> SensorProfile:
        """``profile`` with the perturbation block."""
        values = self.values()
        count = len(self.lights) or (0 if self.units is None else self.units.unit_count)
        error = relative_error(count)
        spread = {k: error * v for k, v in values.items() if isinstance(v, float)}
        for name in ("gain_rgb", "offset_rgb", "gradient_rgb"):
            if name in values:
                spread[name] = error * float(np.mean(values[name]))
        residuals = [d.noise_levels for d in self.lights]
        return profile.with_block(
            PerturbationBlock(
                **values,
                provenance=Provenance(
                    kind="calibrated",
                    method="standard deviation of the light (gain, offset, gradient against the "
                    "mean image, robust fit) between "
                    + ("units" if self.lights is not self.frame_drifts else "frames")
                    + "; of scale, place, modulus and friction between units",
                    source=self.source,
                    inputs=self.inputs,
                    residuals={"light_fit_levels": float(np.mean(residuals)) if residuals else 0.0},
                    spread=spread,
                    valid_region={"sample_count": (float(count), float(count))},
                    verdict=judge(self.remarks).value,
                    remarks=tuple(r.message for r in self.remarks),
                ),
            )
        )


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


def _drift_figures(drift: LightDrift) -> dict[str, Any]:
    return {"gain": drift.gain, "offset": drift.offset, "gradient": drift.gradient}
