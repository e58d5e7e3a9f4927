# SPDX-License-Identifier: Apache-2.0
"""Kernels of readings of fixed sizes (``room``): blocks that are looked at closely, and maps of all
pixels, of many images at once (``blocks``)."""

# Warp compiles the kernels from their source; its type stubs do not describe vectors' operators.
# pyright: reportArgumentType=false, reportCallIssue=false, reportIndexIssue=false
# pyright: reportOperatorIssue=false

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import torch
import warp as wp

from taccel_lab.reading.launch import MIN_COVER, bytes_of, four_of, launch, vectors

MAX_TILT = wp.constant(math.radians(85.0))


@wp.func
def _color(cells: wp.array3d(dtype=wp.vec4), image: int, row: int, column: int) -> wp.vec3:
    value = four_of(cells, image, row, column)
    return wp.vec3(value[0], value[1], value[2]) / wp.max(value[3], MIN_COVER)


@wp.func
def _color_line(
    cells: wp.array3d(dtype=wp.vec4), image: int, row: int, at: int, share: float
) -> wp.vec3:
    return (1.0 - share) * _color(cells, image, row, at) + share * _color(cells, image, row, at + 1)


@wp.kernel(enable_backward=False)
def _block_texture_kernel(
    fine: wp.array3d(dtype=wp.vec4),
    coarse: wp.array3d(dtype=wp.vec4),
    before: wp.array3d(dtype=float),
    found: wp.array3d(dtype=float),
):
    image, row, column = wp.tid()
    total, count, inner = float(0.0), float(0.0), float(0.0)
    for i in range(2):
        for j in range(2):
            y, x = 2 * row + i, 2 * column + j
            if y < fine.shape[1] and x < fine.shape[2]:
                # Lines go on beyond the outermost middles.
                top = wp.clamp(row - 1 + i, 0, wp.max(coarse.shape[1] - 2, 0))
                left = wp.clamp(column - 1 + j, 0, wp.max(coarse.shape[2] - 2, 0))
                down = 0.5 * float(y) - 0.25 - float(top)
                across = 0.5 * float(x) - 0.25 - float(left)
                line = (1.0 - down) * _color_line(coarse, image, top, left, across)
                line += down * _color_line(coarse, image, top + 1, left, across)
                off = _color(fine, image, y, x) - line
                total += wp.dot(off, off) * wp.pow(fine[image, y, x][3], 2.0) / 3.0
                if before.shape[1] > 0:
                    inner += before[image, y, x]
                count += 1.0
    found[image, row, column] = (total + inner) / count


@wp.func
def _lean(tilts: wp.array4d(dtype=float), image: int, row: int, column: int) -> wp.vec2:
    tilt = wp.vec2(tilts[0, image, row, column], tilts[1, image, row, column])
    angle = wp.length(tilt)
    if angle == 0.0:
        return tilt
    cut = wp.min(angle, MAX_TILT)
    return tilt * (wp.tan(cut) / angle)


@wp.kernel(enable_backward=False)
def _bend_kernel(tilts: wp.array4d(dtype=float), found: wp.array3d(dtype=float)):
    image, row, column = wp.tid()
    low, right = tilts.shape[2] - 1, tilts.shape[3] - 1
    middle = 2.0 * _lean(tilts, image, row, column)
    along = _lean(tilts, image, row, wp.max(column - 1, 0)) - middle
    along += _lean(tilts, image, row, wp.min(column + 1, right))
    down = _lean(tilts, image, wp.max(row - 1, 0), column) - middle
    down += _lean(tilts, image, wp.min(row + 1, low), column)
    most = wp.max(
        wp.max(wp.abs(along[0]), wp.abs(along[1])), wp.max(wp.abs(down[0]), wp.abs(down[1]))
    )
    found[image, row, column] = most


@wp.func
def _reach(span: wp.array2d(dtype=int), image: int, end: int, value: int):
    # Most have been passed already, which is seen faster than it is done.
    if span[image, end] < value:
        wp.atomic_max(span, image, end, value)


