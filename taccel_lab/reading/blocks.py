# SPDX-License-Identifier: Apache-2.0
"""Which pixels of an image are read one by one, and which by blocks.

A network reads a block of pixels as it reads a pixel: by the mean of their features, which are
linear in the colours. Where the surface goes on smoothly, that and a line between the middles of
blocks lose next to nothing, at a sixty-fourth of the work; noise is averaged before a network bends
it instead of after. So every image is read in blocks of 8 x 8 pixels first, and in smaller ones,
down to a pixel or to 2 x 2 of them (``finest_px``), where the slopes that were read bend, where
colours vary inside a block, and beside masked pixels. Only the part of the image that holds such
places is looked at again. Slow sinking beside a contact is read as all else.

Both limits rise with what a quarter of the image stays below, which is noise: there is nothing to
be seen in it.

Tilts that networks give where nothing has changed are taken off what they give for an image. They
are the same for all images of a sensor: each place is asked for once, by all readers of a profile.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.geometry import PixelGrid
from taccel_lab.networks.normal_settings import NormalModelConfig
from taccel_lab.reading.features import LEVELS_PER_UNIT, Blocks, FeatureWindows
from taccel_lab.reading.room import room
from taccel_lab.reading.windows import halved

if TYPE_CHECKING:
    import torch

    from taccel_lab.reading.room import Room

LARGEST_PX = 8
"""Pixels along the largest blocks."""
FINEST_CELL_PX = 2
"""Cells of colours that fine texture is looked for in: a lens shows none that is finer."""
FINEST_MM = 0.08
"""Largest side of blocks that are read in place of single pixels. By blocks of 0.06 mm presses are
0.005 mm less deep at most, 0.03 of their standard deviation, and contact areas 1 % larger; blocks
of 0.12 mm smear edges, and areas are 4 to 8 % larger."""
BEND = 0.035
"""Second difference of the slope between neighbouring blocks from which on smaller ones are read.
Presses of three sensors (RVSATHU, FOTS, Taxim) are then read as by all pixels to 0.003 mm."""
TEXTURE_LEVELS = 1.0
"""Likewise, of the root mean square of what a block's colours differ by from a line between
blocks."""
OVER_NOISE = 3.0
"""Both limits are at least this multiple of what a quarter of the blocks stays below,"""
MOST_NOISE = 2.0
"""but no more than this multiple of what they are without noise: a press may fill an image."""
QUIET = 0.25

Answer = Callable[[Blocks, "torch.Tensor | None"], "torch.Tensor"]
"""What is read, shape [value, n], of blocks counted along images, rows and columns (all when None):
two tilts [rad] first."""


@dataclass(frozen=True)
class Patch:
    """What is read of a part of the images, by blocks."""

    block_px: int
    rows: slice
    columns: slice
    """Which of the images' blocks these are."""
    values: torch.Tensor
    """Shape [value, image, h, w]."""


def finest_px(grid: PixelGrid) -> int:
    """Pixels along the smallest blocks that images of a grid need be read by: 1 or 2."""
    return 2 if 2 * max(grid.mm_per_px_x, grid.mm_per_px_y) <= FINEST_MM else 1


def read_in_blocks(
    windows: FeatureWindows,
    answer: Answer,
    slopes: Callable[[torch.Tensor], torch.Tensor],
    around: torch.Tensor | None = None,
    every: int = 1,
) -> list[Patch]:
    """Readings of images by blocks: of whole images by the largest ones, then of parts of them by
    ones half as wide as before, each inside the one before.

    Args:
        windows: Windows of the images.
        answer: Reads blocks.
        slopes: Of tilts, both of shape [2, image, h, w].
        around: Largest blocks that smaller ones may be read in, bool, shape [h, w]; all when None.
        every: Pixels along the smallest blocks.
    """
    blocks = windows.blocks(LARGEST_PX)
    found = answer(blocks, None).unflatten(1, blocks.shape)
    patches = [Patch(LARGEST_PX, blocks.rows, blocks.columns, found)]
    if around is not None and not bool(around.any()):
        return patches
    uneven = _uneven(windows)
    flags, limit = around, None
    while patches[-1].block_px > every:
        patch = patches[-1]
        part = (..., patch.rows, patch.columns)
        bend = _bend(slopes(patch.values[:2]))
        limit = _limit(bend, BEND) if limit is None else limit
        masked = _any_masked(windows, patch.block_px)
        # Lines from a block's middle reach into those beside it.
        beside = _widened(bend > limit if masked is None else (bend > limit) | masked[part])
        beside |= uneven[patch.block_px][part]
        flags = beside if flags is None else beside & flags
        finer = _finer(windows, answer, patch, flags)
        if finer is None:
            break
        patch, flags = finer
        patches.append(patch)
    return patches


