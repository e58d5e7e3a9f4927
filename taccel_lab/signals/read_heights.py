# SPDX-License-Identifier: Apache-2.0
"""Heights from images by an inverse model: their slopes integrated, and their uncertainty.

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
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any, Generic

import numpy as np

from taccel_lab.geometry import PixelGrid
from taccel_lab.networks.normal_settings import NormalModelConfig
from taccel_lab.signals.normal_model import NormalMap, NormalModel
from taccel_lab.signals.slope_integration import resting_height
from taccel_lab.signals.tensors import Array, as_given, length2, tensor_of

if TYPE_CHECKING:
    import torch

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


BAND_SIGMAS = 2.0
"""Standard deviations within which 95 % of the heights lie."""
FLAT_SIGMAS = 2.0
"""Tilts below this many standard deviations count as at rest."""
FLAT_DEG = 3.0
"""Tilts below this angle do anyway."""


@dataclass(frozen=True)
class ReadHeights(Generic[Array]):
    """What an image shows of the surface, or several along leading axes."""

    normals: NormalMap[Array]
    slope: Array
    """dh/dx and dh/dy over those at rest, shape [..., height_px, width_px, 2]."""
    rise_m: Array
    """Rise over the resting face [m], shape [..., height_px, width_px]."""
    zero: Array
    """Pixels at rest that it is counted from, bool, shape [..., height_px, width_px]."""
    sigma_m: Array | None
    """Its standard deviation [m], by the reading and by what the model's calibration may be off by;
    None where the model does not know."""
    reading_sigma_m: Array | None
    """Standard deviation of the reading alone, which tells places of one image apart."""


def read_heights(
    model: NormalModel,
    image: Array,
    background: np.ndarray,
    grid: PixelGrid,
    *,
    mask: np.ndarray | None = None,
    rest_normals: np.ndarray | None = None,
    left_out: int | None = None,
    uncertainty: bool = True,
    every: int = 1,
) -> ReadHeights[Array]:
    """Read an image, or several at once, on the model's device.

    Args:
        model: From colours to normals.
        image: RGB levels under the background's light, shape [..., height_px, width_px, 3]; the
            maps are tensors of the model's device where it is a tensor.
        background: The untouched sensor, shape [height_px, width_px, 3].
        grid: Pixel grid of both.
        mask: Pixels that count, bool, shape [h, w]; the surface goes on smoothly under the others.
        rest_normals: Outward unit normals of the undeformed face, shape [h, w, 3]; flat when None.
        left_out: The member that reads alone, since it did not see this press (``NormalModel``).
        uncertainty: Whether to find the heights' standard deviation, a sixth of the time.
        every: Only every n-th row and column is read, as in the whole image, and integrated:
            the maps are those of ``grid.thinned(every)``.
    """
    import torch

    if model.device == "cpu" and image.ndim > 3 and len(image):
        # Sums and products round by how much there is at once, which saves no time here.
        of = partial(
            read_heights, mask=mask, rest_normals=rest_normals, left_out=left_out,
            uncertainty=uncertainty, every=every,
        )  # fmt: skip
        return _stacked([of(model, each, background, grid) for each in image])
    found = model.predict(
        torch.as_tensor(image, device=model.device),
        background, mask=mask, rest_normals=rest_normals, left_out=left_out, every=every,
    )  # fmt: skip
    part = np.s_[::every, ::every]
    grid = grid.thinned(every)
    mask = None if mask is None else mask[part]
    weights = None if mask is None else mask.astype(float)
    zero = resting_border(found, mask)
    slope = found.slopes()
    if rest_normals is not None:
        # The change of height from rest is integrated: on a curved gel the rest is known already.
        rest = tensor_of(rest_normals[part], like=slope)
        slope = slope + rest[..., :2] / rest[..., 2:]
    rise = resting_height(slope, grid, weights=weights, zero=zero)
    read = ReadHeights(
        found.like(image),
        as_given(slope, image),
        as_given(rise, image),
        as_given(zero, image),
        None,
        None,
    )
    return with_deviations(read, model.config, grid, mask, every) if uncertainty else read


def _stacked(parts: Sequence[Any]) -> Any:
    """Readings, maps or what is not known of several images, along a new first axis."""
    import torch

    first = parts[0]
    if isinstance(first, (ReadHeights, NormalMap)):
        names = [field.name for field in fields(first)]
        return replace(first, **{n: _stacked([getattr(one, n) for one in parts]) for n in names})
    if first is None:
        return None
    return np.stack(parts) if isinstance(first, np.ndarray) else torch.stack(list(parts))


def with_deviations(
    read: ReadHeights[Array],
    config: NormalModelConfig,
    grid: PixelGrid,
    mask: np.ndarray | None = None,
    every: int = 1,
) -> ReadHeights[Array]:
    """What was read with the radius of normals and the deviations of heights by ``config``, which
    may state wider ones than the model had; the rest as of ``read_heights``, thinned by
    ``every``."""
    import torch

    normals = read.normals
    normals = replace(normals, radius95_deg=config.radius95_sigmas * normals.sigma_deg)
    read = replace(read, normals=normals)
    if config.height_factor <= 0:
        return read
    weights = None if mask is None else mask.astype(float)
    slope_sigma = tensor_of(normals.slope_sigma())
    slope, rise = tensor_of(read.slope), tensor_of(read.rise_m)
    trials = HeightUncertainty(grid, config.error_length_px / every)
    reading = config.height_factor * trials.sigma_m(slope_sigma, weights=weights, zero=read.zero)
    along = trials.along_m(slope, slope_sigma, weights=weights, zero=read.zero)
    off = torch.hypot(config.along_factor * along, config.depth_share * rise)
    sigma, given = torch.hypot(reading, off), read.rise_m
    return replace(read, sigma_m=as_given(sigma, given), reading_sigma_m=as_given(reading, given))


def resting_border(found: NormalMap[torch.Tensor], mask: np.ndarray | None = None) -> torch.Tensor:
    """Border pixels that are flat, bool, shape [..., h, w]; the whole border where next to none
    are."""
    import torch

    tilt_deg = torch.rad2deg(length2(found.tilt_rad))
    flat = tilt_deg < (FLAT_SIGMAS * found.sigma_deg).clamp(min=FLAT_DEG)
    rows, columns = tilt_deg.shape[-2:]
    depth = max(2, min(rows, columns) // 20)
    flat[..., depth:-depth, depth:-depth] = False
    if mask is not None:
        flat &= tensor_of(mask, like=flat)
    border = torch.ones_like(flat)
    border[..., 1:-1, 1:-1] = False
    enough = flat.sum(dim=(-2, -1), keepdim=True) > 0.2 * (rows + columns)
    return torch.where(enough, flat, border)