@wp.kernel(enable_backward=False)
def _flag_kernel(
    bends: wp.array3d(dtype=float),
    limits: wp.array(dtype=float),
    hidden: wp.array2d(dtype=wp.uint8),
    textures: wp.array3d(dtype=float),
    texture_limits: wp.array(dtype=float),
    texture_step: int,
    before: wp.array3d(dtype=wp.uint8),
    found: wp.array3d(dtype=wp.uint8),
    span: wp.array2d(dtype=int),
):
    image, row, column = wp.tid()
    flag = textures[image, row // texture_step, column // texture_step] > texture_limits[image]
    for y in range(wp.max(row - 1, 0), wp.min(row + 2, bends.shape[1])):
        for x in range(wp.max(column - 1, 0), wp.min(column + 2, bends.shape[2])):
            if bends[image, y, x] > limits[image]:
                flag = True
            if hidden.shape[0] > 0:
                if hidden[y, x] != wp.uint8(0):
                    flag = True
    if before.shape[0] > 0:
        if before[image % before.shape[0], row, column] == wp.uint8(0):
            flag = False
    found[image, row, column] = wp.uint8(0)
    if flag:
        found[image, row, column] = wp.uint8(1)
        _reach(span, image, 0, bends.shape[1] - row)
        _reach(span, image, 1, row + 1)
        _reach(span, image, 2, bends.shape[2] - column)
        _reach(span, image, 3, column + 1)


@wp.func
def _read(values: wp.array4d(dtype=float), image: int, row: int, column: int) -> wp.vec3:
    return wp.vec3(
        values[0, image, row, column], values[1, image, row, column], values[2, image, row, column]
    )


@wp.func
def _line(values: wp.array4d(dtype=float), image: int, row: int, at: int, share: float) -> wp.vec3:
    before = _read(values, image, row, at)
    if share == 0.0:
        return before
    return before + share * (_read(values, image, row, at + 1) - before)


@wp.func
def _between(
    values: wp.array4d(dtype=float), image: int, row: int, column: int, px: float, part: wp.vec4i
) -> wp.vec3:
    """What is read of a pixel, along lines between the middles of blocks of a part, which go on
    beyond the outermost ones."""
    y = (float(row) + 0.5) / px - 0.5
    x = (float(column) + 0.5) / px - 0.5
    top = wp.clamp(int(wp.floor(y)), part[0], wp.max(part[1] - 2, part[0]))
    left = wp.clamp(int(wp.floor(x)), part[2], wp.max(part[3] - 2, part[2]))
    # Of a single row or column the value stays.
    down, across = y - float(top), x - float(left)
    if part[3] - part[2] < 2:
        across = 0.0
    above = _line(values, image, top, left, across)
    if part[1] - part[0] < 2:
        return above
    return above + down * (_line(values, image, top + 1, left, across) - above)


@wp.func
def _write(values: wp.array4d(dtype=float), image: int, row: int, column: int, read: wp.vec3):
    values[0, image, row, column] = read[0]
    values[1, image, row, column] = read[1]
    values[2, image, row, column] = read[2]


@wp.func
def _inside(row: int, column: int, px: int, part: wp.vec4i) -> bool:
    return (
        row >= px * part[0]
        and row < px * part[1]
        and column >= px * part[2]
        and column < px * part[3]
    )


@wp.func
def _part(span: wp.array2d(dtype=int), image: int, whole: wp.vec2i, own: wp.vec2i) -> wp.vec4i:
    """First row, row after the last, and columns likewise, of the part of an image that blocks half
    as wide as those of a span count in."""
    if span[image, 1] == 0:
        return wp.vec4i(0, 0, 0, 0)
    return wp.vec4i(
        2 * wp.max(whole[0] - span[image, 0] - 1, 0),
        wp.min(2 * wp.min(span[image, 1] + 1, whole[0]), own[0]),
        2 * wp.max(whole[1] - span[image, 2] - 1, 0),
        wp.min(2 * wp.min(span[image, 3] + 1, whole[1]), own[1]),
    )


@wp.kernel(enable_backward=False)
def _finer_kernel(
    values: wp.array4d(dtype=float),
    flags: wp.array3d(dtype=wp.uint8),
    span: wp.array2d(dtype=int),
    seen: wp.array2d(dtype=wp.uint8),
    lines: wp.array4d(dtype=float),
    finer: wp.array3d(dtype=wp.uint8),
    picked: wp.array3d(dtype=wp.uint8),
):
    image, row, column = wp.tid()
    whole = wp.vec2i(values.shape[2], values.shape[3])
    part = _part(span, image, whole, wp.vec2i(lines.shape[2], lines.shape[3]))
    if _inside(row, column, 1, part):
        every = wp.vec4i(0, whole[0], 0, whole[1])
        _write(lines, image, row, column, _between(values, image, row, column, 2.0, every))
    flag = flags[image, row // 2, column // 2]
    finer[image, row, column] = flag
    if seen.shape[0] > 0:
        picked[image, row, column] = wp.min(flag, seen[row, column])


@wp.kernel(enable_backward=False)
def _part_kernel(
    spans: wp.array3d(dtype=int),
    sizes: wp.array(dtype=wp.vec2i),
    found: wp.array2d(dtype=wp.vec4i),
):
    i, image = wp.tid()
    found[i, image] = _part(spans[i], image, sizes[i], sizes[i + 1])


@wp.kernel(enable_backward=False)
def _paint_blocks_kernel(
    eights: wp.array4d(dtype=float),
    fours: wp.array4d(dtype=float),
    twos: wp.array4d(dtype=float),
    ones: wp.array4d(dtype=float),
    parts: wp.array2d(dtype=wp.vec4i),
    every: int,
    found: wp.array4d(dtype=float),
):
    image, row, column = wp.tid()
    fine, fair = parts[1, image], parts[0, image]
    two, four, eight = 2 // every, 4 // every, 8 // every
    pixels = wp.vec4i(0, 0, 0, 0)
    if parts.shape[0] > 2:
        pixels = parts[2, image]
    if _inside(row, column, 1, pixels):
        _write(found, image, row, column, _read(ones, image, row, column))
    elif _inside(row, column, two, fine):
        _write(found, image, row, column, _between(twos, image, row, column, float(two), fine))
    elif _inside(row, column, four, fair):
        _write(found, image, row, column, _between(fours, image, row, column, float(four), fair))
    else:
        whole = wp.vec4i(0, eights.shape[2], 0, eights.shape[3])
        _write(found, image, row, column, _between(eights, image, row, column, float(eight), whole))


def textures(fine: torch.Tensor, coarse: torch.Tensor, before: torch.Tensor | None) -> torch.Tensor:
    """Mean squares of what cells differ by from lines between ones twice as wide, over these, and
    of what was found ``before``, shape [image, h, w]; cells as of ``packed_cells``."""
    size = tuple(coarse.shape[:3])
    found = torch.empty(size, device=fine.device)
    launch(
        _block_texture_kernel, size, [vectors(fine), vectors(coarse), _given(before, found), found]
    )
    return found


def bends(tilts: torch.Tensor) -> torch.Tensor:
    """Largest second difference along an axis of the slopes of tilts [2, image, h, w], shape
    [image, h, w]."""
    found = torch.empty(tuple(tilts.shape[1:]), device=tilts.device)
    launch(_bend_kernel, tuple(found.shape), [tilts, found])
    return found


def flags_beside(
    bend: tuple[torch.Tensor, torch.Tensor],
    hidden: torch.Tensor | None,
    texture: tuple[torch.Tensor, torch.Tensor],
    before: torch.Tensor | None,
    span: torch.Tensor,
) -> torch.Tensor:
    """Blocks beside which slopes bend by more than limits or pixels are ``hidden``, or in which
    there is more texture, among those flagged ``before``, bytes, shape [image, h, w]; ``span``
    [image, 4] is made to hold them."""
    values, textured = bend[0], texture[0]
    found = torch.empty(values.shape, dtype=torch.uint8, device=values.device)
    step = 1 if textured.shape == values.shape else 2
    launch(
        _flag_kernel,
        tuple(values.shape),
        [
            values, bend[1].flatten(), bytes_of(hidden, found.device), textured,
            texture[1].flatten(), step, _given(before, found), found, span,
        ],
    )  # fmt: skip
    return found


def finer_maps(
    values: torch.Tensor,
    flags: torch.Tensor,
    span: torch.Tensor,
    seen: torch.Tensor | None,
    lines: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Flags on blocks half as wide, bytes, and those of them that are ``seen``, bool, shape [image,
    h, w]; ``lines`` [value, image, h, w] gets what lies on lines between the blocks of before,
    around the ``span`` of flags."""
    size = tuple(lines.shape[1:])
    finer = torch.empty(size, dtype=torch.uint8, device=values.device)
    picked = finer if seen is None else torch.empty_like(finer)
    given = [values, flags, span, bytes_of(seen, values.device), lines, finer, picked]
    launch(_finer_kernel, size, given)
    return finer, picked.view(torch.bool)


def painted_parts(
    maps: Sequence[torch.Tensor], spans: torch.Tensor, shape: tuple[int, int], every: int
) -> torch.Tensor:
    """``blocks.painted``, of maps of whole images by blocks of 8, 4, 2 and perhaps 1 px, of which
    each smaller size counts around the ``spans`` of flags alone."""
    values, images = maps[0].shape[:2]
    found = torch.empty((values, images, *shape), device=spans.device)
    none = [found.new_empty((0, 0, 0, 0))] * (4 - len(maps))
    parts = vectors(torch.empty_like(spans), wp.vec4i)
    sizes = vectors(_sizes(tuple(each.shape[2:] for each in maps), spans.device), wp.vec2i)
    launch(_part_kernel, tuple(spans.shape[:2]), [spans, sizes, parts])
    launch(_paint_blocks_kernel, (images, *shape), [*maps, *none, parts, every, found])
    return found


@lru_cache(maxsize=32)
def _sizes(shapes: tuple[tuple[int, int], ...], device: torch.device) -> torch.Tensor:
    return torch.tensor([tuple(shape) for shape in shapes], dtype=torch.int32, device=device)


def _given(values: torch.Tensor | None, like: torch.Tensor) -> torch.Tensor:
    """Maps, or an empty one of none."""
    return like.new_empty((0, 0, 0)) if values is None else values
