# SPDX-License-Identifier: Apache-2.0
"""What the inverse model sees of each pixel: how its colour changed, at several scales.

One pixel's colour change does not tell the normal well: noise and lens blur hide it, and two
normals may give one colour. So each pixel brings the change averaged over Gaussian windows, and
how that average varies across the wider of them. The features scale with the picture: a zoomed
picture has the same features at scales zoomed as much, and the same normals. Training on several
zooms therefore shows balls of other sizes than the one that was pressed, and keeps a model from
learning that single ball's curvature by heart.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.networks.normal_settings import NormalModelConfig
from taccel_lab.networks.settings import encode_position
from taccel_lab.reading.room import room
from taccel_lab.reading.windows import axis_windows, cell_of, halved
from taccel_lab.signals.tensors import Array, as_given, tensor_of

if TYPE_CHECKING:
    import torch

LEVELS_PER_UNIT = 32.0
"""Levels of 255 that make one unit of a feature."""
MIN_COVER = 1e-3
"""Share of a window that has to be unmasked for its average to count."""


def color_change(image: Array, background: Array, mask: Array | None = None) -> Array:
    """Image minus background [levels], float32, 0 where ``mask`` is false, shape [..., h, w, 3]."""
    given = tensor_of(image)
    change = (given.float() if given.is_floating_point() else given) - tensor_of(background).float()
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
    windows = FeatureWindows(
        tensor_of(change)[None],
        scales_px,
        slope_scales_px,
        lambda block_px: place_of_blocks(place, block_px),
        mask=None if mask is None else tensor_of(mask),
        background=None if background is None else tensor_of(background),
        zoom=zoom,
    )
    found = windows.blocks(1).features(None if picked is None else tensor_of(picked)).T
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
class Blocks:
    """Features of square blocks of pixels in a part of one or several images.

    Features are linear in the change, so that those of a block are the means of its pixels'. Blocks
    at the right and lower border of an image may be cut off there.
    """

    block_px: int
    """Pixels along a block."""
    rows: slice
    columns: slice
    """Which of the images' blocks these are."""
    changing: torch.Tensor
    """Averages of the change [units], then the wider windows' variation along columns and rows over
    the window's width, for each scale, shape [3 scale + 6 slope scale, image, h, w]."""
    known: torch.Tensor
    """What they know without the change: background and place, shape [n, h, w]."""

    @property
    def shape(self) -> torch.Size:
        """Images, rows and columns of blocks."""
        return self.changing.shape[1:]

    def features(self, picked: torch.Tensor | None = None) -> torch.Tensor:
        """Features of blocks, counted along images, rows and columns, shape [feature, n]; of all
        when None."""
        import torch

        changing, known = self.changing.flatten(1), self.known.flatten(1)
        if picked is None:
            return torch.cat([changing, known.repeat(1, self.shape[0])])
        place = picked % known.shape[1]
        return torch.cat([changing.index_select(1, picked), known.index_select(1, place)])


@dataclass(frozen=True)
class SparseBlocks(Blocks):
    """Blocks of whole images whose features are found one by one, where few are picked: there are
    no maps of all (``changing`` has a shape, but no values)."""

    windows: FeatureWindows

    def features(self, picked: torch.Tensor | None = None) -> torch.Tensor:
        """The same; what is picked past the last block stands for none, and its features are
        any."""
        import torch

        from taccel_lab.reading.fixed_windows import features_of_blocks

        known = self.known.flatten(1)
        if picked is None:
            picked = torch.arange(self.shape.numel(), device=known.device)
        return features_of_blocks(self.windows, self.block_px, known, picked)


