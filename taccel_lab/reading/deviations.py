# SPDX-License-Identifier: Apache-2.0
"""Standard deviations of heights, by what slopes and light may be off by.

Errors of slopes add up along the way, and neighbouring pixels err together, so the standard
deviation of a height is found by trial: smooth random errors as large as the slopes' own are
integrated as the slopes were, some times, and their spread is taken. How far errors reach
(``error_length_px``) and how much too small the spread is are found on presses of known shape when
the model is calibrated.

Such errors cancel around a dent. What readings share does not: a network that was taught the rim of
the contact a pixel too far out reads every dent too steep all around. So the same errors are also
integrated as if all of them lay along the slope (``along_m``). That builds up where slopes are
uncertain, at the rim, stays over the floor of the dent and is gone beside it, as errors of real
presses do.

What the uncertain light of an image does to heights is found once for each sensor, at rest. Gain,
offset and gradient of each channel are known to a covariance. Each of them, off by a little,
changes colours all over the image, and with them slopes and their integral. That is linear in small
errors and hardly depends on what is pressed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.geometry import PixelGrid
from taccel_lab.reading.slope_integration import resting_height
from taccel_lab.reading.slopes import NormalModel
from taccel_lab.signals.depth_response import LUMA, DepthResponse
from taccel_lab.signals.tensors import Array, as_given, length2, tensor_of

if TYPE_CHECKING:
    import torch

    from taccel_lab.reading.light import LightDrift

COARSE_PX = 48
"""Pixels of the shorter side of the maps that errors are integrated on: they are smooth."""
PROBE_LEVELS = 2.0
"""Change of colour that slopes are found for; small beside what they are linear in."""
DRAWS = 16
"""Trials: a standard deviation from 16 is itself known to 18 %."""
POINTS_PER_LENGTH = 2.0
"""Points per error length of the grid that errors are integrated on."""
TRIAL_TOLERANCE = 1e-5
"""Tolerance of trials with masked pixels: far below what so few of them leave open."""
TINY_SLOPE = 1e-9
SMOOTHING_PX = 6.0
"""The spread of few trials is uneven; its square is averaged over this many pixels."""


@lru_cache(maxsize=4)
def smooth_errors(height_px: int, width_px: int, length_px: float) -> np.ndarray:
    """Fields of unit variance that are smooth over ``length_px``, the same for every image,
    float32, shape [draw, height_px, width_px, 2]."""
    from scipy.ndimage import gaussian_filter

    fields = np.random.default_rng(0).standard_normal(
        (DRAWS, height_px, width_px, 2), dtype=np.float32
    )
    if length_px > 0:
        fields = gaussian_filter(fields, (0, length_px, length_px, 0), mode="reflect")
    return fields / fields.std(axis=(0, 1, 2))


class HeightUncertainty:
    """Standard deviations of integrated heights on one pixel grid."""

    def __init__(self, grid: PixelGrid, error_length_px: float) -> None:
        """
        Args:
            grid: The pixel grid of the slopes.
            error_length_px: Standard deviation of the Gaussian that errors are smooth over [px].
        """
        self.grid, self.error_length_px = grid, error_length_px
        # Errors that are smooth over many pixels are integrated on as many fewer of them.
        block = max(1, int(error_length_px / POINTS_PER_LENGTH))
        width, height = (max(2, round(n / block)) for n in (grid.width_px, grid.height_px))
        self._coarse = PixelGrid(
            width,
            height,
            grid.mm_per_px_x * grid.width_px / width,
            grid.mm_per_px_y * grid.height_px / height,
        )
        self._length = error_length_px * width / grid.width_px

    def sigma_m(self, slope_sigma: Array, *, weights: Any = None, zero: Any = None) -> Array:
        """Standard deviation of the height [m], shape [..., height_px, width_px].

        Args:
            slope_sigma: Standard deviation of each component of the slope, shape [..., h, w].
            weights: As the heights were integrated with.
            zero: Pixels that the height is counted from, likewise.
        """
        import torch

        coarse, size = self._coarse, self._size(self._coarse)
        given = tensor_of(slope_sigma, torch.float64)
        sigma = on_grid(given, size)
        weights, zero = self._counted(weights, zero, given)
        fields = tensor_of(
            smooth_errors(coarse.height_px, coarse.width_px, self._length), torch.float64, given
        )
        # Trials stand before the maps' rows: those of all images are integrated together.
        errors = resting_height(
            sigma[..., None, :, :, None] * fields,
            coarse,
            weights=weights,
            zero=None if zero is None else zero[..., None, :, :],
            tolerance=TRIAL_TOLERANCE,
        )
        variance = errors.square().mean(dim=-3)
        smoothing = SMOOTHING_PX * coarse.width_px / self.grid.width_px
        spread = smoothed_to(variance, smoothing, self._size(self.grid))
        return as_given(spread.clamp(min=0.0).sqrt(), slope_sigma)

    def along_m(
        self, slope: Array, slope_sigma: Array, *, weights: Any = None, zero: Any = None
    ) -> Array:
        """Height [m], shape [..., height_px, width_px], that is gained or lost where each slope
        from rest, shape [..., h, w, 2], is steeper or flatter by its standard deviation; the rest
        as in ``sigma_m``. A slope below its deviation has no direction that errors lie along: they
        count as much less as it is below, whether noise is averaged over blocks or not."""
        import torch

        slopes, sigma = (tensor_of(values, torch.float64) for values in (slope, slope_sigma))
        steepness = torch.maximum(length2(slopes), sigma).clamp(min=TINY_SLOPE)
        error = (slopes * (sigma / steepness)[..., None]).movedim(-1, 0)
        weights, zero = self._counted(weights, zero, slopes)
        error = on_grid(error, self._size(self._coarse)).movedim(0, -1)
        height = resting_height(error, self._coarse, weights=weights, zero=zero)
        return as_given(on_grid(height, self._size(self.grid)).abs(), slope_sigma)

    def _counted(
        self, weights: Any, zero: Any, like: torch.Tensor
    ) -> tuple[torch.Tensor | None, torch.Tensor | None]:
        """Weights and zero on the coarse grid."""
        import torch

        size = self._size(self._coarse)
        if weights is not None:
            weights = on_grid(tensor_of(weights, torch.float64, like), size).clamp(0.0, 1.0)
        if zero is not None:
            zero = on_grid(tensor_of(zero, torch.float64, like), size) >= 0.5
            # A border of few pixels may be gone: the whole one then counts.
            whole = torch.ones(size, dtype=torch.bool, device=like.device)
            whole[1:-1, 1:-1] = False
            zero = torch.where(zero.any(dim=-1).any(dim=-1)[..., None, None], zero, whole)
        return weights, zero

    @staticmethod
    def _size(grid: PixelGrid) -> tuple[int, int]:
        return grid.height_px, grid.width_px


# Maps on other grids of pixels over the same view: each axis by one matrix.


def on_grid(values: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
    """Maps, shape [..., h, w], on (height, width) pixels: means over larger ones, or linear between
    the middles of larger ones."""
    return _by_axes(values, size, resampling)


def smoothed_to(values: torch.Tensor, sigma_px: float, size: tuple[int, int]) -> torch.Tensor:
    """``on_grid`` of the maps' Gaussian average; what lies beside the border is as the border."""

    def smoothed(count: int, wanted: int) -> np.ndarray:
        return resampling(count, wanted) @ _smoothing(count, sigma_px)

    return _by_axes(values, size, smoothed)


