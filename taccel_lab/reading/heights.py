# SPDX-License-Identifier: Apache-2.0
"""Heights from images by an inverse model: their slopes integrated, and their uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Generic

import numpy as np

from taccel_lab.geometry import PixelGrid
from taccel_lab.networks.normal_settings import NormalModelConfig
from taccel_lab.reading.deviations import HeightUncertainty
from taccel_lab.reading.slope_integration import resting_height
from taccel_lab.reading.slopes import NormalMap, NormalModel
from taccel_lab.signals.tensors import Array, as_given, length2, tensor_of

if TYPE_CHECKING:
    import torch

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

    normals = read.normals
    normals = replace(normals, radius95_deg=config.radius95_sigmas * normals.sigma_deg)
    read = replace(read, normals=normals)
    if config.height_factor <= 0:
        return read
    uncertain = HeightUncertainty(grid, config.error_length_px / every)
    part, vectors = uncertain.part, (*uncertain.part, slice(None))
    seen = replace(normals, tilt_rad=normals.tilt_rad[vectors], sigma_deg=normals.sigma_deg[part])
    reading, along = uncertain.both_m(
        tensor_of(read.slope[vectors]), tensor_of(seen.slope_sigma()), weights=mask, zero=read.zero
    )
    rise = tensor_of(read.rise_m)
    # As a sum of squares: a third of the time of ``hypot``.
    reading = (config.height_factor * reading).to(rise.dtype)
    variance = (config.along_factor * along).square_().to(rise.dtype)
    variance.addcmul_(reading, reading).addcmul_(rise, rise, value=config.depth_share**2)
    sigma = variance.sqrt_()
    given = read.rise_m
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
