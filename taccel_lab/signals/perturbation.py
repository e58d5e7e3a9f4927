# SPDX-License-Identifier: Apache-2.0
"""Domain randomisation: other units, other days, other lamps, and what breaks in use.

``PerturbationBlock`` holds standard deviations that were measured between captures or units. One
draw an environment makes a sensor that could have been built: a gain and an offset of each channel,
a gradient of the light, and changed scale, place, modulus and friction. ``SensorFaults`` and
``FrameFaults`` are what no calibration measures: a person states them. ``PerturbedSensors`` gives
images of all.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.signals.frame_faults import FrameFaults

if TYPE_CHECKING:
    from taccel_lab.profile import PerturbationBlock

MIN_FACTOR = 0.05
"""Gains and relative changes are kept above this, so that no draw turns a light or a gel off."""


@dataclass(frozen=True)
class SensorFaults:
    """What goes wrong of a sensor in use, of images or of maps of taxels; 0: nothing.

    Dead taxels, gain, crosstalk and hysteresis are those of Genesis' tactile sensors
    (Genesis-Embodied-AI/Genesis, ``genesis/options/sensors``).
    """

    dead_share: float = 0.0
    """Part of the pixels or taxels that is dead, 0 to 1."""
    dead_range: tuple[float, float] = (0.0, 0.0)
    """Values that dead ones show, in the unit of the values."""
    pixel_gain: float = 0.0
    """Standard deviation of the gain of a pixel or taxel, as a part of it."""
    crosstalk: float = 0.0
    """Part of a value that is its neighbours', 0 to 1."""
    crosstalk_px: float = 2.0
    """Standard deviation of their Gaussian weights [px]."""
    hysteresis: float = 0.0
    """Part of a change by which values overshoot (a Maxwell branch beside the elastic one)."""
    hysteresis_s: float = 0.5
    """Time in which that fades [s]."""

    def __post_init__(self) -> None:
        for name in ("dead_share", "crosstalk"):
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(f"{name} is {getattr(self, name)}; 0 to 1 is allowed")
        for name in ("pixel_gain", "hysteresis"):
            if not 0 <= getattr(self, name) < np.inf:
                raise InputError(f"{name} is {getattr(self, name)}; 0 or more is allowed")
        for name in ("crosstalk_px", "hysteresis_s"):
            if not 0 < getattr(self, name) < np.inf:
                raise InputError(f"{name} is {getattr(self, name)}; more than 0 is allowed")
        low, high = self.dead_range
        if not (np.isfinite(self.dead_range).all() and low <= high):
            raise InputError(f"dead_range is {self.dead_range}; two numbers, rising, are allowed")


@dataclass(frozen=True)
class Perturbation:
    """One draw for each of ``env_count`` environments."""

    gain: np.ndarray
    """Factor of each channel about its pivot, shape [env_count, 3]."""
    pivot: np.ndarray
    """Level of each channel that the gain leaves as it is [levels], shape [3]."""
    offset: np.ndarray
    """Added to each channel [levels], shape [env_count, 3]."""
    gradient: np.ndarray
    """Change of the light from the middle to the right and to the lower edge [levels], shape
    [env_count, 2, 3]."""
    noise_levels: float
    """Standard deviation of a pixel's noise [levels]."""
    scale_factor: np.ndarray
    """Factor of mm_per_px_x and mm_per_px_y, shape [env_count]."""
    center_shift_px: np.ndarray
    """Shift of the gel in the image (u, v) [px], shape [env_count, 2]."""
    young_modulus_factor: np.ndarray
    """Shape [env_count]."""
    friction_shift: np.ndarray
    """Added to the coefficient of friction, shape [env_count]."""
    seeds: np.ndarray
    """Seeds from which pixels and faults of frames are drawn, int32, shape [env_count]."""
    faults: SensorFaults
    frame_faults: FrameFaults

    @property
    def env_count(self) -> int:
        return len(self.gain)

    def grid(self, nominal: PixelGrid, env_idx: int) -> PixelGrid:
        """The pixel grid of one environment."""
        factor = float(self.scale_factor[env_idx])
        shift = self.center_shift_px[env_idx]
        return PixelGrid(
            nominal.width_px,
            nominal.height_px,
            nominal.mm_per_px_x * factor,
            nominal.mm_per_px_y * factor,
            nominal.center_u_px + float(shift[0]),
            nominal.center_v_px + float(shift[1]),
        )

    def young_modulus_pa(self, nominal_pa: float) -> np.ndarray:
        """Young's modulus of each environment [Pa], shape [env_count]."""
        return nominal_pa * self.young_modulus_factor

    def friction_coefficient(self, nominal: float) -> np.ndarray:
        """Coefficient of friction of each environment, at least 0, shape [env_count]."""
        return np.maximum(nominal + self.friction_shift, 0.0)


def draw_perturbation(
    block: PerturbationBlock,
    env_count: int,
    rng: np.random.Generator,
    *,
    strength: float = 1.0,
    faults: SensorFaults = SensorFaults(),
    frame_faults: FrameFaults = FrameFaults(),
) -> Perturbation:
    """Draw a sensor for each environment from the measured spread.

    Args:
        block: Standard deviations.
        env_count: Number of environments.
        rng: Source of randomness.
        strength: Multiplies every standard deviation; 0 gives the nominal sensor.
        faults: What is broken besides, as stated.
        frame_faults: What is wrong with frames now and then, as stated.

    Raises:
        InputError: No environments, or a negative strength.
    """
    if env_count < 1:
        raise InputError(f"env_count must be at least 1, got {env_count}")
    if not (np.isfinite(strength) and strength >= 0):
        raise InputError(f"strength must be zero or positive, got {strength}")

    def normal(sigma: object, *shape: int) -> np.ndarray:
        return strength * np.asarray(sigma) * rng.standard_normal((env_count, *shape))

    return Perturbation(
        gain=np.maximum(1 + normal(block.gain_rgb, 3), MIN_FACTOR),
        pivot=np.array(block.pivot_rgb, dtype=np.float64),
        offset=normal(block.offset_rgb, 3),
        gradient=normal(block.gradient_rgb, 2, 3),
        noise_levels=strength * block.noise_levels,
        scale_factor=np.maximum(1 + normal(block.mm_per_px_relative), MIN_FACTOR),
        center_shift_px=normal(block.center_px, 2),
        young_modulus_factor=np.maximum(1 + normal(block.young_modulus_relative), MIN_FACTOR),
        friction_shift=normal(block.friction_coefficient),
        seeds=rng.integers(2**30, size=env_count, dtype=np.int32),
        faults=faults,
        frame_faults=frame_faults,
    )
