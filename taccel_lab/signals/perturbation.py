# SPDX-License-Identifier: Apache-2.0
"""Domain randomisation from a measured spread: other units, other days, other lamps.

``PerturbationBlock`` holds standard deviations that were measured between captures or units. One
draw a environment makes a sensor that could have been built: a gain and an offset of each channel,
a gradient of the light, and changed scale, place, modulus and friction; noise is drawn anew for
every image. Images may be numpy arrays or torch tensors on any device (``wp.to_torch`` of what
``SignalTactile`` reads): the arithmetic stays where they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid

if TYPE_CHECKING:
    from taccel_lab.profile import PerturbationBlock

MIN_FACTOR = 0.05
"""Gains and relative changes are kept above this, so that no draw turns a light or a gel off."""


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
    """Of mm_per_px_x and mm_per_px_y, shape [env_count]."""
    center_shift_px: np.ndarray
    """Of the gel in the image (u, v) [px], shape [env_count, 2]."""
    young_modulus_factor: np.ndarray
    """Shape [env_count]."""
    friction_shift: np.ndarray
    """Added to the coefficient of friction, shape [env_count]."""

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

    def apply(self, images: Any, rng: np.random.Generator | None = None) -> Any:
        """Images of the drawn sensors, as ``PerturbationBlock`` says.

        Args:
            images: RGB levels 0..255, float, shape [env_count, height_px, width_px, 3]; a numpy
                array or a torch tensor.
            rng: For the noise; none is added without it.

        Returns:
            The same kind of array, on the same device, clipped to 0..255.
        """
        shape = tuple(images.shape)
        if len(shape) != 4 or shape[0] != self.env_count or shape[3] != 3:
            raise InputError(
                f"images have shape {list(shape)}; [{self.env_count}, height, width, 3] is needed"
            )
        height, width = shape[1:3]
        u = np.linspace(-1, 1, width)[None, None, :, None]
        v = np.linspace(-1, 1, height)[None, :, None, None]
        # gain * image + the rest, so that a nominal draw changes nothing, to the last bit.
        shift = self.offset + (1 - self.gain) * self.pivot
        gain, offset = (self._like(a[:, None, None, :], images) for a in (self.gain, shift))
        across, down = (self._like(self.gradient[:, k][:, None, None, :], images) for k in (0, 1))
        changed = images * gain + offset
        changed = changed + across * self._like(u, images) + down * self._like(v, images)
        if rng is not None and self.noise_levels > 0:
            changed = changed + self._noise(images, rng)
        return changed.clip(0.0, 255.0)

    @staticmethod
    def _like(values: np.ndarray, images: Any) -> Any:
        """``values`` as the kind of array that ``images`` is."""
        if isinstance(images, np.ndarray):
            return values.astype(images.dtype if images.dtype.kind == "f" else np.float32)
        import torch

        return torch.as_tensor(values, dtype=images.dtype, device=images.device)

    def _noise(self, images: Any, rng: np.random.Generator) -> Any:
        if isinstance(images, np.ndarray):
            noise = rng.standard_normal(images.shape, dtype=np.float32)
            return noise * np.float32(self.noise_levels)
        import torch

        generator = torch.Generator(device=images.device)
        generator.manual_seed(int(rng.integers(2**63)))
        shape, kind = tuple(images.shape), {"dtype": images.dtype, "device": images.device}
        return torch.randn(shape, generator=generator, **kind) * self.noise_levels


def draw_perturbation(
    block: PerturbationBlock, env_count: int, rng: np.random.Generator, *, strength: float = 1.0
) -> Perturbation:
    """Draw a sensor for each environment from the measured spread.

    Args:
        block: Standard deviations.
        env_count: Number of environments.
        rng: Source of randomness.
        strength: Multiplies every standard deviation; 0 gives the nominal sensor.

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
    )