def _by_axes(
    values: torch.Tensor, size: tuple[int, int], matrix: Callable[[int, int], np.ndarray]
) -> torch.Tensor:
    rows, columns = (
        tensor_of(matrix(count, wanted), values.dtype, values)
        for count, wanted in zip(values.shape[-2:], size, strict=True)
    )
    return rows @ values @ columns.T


@lru_cache(maxsize=32)
def resampling(count: int, wanted: int) -> np.ndarray:
    """Matrix of an axis, shape [wanted, count]; rows add up to 1."""
    if wanted >= count:
        at = np.clip((np.arange(wanted) + 0.5) * count / wanted - 0.5, 0, count - 1)
        return np.maximum(0.0, 1.0 - np.abs(at[:, None] - np.arange(count)))
    ends = np.arange(wanted + 1) * count / wanted
    pixels = np.arange(count)
    shared = np.minimum(ends[1:, None], pixels + 1) - np.maximum(ends[:-1, None], pixels)
    return np.maximum(0.0, shared) * wanted / count


@lru_cache(maxsize=32)
def _smoothing(count: int, sigma_px: float) -> np.ndarray:
    from scipy.ndimage import gaussian_filter1d

    return gaussian_filter1d(np.eye(count), sigma_px, axis=0, mode="nearest")


