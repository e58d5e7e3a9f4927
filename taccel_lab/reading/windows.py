# SPDX-License-Identifier: Apache-2.0
"""Gaussian windows of pictures, read in blocks of pixels, on any device.

A window's average over a block, and its value at the border between two blocks, are linear in the
picture, along rows and along columns by themselves: each is one small matrix an axis. Blocks are
therefore read without a pass over the pixels at all windows.

A wide window hardly tells the pixels within a cell of a part of its width from a parabola through
the means of that cell and of those beside it. So wide windows take means of cells, no wider than
their standard deviation, and only narrow ones the pixels: a pyramid of pictures (P. J. Burt and E.
H. Adelson, IEEE Trans. Communications 31(4), 1983). Presses then have the features that pixels give
to 0.01 levels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import torch

CUT_SIGMAS = 3.0
"""A window ends here."""
LARGEST_CELL_PX = 16
NOTHING = 1e-9
"""Weight of a cell that a window does not reach, but for rounding."""


def cell_of(sigma_px: float, block_px: int) -> int:
    """Pixels along the cells, a power of 2, that a window takes: all of a block for the pixels
    themselves (0)."""
    if sigma_px <= 0:
        return block_px
    # A block's mean is a window by itself.
    width = math.hypot(sigma_px, math.sqrt((block_px**2 - 1) / 12))
    cell = 1
    while 2 * cell <= min(width, LARGEST_CELL_PX):
        cell *= 2
    return cell


@dataclass(frozen=True)
class AxisWindows:
    """Windows along one axis that take cells of one size: from cells to blocks."""

    means: torch.Tensor
    """Weights of cells in averages over blocks, float32, shape [window, block, cell]."""
    borders: torch.Tensor
    """The same for values at borders of blocks, both ends among them, of the windows across which
    values vary, [varied, block + 1, cell]. Beyond an end of the axis a line goes on as between the
    last two pixels; where some pixels are masked, the value at an end is that of the last pixel."""
    across: torch.Tensor
    """Widths of windows over those of blocks, [varied, block]."""
    changes: torch.Tensor
    """Differences of neighbouring borders, times ``across``, [varied, block, cell]."""
    cells: slice
    """Cells that they take."""
    reach: tuple[np.ndarray, np.ndarray]
    """First cell of each block, and the one after its last."""

    def part(self, blocks: slice) -> AxisWindows:
        """Windows of the blocks of a part of the axis."""
        if blocks == slice(0, self.means.shape[1]):
            return self
        first, last = (each[blocks] for each in self.reach)
        cells = slice(int(first.min()), int(last.max()))
        borders = slice(blocks.start, blocks.stop + 1)
        return AxisWindows(
            self.means[:, blocks, cells],
            self.borders[:, borders, cells],
            self.across[:, blocks],
            self.changes[:, blocks, cells],
            cells,
            (first - cells.start, last - cells.start),
        )


@lru_cache(maxsize=64)
def axis_windows(
    count: int,
    scales_px: tuple[float, ...],
    varied_px: tuple[float, ...],
    block_px: int,
    masked: bool,
    device: torch.device,
) -> AxisWindows:
    """Windows of all blocks of an axis of ``count`` pixels, mirrored at the last ones; values vary
    across ``varied_px``. All take cells of one size (``cell_of``)."""
    import torch

    whole = [_block_weights(count, scale, block_px) for scale in scales_px]
    means = np.stack([each[0] for each in whole])
    at = [scales_px.index(scale) for scale in varied_px]
    borders = np.zeros((len(at), means.shape[1] + 1, means.shape[2]), np.float32)
    for k, each in enumerate(at):
        borders[k] = whole[each][2 if masked else 1]
    ends = np.minimum(np.arange(means.shape[1] + 1) * block_px, count)
    across = np.array(varied_px)[:, None] / np.diff(ends)
    changes = np.diff(borders, axis=1) * across[..., None]
    taken = (
        means.any(axis=0) | (borders[:, 1:] != 0).any(axis=0) | (borders[:, :-1] != 0).any(axis=0)
    )
    cells = taken.shape[1]
    reach = taken.argmax(axis=1), cells - taken[:, ::-1].argmax(axis=1)
    means, borders, across, changes = (
        torch.as_tensor(each.astype(np.float32), device=device)
        for each in (means, borders, across, changes)
    )
    return AxisWindows(means, borders, across, changes, slice(0, cells), reach)


@dataclass(frozen=True)
class AxisTaps:
    """Windows along one axis by the few cells that each block takes."""

    count: torch.Tensor
    """Cells that the blocks of each window take, int32, shape [window]."""
    first: torch.Tensor
    """First one of them, int32, shape [window, block]."""
    weights: torch.Tensor
    """Their weights in a block's average, and in the values at both its borders, and 0, float32,
    shape [window, block, cell, 4]."""


@lru_cache(maxsize=32)
def axis_taps(
    count: int, scales_px: tuple[float, ...], block_px: int, masked: bool, device: torch.device
) -> AxisTaps:
    """Windows of all blocks of an axis of ``count`` pixels."""
    import torch

    found = []
    for scale in scales_px:
        whole = _block_weights(count, scale, block_px)
        borders = whole[2 if masked else 1]
        weights = np.stack([whole[0], borders[:-1], borders[1:]])
        taken = np.any(np.abs(weights) > NOTHING, axis=0)
        cells = taken.shape[1]
        first = taken.argmax(axis=1)
        taps = int((cells - taken[:, ::-1].argmax(axis=1) - first).max())
        first = np.minimum(first, cells - taps)
        places = np.broadcast_to(first[:, None] + np.arange(taps), (3, len(first), taps))
        found.append((taps, first, np.take_along_axis(weights, places, axis=2)))
    most = max(taps for taps, _, _ in found)
    weights = [np.pad(each, [(0, 1), (0, 0), (0, most - taps)]) for taps, _, each in found]
    return AxisTaps(
        torch.tensor([taps for taps, _, _ in found], dtype=torch.int32, device=device),
        torch.tensor(np.stack([first for _, first, _ in found]), dtype=torch.int32, device=device),
        torch.tensor(np.moveaxis(np.stack(weights), 1, -1).copy(), device=device),
    )


@lru_cache(maxsize=64)
def _block_weights(
    count: int, sigma_px: float, block_px: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights of cells in the averages of blocks, at their borders, and at those where some pixels
    are masked, float32, shape [block (+ 1), cell]."""
    weights = _pixel_weights(count, sigma_px)
    starts = np.arange(0, count, block_px)
    means = np.add.reduceat(weights, starts, axis=0)
    means /= np.diff(np.append(starts, count))[:, None]
    inner = 0.5 * (weights[starts[1:] - 1] + weights[starts[1:]])
    first, last = weights[0], weights[-1]
    second, before = weights[min(1, count - 1)], weights[max(count - 2, 0)]
    borders = np.vstack([1.5 * first - 0.5 * second, inner, 1.5 * last - 0.5 * before])
    masked = np.vstack([first, inner, last])
    pixels = _between_cells(count, cell_of(sigma_px, block_px))
    found = [(rows @ pixels).astype(np.float32) for rows in (means, borders, masked)]
    return found[0], found[1], found[2]