class FeatureWindows:
    """Windows of the changes of one or several images, for blocks of any size."""

    def __init__(
        self,
        change: torch.Tensor,
        scales_px: Sequence[float],
        slope_scales_px: Sequence[float],
        place: Callable[[int], torch.Tensor],
        *,
        mask: torch.Tensor | None = None,
        background: torch.Tensor | None = None,
        zoom: float = 1.0,
        light: torch.Tensor | None = None,
    ) -> None:
        """Windows of changes [levels] of shape [image, h, w, 3], or of images that change from
        ``light`` [h, w, 3]; ``place`` tells what blocks of so many pixels know of theirs, shape
        [n, h, w]; the rest as of ``local_features``."""
        here = room() is None
        self.mask = None if mask is None or (here and bool(mask.all())) else mask
        self._seen, self._light = change, light
        self.scales = tuple(scale * zoom for scale in scales_px)
        self.varied = tuple(scale * zoom for scale in slope_scales_px)
        self._place, self._under = place, None
        if background is not None:
            widest = max([*scales_px, *slope_scales_px])
            self._under = FeatureWindows(background[None], (widest,), (), place, mask=self.mask)
        self._cells: dict[int, torch.Tensor] = {}
        self._kept: dict[int, torch.Tensor] = {}
        self._packed: dict[int, torch.Tensor] = {}

    @cached_property
    def _units(self) -> torch.Tensor:
        seen = self._seen if self._light is None else color_change(self._seen, self._light)
        units = seen.float() / LEVELS_PER_UNIT
        return units if self.mask is None else units.where(self.mask[..., None], 0.0)

    @property
    def size(self) -> tuple[int, int, int]:
        """Images, rows and columns of pixels."""
        images, height, width, _ = self._seen.shape
        return images, height, width

    def packed(self, cell_px: int) -> torch.Tensor:
        """``cells``, and ``cover``, of each in one place, shape [image, h, w, 4]."""
        from taccel_lab.reading.fixed_windows import halved_cells, packed_cells

        if cell_px not in self._packed:
            if cell_px == 1:
                seen, light = self._seen, self._light
                light = seen.new_zeros(seen.shape[1:]) if light is None else light
                found = packed_cells(seen, light, self.mask, 1.0 / LEVELS_PER_UNIT)
            else:
                found = halved_cells(self.packed(cell_px // 2))
            self._packed[cell_px] = found
        return self._packed[cell_px]

    def count(self, block_px: int) -> tuple[int, int]:
        """Rows and columns of blocks."""
        _, height, width = self.size
        return -(-height // block_px), -(-width // block_px)

    def cells(self, cell_px: int) -> torch.Tensor:
        """Mean changes [units] of cells of so many pixels, a power of 2, masked ones as 0, shape
        [3, image, h, w]."""
        if cell_px not in self._cells:
            if cell_px == 1:
                found = self._units.movedim(-1, 0)
            elif cell_px == 2:
                found = halved(halved(self._units, 1), 2).movedim(-1, 0).contiguous()
            else:
                found = halved(halved(self.cells(cell_px // 2), -2), -1)
            self._cells[cell_px] = found
        return self._cells[cell_px]

    def colors(self, cell_px: int) -> torch.Tensor:
        """The same of what counts in each cell; 0 where nothing does."""
        found = self.cells(cell_px)
        return found if self.mask is None else found / self.cover(cell_px).clamp(min=MIN_COVER)

    def cover(self, cell_px: int) -> torch.Tensor:
        """Part of each cell that counts, shape [h, w]."""
        assert self.mask is not None
        if cell_px not in self._kept:
            found = self.mask.float()
            if cell_px > 1:
                found = halved(halved(self.cover(cell_px // 2), -2), -1)
            self._kept[cell_px] = found
        return self._kept[cell_px]

    def blocks(
        self, block_px: int, rows: slice | None = None, columns: slice | None = None
    ) -> Blocks:
        """Blocks of so many pixels, a power of 2, in these rows and columns of them; all when
        None."""
        import torch

        height, width = self.count(block_px)
        rows, columns = rows or slice(0, height), columns or slice(0, width)
        means: dict[float, torch.Tensor] = {}
        changes: dict[float, torch.Tensor] = {}
        for scales in self._alike(block_px):
            if scales == (0.0,) and self.mask is None:
                means[0.0] = self.cells(block_px)[..., rows, columns]
                continue
            varied = tuple(scale for scale in scales if scale in self.varied)
            found, along = self._windowed(scales, varied, block_px, rows, columns)
            means |= zip(scales, found, strict=True)
            changes |= zip(varied, along, strict=True)
        parts = [means[scale] for scale in self.scales]
        changing = torch.cat([*parts, *(changes[scale] for scale in self.varied)])
        return Blocks(block_px, rows, columns, changing, self._known(block_px, rows, columns))

    def sparse(self, block_px: int) -> SparseBlocks:
        """All blocks of so many pixels, of which few are picked."""
        import torch

        rows, columns = (slice(0, count) for count in self.count(block_px))
        features = 3 * len(self.scales) + 6 * len(self.varied)
        shape = features, self.size[0], rows.stop, columns.stop
        known = self._known(block_px, rows, columns)
        empty = torch.empty(shape, device="meta")
        return SparseBlocks(block_px, rows, columns, empty, known, self)

    def _known(self, block_px: int, rows: slice, columns: slice) -> torch.Tensor:
        import torch

        known = self._place(block_px)[:, rows, columns]
        if self._under is None:
            return known
        return torch.cat([self._under.blocks(block_px, rows, columns).changing[:, 0], known])

    def _alike(self, block_px: int) -> list[tuple[float, ...]]:
        """Windows that take cells of the same size."""
        found: dict[tuple[int, bool], list[float]] = {}
        for scale in sorted({*self.scales, *self.varied}):
            found.setdefault((cell_of(scale, block_px), scale > 0), []).append(scale)
        return [tuple(scales) for scales in found.values()]

    def _windowed(
        self,
        scales: tuple[float, ...],
        varied: tuple[float, ...],
        block_px: int,
        rows: slice,
        columns: slice,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Averages in windows that take the same cells, shape [window, 3, image, h, w], and of some
        their variation over the window along columns and rows, shape [varied, 6, image, h, w]."""
        import torch

        cell_px = cell_of(scales[-1], block_px)
        values = self.cells(cell_px)
        _, height, width = self.size
        device, masked = values.device, self.mask is not None
        down, across = (
            axis_windows(count, scales, varied, block_px, masked, device).part(part)
            for count, part in ((height, rows), (width, columns))
        )
        at = [scales.index(scale) for scale in varied]
        varies = slice(at[0], at[-1] + 1) if at else slice(0, 0)

        def seen(values: torch.Tensor, beside: Sequence[torch.Tensor]) -> list[torch.Tensor]:
            """Averages of maps [n, h, w] over blocks, and what ``beside`` tells along rows and
            columns, each of shape [n, window, h, w]."""
            values = values[:, down.cells, across.cells]
            means = _by_rows(down.means, values)
            found = [means @ across.means.mT]
            if at:
                found.append(means[:, varies] @ beside[1].mT)
                found.append(_by_rows(beside[0], values) @ across.means[varies].mT)
            return found

        maps = values.flatten(0, 1)
        if not masked:
            found = seen(maps, (down.changes, across.changes))
        else:
            cover = seen(self.cover(cell_px)[None], (down.borders, across.borders))
            sums = seen(maps, (down.borders, across.borders))
            found = [
                torch.where(share > MIN_COVER, total / share.clamp(min=MIN_COVER), 0.0)
                for total, share in zip(sums, cover, strict=True)
            ]
            if at:
                found[1] = found[1].diff(dim=-1) * across.across[:, None]
                found[2] = found[2].diff(dim=-2) * down.across[..., None]
        found = [each.unflatten(0, values.shape[:2]).movedim(2, 0) for each in found]
        return found[0], torch.cat(found[1:], dim=1) if at else found[0][:0]


def _by_rows(weights: torch.Tensor, values: torch.Tensor) -> torch.Tensor:
    """Weighted sums over rows of maps [n, h, w], for weights [window, block, h], shape
    [n, window, block, w]: one product a map."""
    import torch

    flat = weights.flatten(0, 1).expand(len(values), -1, -1)
    return torch.bmm(flat, values).unflatten(1, weights.shape[:2])


def place_of_blocks(place: Any, block_px: int) -> torch.Tensor:
    """Mean of what pixels know of their place, shape [h, w, n], over blocks of so many pixels, a
    power of 2, shape [n, h, w]."""
    found = tensor_of(place).movedim(-1, 0)
    while block_px > 1:
        found, block_px = halved(halved(found, -2), -1), block_px // 2
    return found


def of_blocks(values: Array, block_px: int) -> Array:
    """Means of a map, shape [h, w] or [h, w, n], over blocks of so many pixels."""
    import torch

    whole = tensor_of(values, torch.float32)
    found = place_of_blocks(whole if whole.ndim == 3 else whole[..., None], block_px)
    return as_given(found.movedim(0, -1) if whole.ndim == 3 else found[0], values)


def pixel_place(width_px: int, height_px: int, position_bands: int = 0) -> np.ndarray:
    """Normalised (u, v) of every pixel, -1 to 1 over the image, and their positional encoding;
    float32, shape [h, w, 2 + 4 * position_bands]."""
    u = np.linspace(-1, 1, width_px, dtype=np.float32)
    v = np.linspace(-1, 1, height_px, dtype=np.float32)
    uv = np.stack(np.meshgrid(u, v), axis=-1)
    if not position_bands:
        return uv
    return np.concatenate([uv, encode_position(uv, position_bands)], axis=-1, dtype=np.float32)
