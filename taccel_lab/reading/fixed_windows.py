# SPDX-License-Identifier: Apache-2.0
"""Features of blocks that are picked, for readings of fixed sizes (``room``).

A thread takes one window of one block, by the few cells that the window reaches. That is what
``FeatureWindows`` gets of whole maps by products of matrices, which a part of the blocks does not
need.
"""

# Warp compiles the kernels from their source; its type stubs do not describe vectors' operators.
# pyright: reportArgumentType=false, reportCallIssue=false, reportIndexIssue=false
# pyright: reportOperatorIssue=false

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

import torch
import warp as wp

from taccel_lab.reading.launch import MIN_COVER, bytes_of, four_of, launch, vectors
from taccel_lab.reading.windows import AxisTaps, axis_taps, cell_of


@wp.kernel(enable_backward=False)
def _pack_cells_kernel(
    seen: wp.array4d(dtype=Any),
    light: wp.array3d(dtype=float),
    kept: wp.array2d(dtype=wp.uint8),
    masked: int,
    share: float,
    found: wp.array3d(dtype=wp.vec4),
):
    image, row, column = wp.tid()
    value = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if masked == 0 or kept[row, column] != wp.uint8(0):
        value = wp.vec4(
            (float(seen[image, row, column, 0]) - light[row, column, 0]) * share,
            (float(seen[image, row, column, 1]) - light[row, column, 1]) * share,
            (float(seen[image, row, column, 2]) - light[row, column, 2]) * share,
            1.0,
        )
    found[image, row, column] = value


for _kind in (wp.uint8, wp.float32):
    wp.overload(_pack_cells_kernel, {"seen": wp.array4d(dtype=_kind)})


@wp.kernel(enable_backward=False)
def _halve_cells_kernel(cells: wp.array3d(dtype=wp.vec4), found: wp.array3d(dtype=wp.vec4)):
    image, row, column = wp.tid()
    low = wp.min(2 * row + 1, cells.shape[1] - 1)
    right = wp.min(2 * column + 1, cells.shape[2] - 1)
    first = four_of(cells, image, 2 * row, 2 * column) + four_of(cells, image, low, 2 * column)
    second = four_of(cells, image, 2 * row, right) + four_of(cells, image, low, right)
    found[image, row, column] = 0.5 * (0.5 * first + 0.5 * second)


@wp.func
def _over(total: wp.vec4, masked: int) -> wp.vec3:
    value = wp.vec3(total[0], total[1], total[2])
    if masked == 0:
        return value
    if total[3] > MIN_COVER:
        return value / total[3]
    return wp.vec3(0.0, 0.0, 0.0)


