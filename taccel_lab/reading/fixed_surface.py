# SPDX-License-Identifier: Apache-2.0
"""Kernels from tilts to normals, and from slopes to heights, in readings of fixed sizes (``room``).

Each does in one pass over the pixels of many images what takes tensors ten: a GPU waits for memory
there, not for sums.
"""

# Warp compiles the kernels from their source; its type stubs do not describe vectors' operators.
# pyright: reportArgumentType=false, reportCallIssue=false, reportIndexIssue=false
# pyright: reportOperatorIssue=false

from __future__ import annotations

import math

import torch
import warp as wp

from taccel_lab.reading.launch import bytes_of, launch


@wp.kernel(enable_backward=False)
def _normal_maps_kernel(
    read: wp.array4d(dtype=float),
    kept: wp.array2d(dtype=wp.uint8),
    away: wp.array2d(dtype=float),
    least: float,
    most_tilt: float,
    per_error: float,
    per_sigma: float,
    normals: wp.array4d(dtype=float),
    tilts: wp.array4d(dtype=float),
    sigmas: wp.array3d(dtype=float),
    radii: wp.array3d(dtype=float),
):
    image, row, column = wp.tid()
    counts = bool(True)
    if kept.shape[0] > 0:
        counts = kept[row, column] != wp.uint8(0)
    p = wp.where(counts, read[0, image, row, column], 0.0)
    q = wp.where(counts, read[1, image, row, column], 0.0)
    tilts[image, row, column, 0] = p
    tilts[image, row, column, 1] = q
    angle = wp.sqrt(p * p + q * q)
    cut, lean = wp.min(angle, most_tilt), float(1.0)
    if angle > 0.0:
        lean = wp.sin(cut) / angle
    normals[image, row, column, 0] = p * lean
    normals[image, row, column, 1] = q * lean
    normals[image, row, column, 2] = wp.cos(cut)
    sigma = wp.max(read[2, image, row, column], least) * per_error
    if away.shape[0] > 0:
        off = away[row, column] * wp.degrees(angle)
        sigma = wp.sqrt(sigma * sigma + off * off)
    sigmas[image, row, column] = sigma
    radii[image, row, column] = per_sigma * sigma


@wp.kernel(enable_backward=False)
def _slope_of_normal_maps_kernel(
    normals: wp.array4d(dtype=float), least: float, slopes: wp.array4d(dtype=float)
):
    image, row, column = wp.tid()
    upright = wp.max(normals[image, row, column, 2], least)
    slopes[image, row, column, 0] = -normals[image, row, column, 0] / upright
    slopes[image, row, column, 1] = -normals[image, row, column, 1] / upright


@wp.func
def _weight(i: int, count: int) -> wp.float64:
    """Weight of a pixel in a cell of four, of which there are so many: means of means of two."""
    if count == 3 and i == 2:
        return wp.float64(0.5)
    if count == 3:
        return wp.float64(0.25)
    return wp.float64(1.0) / wp.float64(count)


@wp.kernel(enable_backward=False)
def _cell_slope_kernel(slopes: wp.array4d(dtype=float), means: wp.array4d(dtype=wp.float64)):
    image, row, column = wp.tid()
    high = wp.min(4, slopes.shape[1] - 4 * row)
    wide = wp.min(4, slopes.shape[2] - 4 * column)
    first, second = wp.float64(0.0), wp.float64(0.0)
    for i in range(high):
        for j in range(wide):
            weight = _weight(i, high) * _weight(j, wide)
            first += weight * wp.float64(slopes[image, 4 * row + i, 4 * column + j, 0])
            second += weight * wp.float64(slopes[image, 4 * row + i, 4 * column + j, 1])
    means[image, row, column, 0] = first
    means[image, row, column, 1] = second


@wp.func
def _left_out(
    height: wp.array3d(dtype=wp.float64),
    slopes: wp.array4d(dtype=float),
    image: int,
    row: int,
    column: int,
    axis: int,
    per_m: wp.float64,
) -> wp.float64:
    """Slope along the edge to the next pixel of an axis, less that of the heights, by a step."""
    low, right = row + axis, column + 1 - axis
    one = wp.float64(slopes[image, row, column, axis])
    other = wp.float64(slopes[image, low, right, axis])
    rise = height[image, low, right] - height[image, row, column]
    return (wp.float64(0.5) * (one + other) - rise * per_m) * per_m


@wp.kernel(enable_backward=False)
def _detail_kernel(
    height: wp.array3d(dtype=wp.float64),
    slopes: wp.array4d(dtype=float),
    per_x: wp.float64,
    per_y: wp.float64,
    found: wp.array3d(dtype=wp.float64),
):
    image, row, column = wp.tid()
    total = wp.float64(0.0)
    if column + 1 < height.shape[2]:
        total += _left_out(height, slopes, image, row, column, 0, per_x)
    if column > 0:
        total -= _left_out(height, slopes, image, row, column - 1, 0, per_x)
    if row + 1 < height.shape[1]:
        total += _left_out(height, slopes, image, row, column, 1, per_y)
    if row > 0:
        total -= _left_out(height, slopes, image, row - 1, column, 1, per_y)
    found[image, row, column] = total