def read_in_room(
    windows: FeatureWindows,
    answer: Answer,
    around: torch.Tensor | None,
    here: Room,
    every: int = 1,
) -> torch.Tensor:
    """Maps that ``painted`` makes of ``read_in_blocks`` for each image by itself, in sizes that do
    not follow the images: smaller blocks are picked into as many places as there is room for, and
    maps are of whole images, whose parts lie where flags are set."""
    import torch

    from taccel_lab.reading import fixed_blocks as kernels

    blocks = windows.sparse(LARGEST_PX)
    maps = [answer(blocks, None).unflatten(1, blocks.shape)]
    energy, uneven, size = None, {}, FINEST_CELL_PX
    while size < LARGEST_PX:
        energy = kernels.textures(windows.packed(size), windows.packed(2 * size), energy)
        size, texture = 2 * size, energy.sqrt()
        uneven[size] = texture, _limit(texture, TEXTURE_LEVELS / LEVELS_PER_UNIT)
    uneven[FINEST_CELL_PX] = uneven[2 * FINEST_CELL_PX]
    flags, limit = None if around is None else around[None].view(torch.uint8), None
    levels = (LARGEST_PX // every).bit_length() - 1
    spans = torch.zeros((levels, blocks.shape[0], 4), dtype=torch.int32, device=maps[0].device)
    for span in spans:
        bend = kernels.bends(maps[-1][:2])
        limit = _limit(bend, BEND) if limit is None else limit
        masked = None if windows.mask is None else _any(~windows.mask, size)[0]
        flags = kernels.flags_beside((bend, limit), masked, uneven[size], flags, span)
        size //= 2
        shape = blocks.shape[0], *windows.count(size)
        # What is picked past the last block goes to one more place, which nobody reads.
        found = bend.new_empty((len(maps[0]), math.prod(shape) + 1))
        lines = found[:, :-1].unflatten(1, shape)
        mask = None if windows.mask is None else _any(windows.mask, size)[0]
        flags, picked = kernels.finer_maps(maps[-1], flags, span, mask, lines)
        here.counted = picked.sum()
        wanted = here.size(f"blocks of {size} px", here.counted, picked.numel())
        at = torch.nonzero_static(picked.flatten(), size=wanted, fill_value=picked.numel())[:, 0]
        found.index_copy_(1, at, answer(windows.sparse(size), at))
        maps.append(lines)
    here.counted = None
    return kernels.painted_parts(maps, spans, windows.count(every), every)


def _finer(
    windows: FeatureWindows, answer: Answer, patch: Patch, flags: torch.Tensor
) -> tuple[Patch, torch.Tensor] | None:
    """The part of a patch around its flags [image, h, w], by blocks half as wide, and the flags of
    these; None without a flag. Those that are not flagged lie on lines between the patch's."""
    parts = _flagged(flags)
    if parts is None:
        return None
    size = patch.block_px // 2
    # Lines go to the next block.
    wide = [slice(max(part.start - 1, 0), part.stop + 1) for part in parts]
    rows, columns = (
        slice(2 * (span.start + part.start), min(2 * (span.start + part.stop), count))
        for span, part, count in zip(
            (patch.rows, patch.columns), parts, windows.count(size), strict=True
        )
    )
    found = enlarged(patch.values[..., wide[0], wide[1]], 2)
    height, width = rows.stop - rows.start, columns.stop - columns.start
    top, left = (2 * (part.start - outer.start) for part, outer in zip(parts, wide, strict=True))
    found = found[..., top : top + height, left : left + width].contiguous()
    flags = _doubled(flags[..., parts[0], parts[1]])[..., :height, :width]
    picked = flags
    if windows.mask is not None:
        picked = flags & _any(windows.mask, size)[..., rows, columns]
    picked = picked.flatten().nonzero()[:, 0]
    if len(picked):
        blocks = windows.blocks(size, rows, columns)
        found.flatten(1)[:, picked] = answer(blocks, picked)
    return Patch(size, rows, columns, found), flags


def _flagged(flags: torch.Tensor) -> tuple[slice, slice] | None:
    """Rows and columns of the flags [image, h, w] that are set, with one beside them."""
    spans = []
    for axis, count in ((2, flags.shape[1]), (1, flags.shape[2])):
        at = flags.any(dim=0).any(dim=axis - 1).nonzero()[:, 0]
        if not len(at):
            return None
        spans.append(slice(max(int(at[0]) - 1, 0), min(int(at[-1]) + 2, count)))
    return spans[0], spans[1]


def _doubled(flags: torch.Tensor) -> torch.Tensor:
    """Flags of blocks, [..., h, w], on blocks half as wide."""
    return flags.repeat_interleave(2, dim=-1).repeat_interleave(2, dim=-2)


def painted(patches: Sequence[Patch], shape: tuple[int, int], every: int = 1) -> torch.Tensor:
    """What is read of every pixel, or every so many along both axes, along lines between the
    middles of the finest blocks there are, shape [value, image, h, w]; ``shape``: their rows and
    columns."""
    times = patches[0].block_px // every
    whole = enlarged(patches[0].values, times)[..., : shape[0], : shape[1]]
    for patch in patches[1:]:
        times = patch.block_px // every
        spans = patch.rows, patch.columns
        rows, columns = (slice(span.start * times, span.stop * times) for span in spans)
        part = whole[..., rows, columns]
        part.copy_(enlarged(patch.values, times)[..., : part.shape[-2], : part.shape[-1]])
    return whole


def enlarged(values: torch.Tensor, times: int) -> torch.Tensor:
    """Maps, shape [..., h, w], of blocks ``times`` times smaller, along lines through the middles
    of blocks, which go on beyond the outermost ones."""
    if times == 1:
        return values
    rows, columns = (
        _lines(values.shape[axis], times, values.dtype, values.device) for axis in (-2, -1)
    )
    return rows @ (values @ columns.T)


@lru_cache(maxsize=256)
def _lines(count: int, times: int, dtype: torch.dtype, device: torch.device) -> torch.Tensor:
    """Weights of the blocks of an axis in ones ``times`` times smaller, [count * times, count]."""
    import torch

    at = (np.arange(count * times) + 0.5) / times - 0.5
    before = np.clip(np.floor(at).astype(int), 0, max(count - 2, 0))
    weights = np.zeros((len(at), count))
    weights[np.arange(len(at)), before] = 1.0
    if count > 1:
        weights[np.arange(len(at)), before] -= at - before
        weights[np.arange(len(at)), before + 1] = at - before
    return torch.as_tensor(weights, dtype=dtype, device=device)


def _any_masked(windows: FeatureWindows, block_px: int) -> torch.Tensor | None:
    """Blocks in which a pixel is masked, bool, shape [1, h, w]; None where none is."""
    return None if windows.mask is None else _any(~windows.mask, block_px)


def _any(flags: torch.Tensor, block_px: int) -> torch.Tensor:
    """Blocks in which a flag [h, w] is set, shape [1, h, w]."""
    import torch

    pool = torch.nn.functional.max_pool2d
    return pool(flags.float()[None], block_px, ceil_mode=True) > 0


def _bend(slopes: torch.Tensor) -> torch.Tensor:
    """Largest second difference of slopes [2, image, h, w] along an axis, shape [image, h, w]."""
    import torch

    padded = torch.nn.functional.pad(slopes, (1, 1, 1, 1), mode="replicate")
    middle = 2 * slopes
    along = (padded[..., 1:-1, 2:] + padded[..., 1:-1, :-2] - middle).abs()
    down = (padded[..., 2:, 1:-1] + padded[..., :-2, 1:-1] - middle).abs()
    return torch.maximum(along, down).amax(dim=0)


def _uneven(windows: FeatureWindows) -> dict[int, torch.Tensor]:
    """Blocks of each size whose colours vary inside them, bool, shape [image, h, w]; of those that
    are no larger than the finest cells, all that lie in larger ones."""
    found: dict[int, torch.Tensor] = {}
    energy, size = None, FINEST_CELL_PX
    while size < LARGEST_PX:
        fine, coarse = windows.colors(size), windows.colors(2 * size)
        off = fine - enlarged(coarse, 2)[..., : fine.shape[-2], : fine.shape[-1]]
        if windows.mask is not None:
            off = off * windows.cover(size)
        own = halved(halved(off.square_().mean(dim=0), -2), -1)
        energy = own if energy is None else own + halved(halved(energy, -2), -1)
        size *= 2
        texture = energy.sqrt()
        found[size] = texture > _limit(texture, TEXTURE_LEVELS / LEVELS_PER_UNIT)
    height, width = windows.count(FINEST_CELL_PX)
    found[FINEST_CELL_PX] = _doubled(found[2 * FINEST_CELL_PX])[..., :height, :width]
    return found


def _limit(values: torch.Tensor, least: float) -> torch.Tensor:
    """Limits above noise, of values [image, h, w], shape [image, 1, 1]."""
    flat = values.flatten(1)
    quiet = flat.kthvalue(max(1, round(QUIET * flat.shape[1])), dim=1).values
    return (OVER_NOISE * quiet).clamp(least, MOST_NOISE * least)[:, None, None]


def _widened(flags: torch.Tensor) -> torch.Tensor:
    """Flags [image, h, w] and their neighbours."""
    import torch

    return torch.nn.functional.max_pool2d(flags.float()[None], 3, stride=1, padding=1)[0] > 0


class TiltsAtRest:
    """What the members of a model give for unchanged places, each asked for once."""

    def __init__(self, config: NormalModelConfig, block_px: int, device: str) -> None:
        import torch

        count = -(-config.height_px // block_px) * -(-config.width_px // block_px)
        self._tilts = torch.zeros((config.members, count, 2), device=device)
        self._asked = torch.zeros(count, dtype=torch.bool, device=device)
        self._whole = False

    def of_all(
        self, known: torch.Tensor, varying: int, ask: Callable[[torch.Tensor], torch.Tensor]
    ) -> None:
        """Ask for all places by what they know (``Blocks.known``), besides ``varying`` features of
        a change."""
        import torch

        here = room()
        if not self._whole and here is not None:
            flat, counted, here.counted = known.flatten(1), here.counted, None
            self._tilts = ask(torch.cat([flat.new_zeros((varying, flat.shape[1])), flat]))
            here.counted = counted
            self._asked.fill_(True)
            self._whole = True

    def at(
        self,
        places: torch.Tensor,
        features: torch.Tensor,
        ask: Callable[[torch.Tensor], torch.Tensor],
    ) -> torch.Tensor:
        """Tilts of places [n], shape [member, n, 2]; ``ask`` gives those of features [feature, n],
        which belong to the places."""
        if self._whole:
            return self._tilts.index_select(1, places)
        new = (~self._asked[places]).nonzero()[:, 0]
        if len(new):
            self._tilts[:, places[new]] = ask(features.index_select(1, new))
            self._asked[places[new]] = True
        return self._tilts.index_select(1, places)


@lru_cache(maxsize=16)
def tilts_at_rest(
    config: NormalModelConfig, weights_sha256: bytes, block_px: int, device: str
) -> TiltsAtRest:
    """Tilts at rest of a model by blocks of so many pixels, kept from one reader of a profile to
    the next."""
    return TiltsAtRest(config, block_px, device)
