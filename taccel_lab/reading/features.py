# SPDX-License-Identifier: Apache-2.0
"""What the inverse model sees of each pixel: how its colour changed, at several scales.

One pixel's colour change does not tell the normal well: noise and lens blur hide it, and two
normals may give one colour. So each pixel brings the change averaged over Gaussian windows, and
how that average varies across the wider of them. The features scale with the picture: a zoomed
picture has the same features at scales zoomed as much, and the same normals. Training on several
zooms therefore shows balls of other sizes than the one that was pressed, and keeps a model from
learning that single ball's curvature by heart.

Gaussian averages of pictures on any device.

A window is a band matrix, the same for every stretch of an axis, so that a picture is averaged by
few products of small matrices: a convolution of torch takes six times as long on a CPU, and a
library of the CPU's alone would ask for a second implementation on a GPU.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.networks.normal_settings import NormalModelConfig
from taccel_lab.networks.settings import encode_position
from taccel_lab.signals.tensors import Array, as_given, tensor_of

if TYPE_CHECKING:
    import torch

STRETCH_PX = 32
"""Pixels of an axis that one product gives: of 16 to 80, the fastest for windows of 0.7 to 9 px."""
CUT_SIGMAS = 3.0
"""A window ends here."""


def gaussian_average(values: torch.Tensor, sigma_px: float) -> torch.Tensor:
    """Gaussian average of pictures, float, shape [..., h, w]; mirrored at the border's pixels."""
    # Products along rows need no copy of the overlapping stretches; along columns they would.
    across = _along_rows(values.transpose(-1, -2), sigma_px)
    return _along_rows(across.transpose(-1, -2), sigma_px)


def blurred(values: np.ndarray, sigma_px: float) -> np.ndarray:
    """``gaussian_average`` of a picture, shape [h, w] or [h, w, channel]."""
    channels = tensor_of(values)[None] if values.ndim == 2 else tensor_of(values).movedim(-1, 0)
    found = gaussian_average(channels, sigma_px)
    return (found[0] if values.ndim == 2 else found.movedim(0, -1)).numpy()