class LightErrors:
    """Heights' standard deviations by the light, for images of one sensor."""

    def __init__(
        self,
        model: NormalModel,
        background: np.ndarray,
        grid: PixelGrid,
        mask: np.ndarray | None = None,
        rest_normals: np.ndarray | None = None,
    ) -> None:
        """
        Args:
            model: From colours to normals.
            background: The untouched sensor, RGB levels, shape [height_px, width_px, 3].
            grid: Pixel grid of the images.
            mask: Pixels that count, bool, shape [height_px, width_px].
            rest_normals: Of the face at rest, shape [h, w, 3]; flat when None.
        """
        from taccel_lab.reading.light import LightDrift

        self.every = every = max(1, min(background.shape[:2]) // COARSE_PX)
        self._part = np.s_[::every, ::every]
        self._grid, self._size = grid.thinned(every), background.shape[1::-1]
        self._level = background.reshape(-1, 3).mean(axis=0)
        terms = LightDrift(np.ones(3), np.zeros(3), level=self._level).terms(background)
        self._weights = None if mask is None else mask[self._part].astype(float)
        rest = 0.0
        if rest_normals is not None:
            thin = rest_normals[self._part]
            rest = thin[..., :2] / thin[..., 2:]
        self._slopes = np.empty((3, 4, self._grid.height_px, self._grid.width_px, 2))
        for channel in range(3):
            for k, term in enumerate(terms):
                probe = PROBE_LEVELS / max(float(np.abs(term[..., channel]).max()), 1e-9)
                image = background.astype(np.float32)
                image[..., channel] += probe * term[..., channel]
                read = model.predict(
                    image, background, mask=mask, rest_normals=rest_normals, every=every
                )
                self._slopes[channel, k] = (read.slopes() + rest) / probe

    def sigma_m(
        self, lights: Sequence[LightDrift], zero: np.ndarray | None, every: int = 1
    ) -> list[np.ndarray]:
        """Standard deviations of the heights [m] for each light of one image, [height, width].

        Args:
            lights: Of the image against the background.
            zero: Pixels that its heights are counted from, as of ``ReadHeights``.
            every: Rows and columns apart that these are of: 1, or ``self.every``.
        """
        import cv2

        part = zero if zero is None or every > 1 else zero[self._part]
        if part is not None and not part.any():
            part = None
        heights = resting_height(self._slopes, self._grid, weights=self._weights, zero=part)
        found = []
        for light in lights:
            covariance = light.covariance_at(self._level)
            variance = np.einsum("ckhw,ckl,clhw->hw", heights, covariance, heights)
            if every == 1:
                variance = cv2.resize(variance, self._size, interpolation=cv2.INTER_LINEAR)
            found.append(np.sqrt(np.maximum(variance, 0.0)))
        return found


def grey_light_sigma_mm(
    response: DepthResponse, light: LightDrift, background: np.ndarray, depth_mm: np.ndarray
) -> np.ndarray:
    """The same of a grey sensor, whose depths follow the curve ``response`` pixel by pixel [mm].

    ``background``: untouched sensor, RGB levels, shape [h, w, 3]; ``depth_mm``: what is read, shape
    [h, w].
    """
    names = ("red", "green", "blue")
    shares = (
        LUMA
        if response.channel == "grey"
        else np.array([float(name == response.channel) for name in names])
    )
    terms = light.terms(background)
    variance = sum(
        share**2 * np.einsum("khw,kl,lhw->hw", terms[..., c], light.covariance[c], terms[..., c])
        for c, share in enumerate(shares)
    )
    drop = response.drop_of(depth_mm)
    per_level = response.depth_of(drop + 1.0) - response.depth_of(drop)
    return per_level * np.sqrt(np.maximum(variance, 0.0))
