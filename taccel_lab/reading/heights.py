# SPDX-License-Identifier: Apache-2.0
"""Heights from images by an inverse model: their slopes integrated, and their uncertainty."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Generic

import numpy as np

from taccel_lab.geometry import PixelGrid
from taccel_lab.networks.normal_settings import NormalModelConfig
from taccel_lab.reading.deviations import HeightUncertainty
from taccel_lab.reading.features import of_blocks
from taccel_lab.reading.room import room
from taccel_lab.reading.slope_integration import resting_height
from taccel_lab.reading.slopes import NormalMap, NormalModel
from taccel_lab.signals.tensors import Array, as_given, length2, tensor_of

if TYPE_CHECKING:
    import torch

BAND_SIGMAS = 2.0
"""Standard deviations within which 95 % of the heights lie."""
SOLVED_TO = 1e-4
"""Residual of the slopes' equation where some pixels are masked: heights are off by 2e-5 of the
deepest one at most."""
FLAT_SIGMAS = 2.0
"""Tilts below this many standard deviations count as at rest."""
FLAT_DEG = 3.0
"""Tilts below this angle do anyway."""
QUIET_TIMES = 3.0
"""Root mean squares of slopes at rest that these may be off by."""
APART_LENGTHS, ROUGH_MEDIAN = 2.0, 1.324
"""Lengths over which slopes err together that two of them are compared over, and the median of how
far they differ where each component has a unit standard deviation: sqrt(2 (1 - 1 / e)) times
sqrt(2 ln 2)."""


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
    background: np.ndarray | torch.Tensor,
    grid: PixelGrid,
    *,
    mask: np.ndarray | None = None,
    rest_normals: np.ndarray | None = None,
    left_out: int | None = None,
    uncertainty: bool = True,
    around: np.ndarray | None = None,
    resting: np.ndarray | None = None,
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
        around: Blocks that smaller ones may be read in (``NormalModel.predict``).
        resting: Blocks of ``LARGEST_PX`` pixels that heights may be counted from, bool; all when
            None.
        every: Pixels along the smallest blocks that are read and integrated, which the maps are of,
            on ``grid.thinned(every)``: 1, 2, or ``LARGEST_PX``.
    """
    import torch

    options = _Options(model, grid, left_out, uncertainty, every)
    given = mask, rest_normals, around, resting
    if model.device == "cpu" and image.ndim > 3 and len(image) and room() is None:
        # Sums and products round by how much there is at once, which saves no time here.
        each = tensor_of(image).flatten(0, -4)
        alone = [options.read(one, background, *given) for one in each]
        found = _joined(alone, lambda maps: torch.stack(maps).unflatten(0, image.shape[:-3]))
    elif model.device == "cpu" or not len(image):
        found = options.read(torch.as_tensor(image, device=model.device), background, *given)
    else:
        found = options.recorded(image, background, *given)
    return _joined([found], lambda parts: as_given(parts[0], image))


@dataclass(frozen=True)
class _Options:
    """How images are read (``read_heights``)."""

    model: NormalModel
    grid: PixelGrid
    left_out: int | None
    uncertainty: bool
    every: int

    def read(
        self,
        image: torch.Tensor,
        background: Any,
        mask: Any,
        rest_normals: Any,
        around: Any,
        resting: Any,
    ) -> ReadHeights[torch.Tensor]:
        """Read images of the model's device, all at once."""
        found = self.model.predict(
            image, background, mask=mask, rest_normals=rest_normals, left_out=self.left_out,
            around=around, every=self.every,
        )  # fmt: skip
        slope = found.slopes()
        if rest_normals is not None:
            # The change of height from rest is integrated: a curved gel's rest is known already.
            rest = tensor_of(of_blocks(rest_normals, self.every), like=slope)
            slope = slope + rest[..., :2] / rest[..., 2:]
        if mask is not None:
            mask = of_blocks(mask, self.every) > 0.5
        grid = self.grid.thinned(self.every)
        zero = resting_border(found, mask, resting)
        rise = resting_height(slope, grid, weights=mask, zero=zero, tolerance=SOLVED_TO)
        read = ReadHeights(found, slope, rise, zero, None, None)
        if not self.uncertainty:
            return read
        return with_deviations(read, self.model.config, grid, mask, self.every)

    def recorded(
        self,
        image: Any,
        background: Any,
        mask: Any,
        rest_normals: Any,
        around: Any,
        resting: Any,
    ) -> ReadHeights[torch.Tensor]:
        """Read images by a recording (``recorded``)."""
        import torch

        from taccel_lab.reading.recorded import replayed

        if mask is not None and mask.all():
            mask = None
        # What a mask makes of deviations is found before a recording.
        masked = None if mask is None else np.packbits(mask).tobytes()
        kinds = (None, torch.float32, torch.bool, None, torch.bool, torch.bool)
        values = (image, background, mask, rest_normals, around, resting)
        return replayed(
            self.model.recordings,
            (self.grid, self.left_out, self.uncertainty, self.every, masked),
            lambda inputs: self.read(*inputs),
            [v if v is None else tensor_of(v, kind) for v, kind in zip(values, kinds, strict=True)],
            self.model.device,
            lambda found: _joined([found], lambda parts: parts[0].clone()),
        )