@wp.kernel(enable_backward=False)
def _rise_map_kernel(
    height: wp.array3d(dtype=wp.float64),
    detail: wp.array3d(dtype=wp.float64),
    level: wp.array(dtype=wp.float64),
    plane: wp.array3d(dtype=wp.float64),
    share: wp.float64,
    found: wp.array3d(dtype=wp.float64),
):
    image, row, column = wp.tid()
    half = wp.float64(0.5)
    down = (wp.float64(row) + half) * share - half
    across = (wp.float64(column) + half) * share - half
    corner = plane[image, 0, 0]
    tilted = corner + down * (plane[image, 1, 0] - corner)
    tilted += across * (plane[image, 0, 1] - corner)
    rise = height[image, row, column] + detail[image, row, column]
    found[image, row, column] = rise - level[image] - tilted


@wp.kernel(enable_backward=False)
def _deviation_kernel(
    spread: wp.array3d(dtype=float),
    along: wp.array3d(dtype=float),
    rise: wp.array3d(dtype=wp.float64),
    factors: wp.vec3,
    reading: wp.array3d(dtype=wp.float64),
    sigma: wp.array3d(dtype=wp.float64),
):
    image, row, column = wp.tid()
    own = wp.float64(spread[image, row, column] * factors[0])
    more = wp.float64(along[image, row, column] * factors[1])
    share = rise[image, row, column] * wp.float64(factors[2])
    reading[image, row, column] = own
    sigma[image, row, column] = wp.sqrt(own * own + more * more + share * share)


def normal_maps(
    read: torch.Tensor,
    kept: torch.Tensor | None,
    away: torch.Tensor | None,
    numbers: tuple[float, float, float, float],
) -> tuple[torch.Tensor, ...]:
    """Normals, tilts, their deviations and radii (``slopes.NormalMap``) of what is read of every
    pixel [3, image, h, w].

    Args:
        kept: Pixels that count, bool, shape [h, w].
        away: Parts of their tilt that pixels may be off by, shape [h, w].
        numbers: Least error [rad], steepest tilt [rad], deviation [degrees] by error [rad], and
            radius by deviation.
    """
    shape = tuple(read.shape[1:])
    new = read.new_empty
    found = new((*shape, 3)), new((*shape, 2)), new(shape), new(shape)
    none = new((0, 0)) if away is None else away
    launch(_normal_maps_kernel, shape, [read, bytes_of(kept, read.device), none, *numbers, *found])
    return found


def slopes_of(normals: torch.Tensor, steepest_rad: float) -> torch.Tensor:
    """Slopes of normals [image, h, w, 3] (``slopes.NormalMap.slopes``)."""
    found = normals.new_empty((*normals.shape[:-1], 2))
    given = [normals, math.cos(steepest_rad), found]
    launch(_slope_of_normal_maps_kernel, tuple(normals.shape[:-1]), given)
    return found


def cell_slopes(slopes: torch.Tensor) -> torch.Tensor:
    """Means of slopes [image, h, w, 2] over cells of 4 px, float64."""
    images, height, width, _ = slopes.shape
    size = images, -(-height // 4), -(-width // 4)
    found = torch.empty((*size, 2), dtype=torch.float64, device=slopes.device)
    launch(_cell_slope_kernel, size, [slopes, found])
    return found


def detail_divergence(
    height: torch.Tensor, slopes: torch.Tensor, steps_m: tuple[float, float]
) -> torch.Tensor:
    """Divergence [1/m] of what slopes [image, h, w, 2] say besides heights [m] [image, h, w]."""
    found = torch.empty_like(height)
    per_m = [1.0 / step for step in steps_m]
    launch(_detail_kernel, tuple(height.shape), [height, slopes, *per_m, found])
    return found


def rise_of(
    height: torch.Tensor,
    detail: torch.Tensor,
    level: torch.Tensor,
    plane: torch.Tensor,
    cell_px: int,
) -> torch.Tensor:
    """Heights [m] with detail, less its ``level`` [image], over a plane that cells show."""
    found = torch.empty_like(height)
    given = [height, detail, level, plane, 1.0 / cell_px, found]
    launch(_rise_map_kernel, tuple(height.shape), given)
    return found


def deviations_of(
    spread: torch.Tensor,
    along: torch.Tensor,
    rise: torch.Tensor,
    *,
    factors: tuple[float, float, float],
) -> tuple[torch.Tensor, torch.Tensor]:
    """Deviations [m] of the reading alone and of all, of errors that are smooth, ones along the
    slope, and a share of the depth, by their factors; shape [image, h, w]."""
    reading, sigma = torch.empty_like(rise), torch.empty_like(rise)
    given = [spread, along, rise, wp.vec3(*factors), reading, sigma]
    launch(_deviation_kernel, tuple(rise.shape), given)
    return reading, sigma
