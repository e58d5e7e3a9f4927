# SPDX-License-Identifier: Apache-2.0
"""Which pixels of an image are read one by one, and which by blocks.

A network reads a block of pixels as it reads a pixel: by the mean of their features, which are
linear in the colours. Where the surface goes on smoothly, that and a line between the middles of
blocks lose next to nothing, at a sixteenth of the work; noise is averaged before a network bends it
instead of after. So every image is read in blocks of 4 x 4 pixels first, and in smaller ones, down
to the pixel, where the slopes that were read bend, where colours vary inside a block, and beside
masked pixels. Slow sinking beside a contact is read as all else.

Both limits rise with what a quarter of the image stays below, which is noise: there is nothing to
be seen in it.

What networks from colours to normals give where nothing has changed.

It is taken off what they give for an image, and is the same for all images of a sensor: each place
is asked for once, also by readers that are made anew for every image.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING

from taccel_lab.networks.normal_settings import NormalModelConfig
from taccel_lab.reading.features import LEVELS_PER_UNIT, FeatureWindows, extended

if TYPE_CHECKING:
    import torch

HALVINGS = 2
"""Halvings from pixels to the largest blocks, of 4 x 4 of them."""
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

Answer = Callable[[int, FeatureWindows, "torch.Tensor | None"], "torch.Tensor"]
"""What is read, shape [value, n], of blocks counted along images, rows and columns (all when None):
two tilts [rad] first. The number is that of halvings from pixels."""


def read_in_blocks(
    pixels: FeatureWindows,
    answer: Answer,
    slopes: Callable[[torch.Tensor], torch.Tensor],
    narrowest: slice,
    mask: torch.Tensor | None = None,
) -> torch.Tensor:
    """What is read of every pixel, shape [value, image, h, w].

    Args:
        pixels: Windows of the images, by pixels.
        answer: Reads blocks.
        slopes: Of tilts, both of shape [2, image, h, w].
        narrowest: The channels of ``pixels.averages`` that show most of the texture, free of most
            noise.
        mask: Pixels that count, bool, shape [h, w]; what stands in the others means nothing.
    """
    import torch

    levels = [pixels]
    for _ in range(HALVINGS):
        levels.append(levels[-1].halved())
    colors = [level.averages[narrowest] for level in levels]
    found = answer(HALVINGS, levels[-1], None).unflatten(1, levels[-1].shape)
    kept = _kept(pixels, mask)
    finer = torch.ones_like(found[0], dtype=torch.bool)
    limit = None
    for k in range(HALVINGS, 0, -1):
        bend = _bend(slopes(found[:2]))
        limit = _limit(bend, BEND) if limit is None else limit
        texture = _texture(colors[0], colors[k], 2**k)
        uneven = texture > _limit(texture, TEXTURE_LEVELS / LEVELS_PER_UNIT)
        # Lines from a block's middle reach into those beside it.
        beside = _widened((bend > limit) | _any(~kept, 2**k, bend.shape))
        level = levels[k - 1]
        finer = doubled(finer & (beside | uneven), level.shape)
        found = doubled(found, level.shape)
        chosen = finer & _any(kept, 2 ** (k - 1), level.shape)
        picked = chosen.flatten().nonzero()[:, 0]
        if len(picked):
            found.flatten(1)[:, picked] = answer(k - 1, level, picked)
    return found


def doubled(values: torch.Tensor, shape: Sequence[int]) -> torch.Tensor:
    """Maps, shape [..., image, h, w], of blocks half as wide: flags as they are, values along lines
    through the middles of blocks; ``shape`` is (image, h, w) of those."""
    import torch

    if values.dtype == torch.bool:
        found = values.repeat_interleave(2, dim=-1).repeat_interleave(2, dim=-2)
    else:
        found = _between(values.reshape(-1, *values.shape[-3:]), 2)
        found = found.reshape(*values.shape[:-3], *found.shape[-3:])
    return found[..., : shape[-2], : shape[-1]].contiguous()


def _between(values: torch.Tensor, times: int) -> torch.Tensor:
    """Maps, shape [n, image, h, w], of blocks ``times`` times smaller."""
    import torch

    lines = extended(extended(values, -1), -2)
    found = torch.nn.functional.interpolate(lines, scale_factor=times, mode="bilinear")
    return found[..., times:-times, times:-times]


def _kept(pixels: FeatureWindows, mask: torch.Tensor | None) -> torch.Tensor:
    """Pixels that count, filled up to whole largest blocks with others, bool, shape [1, h, w]."""
    import torch

    _, height, width = pixels.shape
    size = 2**HALVINGS
    kept = pixels.averages.new_ones((1, height, width)) if mask is None else mask.float()[None]
    return torch.nn.functional.pad(kept, (0, -width % size, 0, -height % size)) > 0


def _any(flags: torch.Tensor, times: int, shape: Sequence[int]) -> torch.Tensor:
    """Blocks, ``times`` pixels wide, in which a flag [1, height_px, width_px] is set, [1, h, w] of
    ``shape``."""
    import torch

    blocks = torch.nn.functional.max_pool2d(flags.float(), times) > 0
    return blocks[:, : shape[-2], : shape[-1]]


def _bend(slopes: torch.Tensor) -> torch.Tensor:
    """Largest second difference of slopes [2, image, h, w] along an axis, shape [image, h, w]."""
    import torch

    padded = torch.nn.functional.pad(slopes, (1, 1, 1, 1), mode="replicate")
    middle = 2 * slopes
    along = (padded[..., 1:-1, 2:] + padded[..., 1:-1, :-2] - middle).abs()
    down = (padded[..., 2:, 1:-1] + padded[..., :-2, 1:-1] - middle).abs()
    return torch.maximum(along, down).amax(dim=0)


def _texture(fine: torch.Tensor, coarse: torch.Tensor, times: int) -> torch.Tensor:
    """Root mean square over each block of what its pixels' colours [3, image, h, w] differ by from
    a line between blocks, shape [image, h, w] of ``coarse``."""
    import torch

    height, width = fine.shape[-2:]
    off = fine - _between(coarse, times)[..., :height, :width]
    pool = torch.nn.functional.avg_pool2d
    return pool(off.square().mean(dim=0), times, ceil_mode=True).sqrt()


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

    def __init__(self, config: NormalModelConfig, halvings: int, device: str) -> None:
        import torch

        size = 2**halvings
        count = -(-config.height_px // size) * -(-config.width_px // size)
        self._tilts = torch.zeros((config.members, count, 2), device=device)
        self._asked = torch.zeros(count, dtype=torch.bool, device=device)

    def at(
        self,
        places: torch.Tensor,
        features: torch.Tensor,
        ask: Callable[[torch.Tensor], torch.Tensor],
    ) -> torch.Tensor:
        """Tilts of places [n], shape [member, n, 2]; ``ask`` gives those of features [feature, n],
        which belong to the places."""
        new = (~self._asked[places]).nonzero()[:, 0]
        if len(new):
            self._tilts[:, places[new]] = ask(features.index_select(1, new))
            self._asked[places[new]] = True
        return self._tilts.index_select(1, places)


@lru_cache(maxsize=4)
def tilts_at_rest(
    config: NormalModelConfig, weights_sha256: bytes, device: str
) -> tuple[TiltsAtRest, ...]:
    """Tilts at rest of a model, by pixels and by blocks, kept from one reader of a profile to the
    next."""
    return tuple(TiltsAtRest(config, halvings, device) for halvings in range(HALVINGS + 1))