@wp.kernel(enable_backward=False)
def _window_kernel(
    picked: wp.array(dtype=wp.int64),
    block_px: int,
    size: wp.vec2i,
    cells: wp.array3d(dtype=wp.vec4),
    masked: int,
    window: int,
    over: wp.array(dtype=float),
    mean_row: wp.array(dtype=int),
    change_row: wp.array(dtype=int),
    taps_down: wp.array(dtype=int),
    first_down: wp.array2d(dtype=int),
    down: wp.array3d(dtype=wp.vec4),
    taps_across: wp.array(dtype=int),
    first_across: wp.array2d(dtype=int),
    across: wp.array3d(dtype=wp.vec4),
    found: wp.array2d(dtype=float),
):
    i, k = wp.tid()
    w = window + i
    height, width = first_down.shape[1], first_across.shape[1]
    block = int(picked[k])
    if block >= cells.shape[0] * height * width:
        return
    image = block // (height * width)
    row = (block // width) % height
    column = block % width
    top, left = first_down[w, row], first_across[w, column]
    change = change_row[w]
    mean = wp.vec4(0.0, 0.0, 0.0, 0.0)
    before = wp.vec4(0.0, 0.0, 0.0, 0.0)
    after = wp.vec4(0.0, 0.0, 0.0, 0.0)
    above = wp.vec4(0.0, 0.0, 0.0, 0.0)
    below = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for y in range(taps_down[w]):
        line = wp.vec4(0.0, 0.0, 0.0, 0.0)
        line_before = wp.vec4(0.0, 0.0, 0.0, 0.0)
        line_after = wp.vec4(0.0, 0.0, 0.0, 0.0)
        for x in range(taps_across[w]):
            value = four_of(cells, image, top + y, left + x)
            weight = four_of(across, w, column, x)
            line += weight[0] * value
            line_before += weight[1] * value
            line_after += weight[2] * value
        weight = four_of(down, w, row, y)
        mean += weight[0] * line
        before += weight[0] * line_before
        after += weight[0] * line_after
        above += weight[1] * line
        below += weight[2] * line
    if mean_row[w] >= 0:
        seen = _over(mean, masked)
        for c in range(3):
            found[mean_row[w] + c, k] = seen[c]
    if change >= 0:
        wide = float(wp.min(block_px, size[1] - column * block_px))
        high = float(wp.min(block_px, size[0] - row * block_px))
        along = _over(after, masked) - _over(before, masked)
        sinking = _over(below, masked) - _over(above, masked)
        for c in range(3):
            found[change + c, k] = along[c] * (over[w] / wide)
            found[change + 3 + c, k] = sinking[c] * (over[w] / high)


@wp.kernel(enable_backward=False)
def _known_rows_kernel(
    picked: wp.array(dtype=wp.int64),
    known: wp.array2d(dtype=float),
    first: int,
    found: wp.array2d(dtype=float),
):
    i, k = wp.tid()
    found[first + i, k] = known[i, int(picked[k]) % known.shape[1]]


class Maps(Protocol):
    """What windows take (``features.FeatureWindows``)."""

    mask: torch.Tensor | None
    scales: tuple[float, ...]
    varied: tuple[float, ...]

    @property
    def size(self) -> tuple[int, int, int]: ...
    def count(self, block_px: int) -> tuple[int, int]: ...
    def packed(self, cell_px: int) -> torch.Tensor: ...


@dataclass(frozen=True)
class _Windows:
    """Windows of blocks of one size, those that take the same cells one after another."""

    alike: tuple[tuple[int, int, int], ...]
    """Pixels along the cells, the first window that takes them, and that after the last."""
    over: torch.Tensor
    """Widths of the windows across which values vary [px]."""
    mean_row: torch.Tensor
    """Feature that the average is; -1 where it is none."""
    change_row: torch.Tensor
    """First feature of the variation, likewise."""
    down: AxisTaps
    across: AxisTaps


@lru_cache(maxsize=32)
def _windows(
    scales: tuple[float, ...],
    varied: tuple[float, ...],
    size_px: tuple[int, int],
    block_px: int,
    masked: bool,
    device: torch.device,
) -> _Windows:
    windows = []
    for scale in sorted({*scales, *varied}):
        mean = 3 * scales.index(scale) if scale in scales else -1
        change = 3 * len(scales) + 6 * varied.index(scale) if scale in varied else -1
        windows.append((scale, mean, change))
    twice = [(s, 3 * k, -1) for k, s in enumerate(scales) if scales.index(s) < k]
    first = 3 * len(scales)
    twice += [(s, -1, first + 6 * k) for k, s in enumerate(varied) if varied.index(s) < k]
    windows = sorted([*windows, *twice])
    names = [each[0] for each in windows]
    cells = [(cell_of(name, block_px), name > 0) for name in names]
    alike = tuple(
        (cell[0], cells.index(cell), cells.index(cell) + cells.count(cell))
        for cell in dict.fromkeys(cells)
    )
    down, across = (axis_taps(count, tuple(names), block_px, masked, device) for count in size_px)
    over, mean_row, change_row = (
        torch.tensor(each, device=device) for each in zip(*windows, strict=True)
    )
    return _Windows(alike, over, mean_row.int(), change_row.int(), down, across)


def packed_cells(
    images: torch.Tensor, light: torch.Tensor, mask: torch.Tensor | None, share: float
) -> torch.Tensor:
    """Pixels as they are seen, a ``share`` of what images [image, h, w, 3] differ from ``light``
    [h, w, 3] by and 1, or nothing where ``mask`` says so, shape [image, h, w, 4]."""
    size = tuple(images.shape[:3])
    found = torch.empty((*size, 4), device=images.device)
    seen = images if images.dtype == torch.uint8 else images.float()
    kept = bytes_of(mask, images.device)
    given = [seen, light.float(), kept, int(mask is not None), share, vectors(found)]
    launch(_pack_cells_kernel, size, given)
    return found


def halved_cells(cells: torch.Tensor) -> torch.Tensor:
    """Means of two by two cells, shape [image, h, w, 4]; what is left over at an end stays."""
    images, height, width, _ = cells.shape
    size = images, -(-height // 2), -(-width // 2)
    found = torch.empty((*size, 4), device=cells.device)
    launch(_halve_cells_kernel, size, [vectors(cells), vectors(found)])
    return found


def features_of_blocks(
    maps: Maps, block_px: int, known: torch.Tensor, picked: torch.Tensor
) -> torch.Tensor:
    """Features of blocks (``Blocks.features``), shape [feature, n], of those ``picked``, int64,
    counted along images, rows and columns; any past the last one. ``known``: ``Blocks.known``."""
    _, height, width = maps.size
    size_px = height, width
    masked = maps.mask is not None
    windows = _windows(maps.scales, maps.varied, size_px, block_px, masked, picked.device)
    features = 3 * len(maps.scales) + 6 * len(maps.varied)
    found = torch.empty((features + len(known), len(picked)), device=picked.device)
    for cell_px, first, end in windows.alike:
        launch(
            _window_kernel,
            (end - first, len(picked)),
            [
                picked, block_px, wp.vec2i(*size_px), vectors(maps.packed(cell_px)), int(masked),
                first, windows.over, windows.mean_row, windows.change_row, *_parts(windows.down),
                *_parts(windows.across), found,
            ],
            128,
        )  # fmt: skip
    launch(_known_rows_kernel, (len(known), len(picked)), [picked, known, features, found])
    return found


def _parts(taps: AxisTaps) -> tuple[Any, ...]:
    return taps.count, taps.first, vectors(taps.weights)