def _joined(parts: Sequence[Any], join: Callable[[list[Any]], Any]) -> Any:
    """Readings of several images as one, whose maps ``join`` makes of theirs."""
    first = parts[0]
    if isinstance(first, (ReadHeights, NormalMap)):
        names = [field.name for field in fields(first)]
        return replace(first, **{n: _joined([getattr(x, n) for x in parts], join) for n in names})
    return None if first is None else join(list(parts))


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

    normals = read.normals
    normals = replace(normals, radius95_deg=config.radius95_sigmas * normals.sigma_deg)
    read = replace(read, normals=normals)
    if config.height_factor <= 0:
        return read
    uncertain = HeightUncertainty(grid, config.error_length_px / every)
    part, vectors = uncertain.part, (*uncertain.part, slice(None))
    seen = replace(normals, tilt_rad=normals.tilt_rad[vectors], sigma_deg=normals.sigma_deg[part])
    slope, slope_sigma = tensor_of(read.slope[vectors]), tensor_of(seen.slope_sigma())
    reading, along = uncertain.both_m(slope, slope_sigma, weights=mask, zero=read.zero)
    counted = None if mask is None else tensor_of(mask[uncertain.part], like=slope)
    apart = round(APART_LENGTHS * config.error_length_px / (every * uncertain.every))
    factor = quiet_factor(slope, slope_sigma, apart, counted)
    reading, quiet = reading * factor.clamp(min=1.0), factor.clamp(max=1.0)
    rise = tensor_of(read.rise_m)
    # A depth is as far off as the slopes that add up to it.
    share = math.hypot(config.depth_share, config.unit_share)
    if room() is not None:
        from taccel_lab.reading.fixed_surface import deviations_of

        factors = config.height_factor, config.along_factor, share
        flat = (values.reshape(-1, *rise.shape[-2:]) for values in (reading, along, rise))
        reading, sigma = (
            found.reshape(rise.shape) for found in deviations_of(*flat, factors=factors)
        )
        return replace(read, sigma_m=sigma, reading_sigma_m=reading * quiet.to(reading.dtype))
    # As a sum of squares: a third of the time of ``hypot``.
    reading = reading.mul_(config.height_factor).to(rise.dtype)
    variance = along.mul_(config.along_factor).square_().to(rise.dtype)
    variance.addcmul_(reading, reading).addcmul_(rise, rise, value=share**2)
    sigma = variance.sqrt_()
    given, reading = read.rise_m, reading * quiet.to(reading.dtype)
    return replace(read, sigma_m=as_given(sigma, given), reading_sigma_m=as_given(reading, given))


def quiet_factor(
    slope: torch.Tensor, sigma: torch.Tensor, apart: int, mask: torch.Tensor | None = None
) -> torch.Tensor:
    """Factor on the standard deviations of heights where nothing touches, shape [..., 1, 1].

    Networks expect of every image what they were off by in presses. Without a change of colour they
    read rest exactly; what is off then is this image's noise and light, and the image shows both.
    Slopes that stay within their deviation, which are most, are off by ``QUIET_TIMES`` their root
    mean square at most; and no less than by how much slopes far apart differ, at the median: noise
    that no training had.

    Args:
        slope: From rest, shape [..., h, w, 2].
        sigma: Standard deviation of each component, shape [..., h, w].
        apart: Rows between those that are compared.
        mask: Those that count, likewise.
    """
    import torch

    size2 = slope.square().sum(dim=-1) / sigma.square()
    weight = (size2 * -0.5).exp()
    if mask is not None:
        weight = weight * mask
    total = weight.sum(dim=(-2, -1)).clamp(min=1e-6)
    quiet = QUIET_TIMES * ((weight * size2).sum(dim=(-2, -1)) / (2 * total)).sqrt()
    apart = min(max(apart, 1), slope.shape[-3] - 1)
    # Every second column is enough for a median.
    step = slope[..., apart:, ::2, :] - slope[..., :-apart, ::2, :]
    rough = step.square().sum(dim=-1).sqrt() / sigma[..., apart:, ::2]
    rough = rough.flatten(-2).median(dim=-1).values / ROUGH_MEDIAN
    return torch.maximum(quiet.clamp(max=1.0), rough)[..., None, None]


def resting_border(
    found: NormalMap[torch.Tensor],
    mask: np.ndarray | None = None,
    resting: Any = None,
) -> torch.Tensor:
    """Places of the border that are flat, bool, shape [..., h, w], and the whole border where next
    to none are; of those in blocks that are ``resting`` (``read_heights``)."""
    import torch

    flat = torch.rad2deg(length2(found.tilt_rad)) < (FLAT_SIGMAS * found.sigma_deg).clamp(
        min=FLAT_DEG
    )
    if mask is not None:
        flat &= tensor_of(mask, like=flat)
    rows, columns = flat.shape[-2:]
    depth = max(2, min(rows, columns) // 20)
    flat[..., depth:-depth, depth:-depth] = False
    border = torch.ones_like(flat)
    border[..., 1:-1, 1:-1] = False
    enough = flat.sum(dim=(-2, -1), keepdim=True) > 0.2 * (rows + columns)
    zero = torch.where(enough, flat, border)
    if resting is None:
        return zero
    times = -(-rows // resting.shape[-2])
    wide = tensor_of(resting, torch.bool, flat)
    wide = wide.repeat_interleave(times, dim=-1).repeat_interleave(times, dim=-2)
    wide = wide[..., :rows, :columns]
    flat, border = zero & wide, border & wide
    enough = flat.sum(dim=(-2, -1), keepdim=True) > 0.2 * border.sum(dim=(-2, -1), keepdim=True)
    return torch.where(enough, flat, border)
