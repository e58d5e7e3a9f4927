# SPDX-License-Identifier: Apache-2.0
"""Kernels of readings of fixed sizes (``room``): features of picked blocks, and maps of all pixels.

A thread takes one window of one block, by the few cells that the window reaches. That is what
``FeatureWindows`` gets of whole maps by products of matrices, which a part of the blocks does not
need.
"""

# Warp compiles the kernels from their source; its type stubs do not describe vectors' operators.
# pyright: reportArgumentType=false, reportCallIssue=false, reportIndexIssue=false
# pyright: reportOperatorIssue=false

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

import torch
import warp as wp

from taccel_lab.processes.start_warp import start_warp
from taccel_lab.reading.windows import AxisTaps, axis_taps, cell_of

MIN_COVER = wp.constant(1e-3)


@wp.func
def _over(total: wp.vec3, share: float, masked: int) -> wp.vec3:
    if masked == 0:
        return total
    if share > MIN_COVER:
        return total / share
    return wp.vec3(0.0, 0.0, 0.0)


@wp.kernel
def _window_kernel(
    picked: wp.array(dtype=wp.int64),
    shape: wp.vec3i,
    block_px: int,
    size: wp.vec2i,
    cells: wp.array4d(dtype=float),
    cover: wp.array2d(dtype=float),
    masked: int,
    window: int,
    over: wp.array(dtype=float),
    mean_row: wp.array(dtype=int),
    change_row: wp.array(dtype=int),
    taps_down: wp.array(dtype=int),
    first_down: wp.array2d(dtype=int),
    down: wp.array4d(dtype=float),
    taps_across: wp.array(dtype=int),
    first_across: wp.array2d(dtype=int),
    across: wp.array4d(dtype=float),
    found: wp.array2d(dtype=float),
):
    i, k = wp.tid()
    w = window + i
    height, width = shape[1], shape[2]
    block = int(wp.min(picked[k], wp.int64(shape[0] * height * width - 1)))
    image = block // (height * width)
    row = (block // width) % height
    column = block % width
    top, left = first_down[w, row], first_across[w, column]
    varied = change_row[w] >= 0
    mean = wp.vec3(0.0, 0.0, 0.0)
    before = wp.vec3(0.0, 0.0, 0.0)
    after = wp.vec3(0.0, 0.0, 0.0)
    above = wp.vec3(0.0, 0.0, 0.0)
    below = wp.vec3(0.0, 0.0, 0.0)
    share = float(0.0)
    shares = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for y in range(taps_down[w]):
        line = wp.vec3(0.0, 0.0, 0.0)
        line_before = wp.vec3(0.0, 0.0, 0.0)
        line_after = wp.vec3(0.0, 0.0, 0.0)
        kept = wp.vec3(0.0, 0.0, 0.0)
        for x in range(taps_across[w]):
            value = wp.vec3(
                cells[0, image, top + y, left + x],
                cells[1, image, top + y, left + x],
                cells[2, image, top + y, left + x],
            )
            weight = wp.vec3(
                across[w, 0, column, x], across[w, 1, column, x], across[w, 2, column, x]
            )
            line += weight[0] * value
            if varied:
                line_before += weight[1] * value
                line_after += weight[2] * value
            if masked != 0:
                kept += cover[top + y, left + x] * weight
        by_row = wp.vec3(down[w, 0, row, y], down[w, 1, row, y], down[w, 2, row, y])
        mean += by_row[0] * line
        share += by_row[0] * kept[0]
        if varied:
            before += by_row[0] * line_before
            after += by_row[0] * line_after
            above += by_row[1] * line
            below += by_row[2] * line
            shares += wp.vec4(
                by_row[0] * kept[1], by_row[0] * kept[2], by_row[1] * kept[0], by_row[2] * kept[0]
            )
    mean = _over(mean, share, masked)
    if mean_row[w] >= 0:
        for c in range(3):
            found[mean_row[w] + c, k] = mean[c]
    if varied:
        wide = float(wp.min(block_px, size[1] - column * block_px))
        high = float(wp.min(block_px, size[0] - row * block_px))
        along = _over(after, shares[1], masked) - _over(before, shares[0], masked)
        down_it = _over(below, shares[3], masked) - _over(above, shares[2], masked)
        for c in range(3):
            found[change_row[w] + c, k] = along[c] * (over[w] / wide)
            found[change_row[w] + 3 + c, k] = down_it[c] * (over[w] / high)


@wp.kernel
def _flag_span_kernel(flags: wp.array3d(dtype=wp.uint8), found: wp.array2d(dtype=int)):
    image, row, column = wp.tid()
    if flags[image, row, column] != wp.uint8(0):
        wp.atomic_max(found, image, 0, flags.shape[1] - row)
        wp.atomic_max(found, image, 1, row + 1)
        wp.atomic_max(found, image, 2, flags.shape[2] - column)
        wp.atomic_max(found, image, 3, column + 1)


@wp.func
def _part(
    found: wp.array3d(dtype=int), size: int, image: int, parent: wp.vec2i, own: wp.vec2i
) -> wp.vec4i:
    """First row, row after the last, and columns likewise, of a part of one image."""
    first = wp.max(parent[0] - found[size, image, 0] - 1, 0)
    last = wp.min(found[size, image, 1] + 1, parent[0])
    left = wp.max(parent[1] - found[size, image, 2] - 1, 0)
    right = wp.min(found[size, image, 3] + 1, parent[1])
    if found[size, image, 1] == 0:
        return wp.vec4i(0, 0, 0, 0)
    return wp.vec4i(2 * first, wp.min(2 * last, own[0]), 2 * left, wp.min(2 * right, own[1]))


@wp.func
def _along(
    values: wp.array4d(dtype=float), v: int, image: int, row: int, x: float, part: wp.vec4i
) -> float:
    at = int(wp.floor(x))
    share = x - float(at)
    first, last = part[2], part[3] - 1
    if at < first:
        inner = values[v, image, row, wp.min(first + 1, last)]
        outer = values[v, image, row, first]
        return outer + (1.0 - share) * (outer - inner)
    if at >= last:
        inner = values[v, image, row, wp.max(last - 1, first)]
        outer = values[v, image, row, last]
        return outer + share * (outer - inner)
    return (1.0 - share) * values[v, image, row, at] + share * values[v, image, row, at + 1]


@wp.func
def _at(
    values: wp.array4d(dtype=float),
    v: int,
    image: int,
    row: int,
    column: int,
    px: int,
    part: wp.vec4i,
) -> float:
    y = (float(row) + 0.5) / float(px) - 0.5
    x = (float(column) + 0.5) / float(px) - 0.5
    at = int(wp.floor(y))
    share = y - float(at)
    first, last = part[0], part[1] - 1
    if at < first:
        inner = _along(values, v, image, wp.min(first + 1, last), x, part)
        outer = _along(values, v, image, first, x, part)
        return outer + (1.0 - share) * (outer - inner)
    if at >= last:
        inner = _along(values, v, image, wp.max(last - 1, first), x, part)
        outer = _along(values, v, image, last, x, part)
        return outer + share * (outer - inner)
    above = _along(values, v, image, at, x, part)
    return (1.0 - share) * above + share * _along(values, v, image, at + 1, x, part)


@wp.func
def _inside(row: int, column: int, px: int, part: wp.vec4i) -> bool:
    down, across = row // px, column // px
    return down >= part[0] and down < part[1] and across >= part[2] and across < part[3]


@wp.kernel
def _paint_blocks_kernel(
    eights: wp.array4d(dtype=float),
    fours: wp.array4d(dtype=float),
    twos: wp.array4d(dtype=float),
    ones: wp.array4d(dtype=float),
    spans: wp.array3d(dtype=int),
    found: wp.array4d(dtype=float),
):
    image, row, column = wp.tid()
    whole = wp.vec2i(eights.shape[2], eights.shape[3])
    fourth = wp.vec2i(fours.shape[2], fours.shape[3])
    half = wp.vec2i(twos.shape[2], twos.shape[3])
    part4 = _part(spans, 0, image, whole, fourth)
    part2 = _part(spans, 1, image, fourth, half)
    part1 = _part(spans, 2, image, half, wp.vec2i(ones.shape[2], ones.shape[3]))
    for v in range(found.shape[0]):
        if _inside(row, column, 1, part1):
            found[v, image, row, column] = ones[v, image, row, column]
        elif _inside(row, column, 2, part2):
            found[v, image, row, column] = _at(twos, v, image, row, column, 2, part2)
        elif _inside(row, column, 4, part4):
            found[v, image, row, column] = _at(fours, v, image, row, column, 4, part4)
        else:
            part = wp.vec4i(0, whole[0], 0, whole[1])
            found[v, image, row, column] = _at(eights, v, image, row, column, 8, part)


class Maps(Protocol):
    """What windows take (``features.FeatureWindows``)."""

    mask: torch.Tensor | None
    scales: tuple[float, ...]
    varied: tuple[float, ...]

    @property
    def size(self) -> tuple[int, int, int]: ...
    def count(self, block_px: int) -> tuple[int, int]: ...
    def cells(self, cell_px: int) -> torch.Tensor: ...
    def cover(self, cell_px: int) -> torch.Tensor: ...


@dataclass(frozen=True)
class _Windows:
    """Windows of blocks of one size, those that take the same cells one after another."""

    alike: tuple[tuple[int, int, int], ...]
    """Pixels along the cells, the first window that takes them, and that after the last."""
    over: torch.Tensor
    """Widths that variations are told over [px]."""
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
    means = [(scale, 3 * k, -1) for k, scale in enumerate(scales)]
    changes = [(scale, -1, 3 * len(scales) + 6 * k) for k, scale in enumerate(varied)]
    windows = sorted([*means, *changes], key=lambda each: each[0])
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


def windows_of_blocks(maps: Maps, block_px: int, picked: torch.Tensor) -> torch.Tensor:
    """What blocks see of the change (``Blocks.changing``), shape [feature, n], of those ``picked``,
    int64, counted along images, rows and columns; past the last one, of the last."""
    images, height, width = maps.size
    size_px = height, width
    masked = maps.mask is not None
    windows = _windows(maps.scales, maps.varied, size_px, block_px, masked, picked.device)
    features = 3 * len(maps.scales) + 6 * len(maps.varied)
    found = torch.empty((features, len(picked)), device=picked.device)
    shape = wp.vec3i(images, *maps.count(block_px))
    for cell_px, first, end in windows.alike:
        cells = maps.cells(cell_px)
        cover = maps.cover(cell_px) if masked else cells.new_empty((1, 1))
        _launch(
            _window_kernel,
            (end - first, len(picked)),
            [
                picked, shape, block_px, wp.vec2i(*size_px), cells, cover, int(masked), first,
                windows.over, windows.mean_row, windows.change_row, *_parts(windows.down),
                *_parts(windows.across), found,
            ],
        )  # fmt: skip
    return found


def spans_of(flags: Sequence[torch.Tensor]) -> torch.Tensor:
    """Where flags are set, for each size of blocks, bool, shape [image, h, w], and each image."""
    found = torch.zeros((len(flags), len(flags[0]), 4), dtype=torch.int32, device=flags[0].device)
    for each, span in zip(flags, found, strict=True):
        _launch(_flag_span_kernel, tuple(each.shape), [each.view(torch.uint8), span])
    return found


def painted_parts(
    maps: Sequence[torch.Tensor], spans: torch.Tensor, shape: tuple[int, int]
) -> torch.Tensor:
    """What is read of every pixel (``blocks.painted``), of maps of whole images by blocks of 8, 4,
    2 and 1 px, of which each smaller size counts around the flags of ``spans_of`` alone."""
    values, images = maps[0].shape[:2]
    found = torch.empty((values, images, *shape), device=spans.device)
    _launch(_paint_blocks_kernel, (images, *shape), [*maps, spans, found])
    return found


def _parts(taps: AxisTaps) -> tuple[torch.Tensor, ...]:
    return taps.count, taps.first, taps.weights


def _launch(kernel: Any, size: tuple[int, ...], values: Sequence[Any]) -> None:
    """Launch on the stream that torch works on, so that a graph that torch records has it."""
    start_warp()
    given = [wp.from_torch(each) if isinstance(each, torch.Tensor) else each for each in values]
    device = next(each.device for each in given if isinstance(each, wp.array))
    if not device.is_cuda:
        wp.launch(kernel, size, given, device=device)
        return
    with wp.ScopedStream(wp.stream_from_torch(torch.cuda.current_stream()), sync_enter=False):
        wp.launch(kernel, size, given, device=device)