@lru_cache(maxsize=16)
def _between_cells(count: int, cell_px: int) -> np.ndarray:
    """Pixels of an axis from the means of cells, shape [count, cell]: the parabola of a cell's mean
    and of those beside it (P. Colella and P. R. Woodward, J. Comput. Phys. 54, 1984)."""
    cells = -(-count // cell_px)
    found = np.zeros((count, cells))
    for cell in range(cells):
        pixels = np.arange(cell * cell_px, min((cell + 1) * cell_px, count))
        found[pixels, cell] = 1.0
        if cells < 3 or cell_px == 1 or len(pixels) < cell_px:
            continue
        at = (pixels - pixels.mean()) / cell_px
        bend = 0.5 * (at**2 - (at**2).mean())
        beside = np.zeros((2, cells))
        for k, other in enumerate((cell - 1, cell + 1)):
            # Beyond an end the line goes on.
            if 0 <= other < cells:
                beside[k, other] = 1.0
            else:
                beside[k, [cell, 2 * cell - other]] = 2.0, -1.0
        before, after = beside
        middle = np.eye(cells)[cell]
        found[pixels] += np.outer(at, 0.5 * (after - before))
        found[pixels] += np.outer(bend, after - 2.0 * middle + before)
    return found


@lru_cache(maxsize=16)
def _pixel_weights(count: int, sigma_px: float) -> np.ndarray:
    """Weights of pixels in the window about each, shape [count, count]."""
    reach = math.ceil(CUT_SIGMAS * sigma_px)
    steps = np.arange(-reach, reach + 1)
    # A window narrower than a pixel's rounding is that pixel.
    about = np.exp(-0.5 * (steps / max(sigma_px, 1e-3)) ** 2)
    about /= about.sum()
    at = np.arange(count)
    found = np.zeros((count, count))
    turn = max(2 * (count - 1), 1)
    for step, weight in zip(steps, about, strict=True):
        place = (at + step) % turn if count > 1 else np.zeros_like(at)
        found[at, np.minimum(place, turn - place)] += weight
    return found


def halved(values: torch.Tensor, axis: int) -> torch.Tensor:
    """Means of two neighbours along an axis; one that is left over at its end stays."""
    import torch

    count = values.shape[axis]
    even = values.narrow(axis, 0, count - count % 2).unflatten(axis, (-1, 2))
    both = axis if axis < 0 else axis + 1
    found = torch.add(even.select(both, 0), even.select(both, 1)).mul_(0.5)
    if count % 2:
        found = torch.cat([found, values.narrow(axis, count - 1, 1)], dim=axis)
    return found


def blurred(values: np.ndarray, sigma_px: float) -> np.ndarray:
    """Gaussian average of a picture, [h, w] or [h, w, channel], mirrored at its last pixels."""
    rows, columns = (_pixel_weights(count, sigma_px) for count in values.shape[:2])
    planes = values[..., None] if values.ndim == 2 else values
    found = np.moveaxis(rows @ np.moveaxis(planes, -1, 0) @ columns.T, 0, -1)
    return found[..., 0] if values.ndim == 2 else found