def _along_rows(values: torch.Tensor, sigma_px: float) -> torch.Tensor:
    """Average along the last axis but one, shape [..., n, m]."""
    count = values.shape[-2]
    reach = math.ceil(CUT_SIGMAS * sigma_px)
    stretches = -(-count // STRETCH_PX)
    band = tensor_of(_band(sigma_px, reach), values.dtype, values)
    place = tensor_of(_mirrored(count, reach, stretches * STRETCH_PX - count), like=values)
    padded = values.contiguous().index_select(-2, place)
    parts = padded.unfold(-2, STRETCH_PX + 2 * reach, STRETCH_PX).transpose(-1, -2)
    return (band @ parts).flatten(-3, -2)[..., :count, :]


@lru_cache(maxsize=64)
def _band(sigma_px: float, reach: int) -> np.ndarray:
    """Weights of the pixels of a stretch and beside it, shape [stretch, stretch + 2 reach]."""
    steps = np.arange(-reach, reach + 1)
    # A window narrower than a pixel's rounding is that pixel.
    weights = np.exp(-0.5 * (steps / max(sigma_px, 1e-3)) ** 2)
    weights /= weights.sum()
    band = np.zeros((STRETCH_PX, STRETCH_PX + 2 * reach))
    for row in range(STRETCH_PX):
        band[row, row : row + len(weights)] = weights
    return band


@lru_cache(maxsize=64)
def _mirrored(count: int, reach: int, more: int) -> np.ndarray:
    """Index of each pixel of an axis with ``reach`` more on both sides, and ``more`` at its end."""
    steps = np.arange(-reach, count + reach + more)
    if count == 1:
        return np.zeros_like(steps)
    steps %= 2 * (count - 1)
    return np.minimum(steps, 2 * (count - 1) - steps)


LEVELS_PER_UNIT = 32.0
"""Levels of 255 that make one unit of a feature."""
MIN_COVER = 1e-3
"""Share of a window that has to be unmasked for its average to count."""


def color_change(image: Array, background: Array, mask: Array | None = None) -> Array:
    """Image minus background [levels], float32, 0 where ``mask`` is false, shape [..., h, w, 3]."""
    change = tensor_of(image).float() - tensor_of(background).float()
    if mask is not None:
        change = change.where(tensor_of(mask)[..., None], 0.0)
    return as_given(change, image)


def local_features(
    change: np.ndarray,
    scales_px: Sequence[float],
    slope_scales_px: Sequence[float],
    *,
    mask: np.ndarray | None = None,
    background: np.ndarray | None = None,
    place: np.ndarray,
    zoom: float = 1.0,
    picked: np.ndarray | None = None,
) -> np.ndarray:
    """Features of every pixel of a picture or of a part of it, float32, shape [h, w, feature].

    Args:
        change: Colour change [levels], 0 in masked pixels, shape [h, w, 3].
        scales_px: Standard deviations of the windows [px]; 0 is the pixel itself.
        slope_scales_px: Windows across which the change's variation is taken [px].
        mask: Pixels that count, bool, shape [h, w]; all when None.
        background: Untouched picture [levels], shape [h, w, 3]; a feature when it is given.
        place: What each pixel knows of its place (``pixel_place``), shape [h, w, n].
        zoom: Factor on all scales: the features of the picture shrunk by it.
        picked: Pixels whose features are wanted, counted along rows, shape [n]; the result has
            shape [n, feature] then.
    """
    windows = FeatureWindows.of(
        tensor_of(change)[None], scales_px, slope_scales_px, zoom=zoom,
        mask=None if mask is None else tensor_of(mask),
        background=None if background is None else tensor_of(background),
        place=tensor_of(place),
    )  # fmt: skip
    found = windows.features(None if picked is None else tensor_of(picked)).T
    shape = change.shape[:2] if picked is None else picked.shape
    return found.reshape(*shape, -1).contiguous().numpy()


def image_features(
    config: NormalModelConfig,
    change: np.ndarray,
    background: np.ndarray,
    *,
    mask: np.ndarray | None = None,
    zoom: float = 1.0,
    window: tuple[slice, slice] = (slice(None), slice(None)),
    picked: np.ndarray | None = None,
) -> np.ndarray:
    """Raw features of every pixel in ``window``, float32, shape [h, w, feature].

    ``change`` and ``background`` [levels] and ``mask`` are of the whole image. With ``picked``,
    pixels counted along the window's rows, those of these alone, shape [n, feature].
    """
    return local_features(
        change[window],
        config.scales_px,
        config.slope_scales_px,
        mask=None if mask is None else mask[window],
        background=background[window] if config.background else None,
        place=pixel_place(config.width_px, config.height_px, config.position_bands)[window],
        zoom=zoom,
        picked=picked,
    )


@dataclass(frozen=True)
class FeatureWindows:
    """Windows of the changes of one or several images, on pixels or on square blocks of them.

    Features are linear in the change, so that those of a block are the means of its pixels'. Blocks
    at the right and lower border may be cut off there.
    """

    block_px: int
    """Pixels along a block."""
    averages: torch.Tensor
    """Averages of the change [units], shape [3 scale, image, h, w] in blocks."""
    across: torch.Tensor
    """Averages of the wider windows, by rows of blocks and columns of pixels, shape [3 scale,
    image, h, width_px]."""
    down: torch.Tensor
    """Averages by rows of pixels and columns of blocks, shape [3 scale, image, height_px, w]."""
    reach: torch.Tensor
    """Pixels over which a variation is stated, shape [3 scale, 1]."""
    known: torch.Tensor
    """What pixels know without the change: background and place, shape [n, h, w]."""

    @classmethod
    def of(
        cls,
        change: torch.Tensor,
        scales_px: Sequence[float],
        slope_scales_px: Sequence[float],
        *,
        place: torch.Tensor,
        mask: torch.Tensor | None = None,
        background: torch.Tensor | None = None,
        zoom: float = 1.0,
    ) -> FeatureWindows:
        """Windows of changes [levels] of shape [image, h, w, 3], by pixels; the rest as of
        ``local_features``."""
        import torch

        cover: dict[float, torch.Tensor] = {}
        units = change.movedim(-1, 0).float() / LEVELS_PER_UNIT
        windows = {
            scale: _average(units, scale * zoom, mask, cover)
            for scale in {*scales_px, *slope_scales_px}
        }
        known = place.movedim(-1, 0)
        if background is not None:
            levels = background.movedim(-1, 0).float() / LEVELS_PER_UNIT
            widest = max([*scales_px, *slope_scales_px])
            known = torch.cat([_average(levels, widest, mask, {}), known])
        averages = torch.cat([windows[scale] for scale in scales_px])
        if tuple(slope_scales_px) == tuple(scales_px[len(scales_px) - len(slope_scales_px) :]):
            varied = averages[len(averages) - 3 * len(slope_scales_px) :]
        else:
            varied = torch.cat([windows[scale] for scale in slope_scales_px])
        return cls(
            block_px=1,
            averages=averages,
            across=varied,
            down=varied,
            reach=units.new_tensor(slope_scales_px).repeat_interleave(3)[:, None] * zoom,
            known=known,
        )

    @property
    def shape(self) -> torch.Size:
        """Images, rows and columns of blocks."""
        return self.averages.shape[1:]

    def halved(self) -> FeatureWindows:
        """Windows of blocks twice as wide."""
        return replace(
            self,
            block_px=2 * self.block_px,
            averages=halved(halved(self.averages, -1), -2),
            across=halved(self.across, -2),
            down=halved(self.down, -1),
            known=halved(halved(self.known, -1), -2),
        )

    def features(self, picked: torch.Tensor | None = None) -> torch.Tensor:
        """Features of blocks, counted along images, rows and columns, shape [feature, n]; of all
        when None."""
        import torch

        _, height, width = self.shape
        if picked is None:
            picked = torch.arange(self.averages[0].numel(), device=self.averages.device)
        rows, columns = picked // width, picked % width
        images, row = rows // height, rows % height
        averages = self.averages.flatten(1).index_select(1, picked)
        parts = [averages, self.known.flatten(1).index_select(1, row * width + columns)]
        if len(self.across):
            wide, high = self.across.shape[-1], self.down.shape[-2]
            row_start, column_start = rows * wide, images * (high * width) + columns
            du = self._variation(self.across, lambda u: row_start + u, columns, wide)
            dv = self._variation(self.down, lambda v: column_start + v * width, row, high)
            both = torch.stack([du.unflatten(0, (-1, 3)), dv.unflatten(0, (-1, 3))], dim=1)
            parts.insert(1, both.flatten(0, 2))
        return torch.cat(parts)

    def _variation(
        self,
        lines: torch.Tensor,
        place: Callable[[torch.Tensor], torch.Tensor],
        block: torch.Tensor,
        count: int,
    ) -> torch.Tensor:
        """Mean over each block of half the difference of the pixels beside a pixel; of a block's
        inner ones nothing is left of it. ``place`` of a pixel of a line of ``count``."""
        flat, size = lines.flatten(1), self.block_px
        first = block * size
        last = (first + size - 1).clamp(max=count - 1)

        def at(pixel: torch.Tensor) -> torch.Tensor:
            return flat.index_select(1, place(pixel.clamp(0, count - 1)))

        start, end = at(first), at(last)
        # Beside the border a line goes on as between the last two pixels.
        before = at(first - 1).where(first > 0, 2 * start - at(first + 1))
        after = at(last + 1).where(last < count - 1, 2 * end - at(last - 1))
        rise = after - before
        if size > 1:
            rise += end - start
        return rise * (self.reach / (2 * size))


def halved(values: torch.Tensor, axis: int) -> torch.Tensor:
    """Means of two neighbours along an axis; one that is left over at its end stays."""
    import torch

    lines = values.transpose(axis, -1)
    even, odd = lines[..., ::2], lines[..., 1::2]
    count = odd.shape[-1]
    found = torch.add(even[..., :count], odd).mul_(0.5)
    if even.shape[-1] > count:
        found = torch.cat([found, even[..., count:]], dim=-1)
    return found.transpose(axis, -1)


def extended(values: torch.Tensor, axis: int) -> torch.Tensor:
    """Values with one more at either end of an axis, on the line through the two at that end."""
    import torch

    last = values.shape[axis] - 1
    ends = [
        2 * values.narrow(axis, end, 1) - values.narrow(axis, inner, 1)
        for end, inner in ((0, min(1, last)), (last, max(last - 1, 0)))
    ]
    return torch.cat([ends[0], values, ends[1]], dim=axis)


def pixel_place(width_px: int, height_px: int, position_bands: int = 0) -> np.ndarray:
    """Normalised (u, v) of every pixel, -1 to 1 over the image, and their positional encoding;
    float32, shape [h, w, 2 + 4 * position_bands]."""
    u = np.linspace(-1, 1, width_px, dtype=np.float32)
    v = np.linspace(-1, 1, height_px, dtype=np.float32)
    uv = np.stack(np.meshgrid(u, v), axis=-1)
    if not position_bands:
        return uv
    return np.concatenate([uv, encode_position(uv, position_bands)], axis=-1, dtype=np.float32)


def _average(
    values: torch.Tensor,
    sigma_px: float,
    mask: torch.Tensor | None,
    cover: dict[float, torch.Tensor],
) -> torch.Tensor:
    """Gaussian average over the unmasked pixels, shape [..., h, w]; 0 where a window holds next to
    none."""
    import torch

    if mask is None or bool(mask.all()):
        return values if sigma_px <= 0 else gaussian_average(values, sigma_px)
    weight = mask.to(values.dtype)
    if sigma_px <= 0:
        return values * weight
    if sigma_px not in cover:
        cover[sigma_px] = gaussian_average(weight, sigma_px)
    share = cover[sigma_px]
    total = gaussian_average(torch.where(mask, values, 0.0), sigma_px)
    return torch.where(share > MIN_COVER, total / share.clamp(min=MIN_COVER), 0.0)
