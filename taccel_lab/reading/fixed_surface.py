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
def _on_edge(
    slopes: wp.array4d(dtype=float), image: int, row: int, column: int, axis: int
) -> wp.float64:
    """Slope along the edge to the next pixel of an axis."""
    one = wp.float64(slopes[image, row, column, axis])
    other = wp.float64(slopes[image, row + axis, column + 1 - axis, axis])
    return wp.float64(0.5) * (one + other)


@wp.kernel(enable_backward=False)
def _divergence_kernel(
    slopes: wp.array4d(dtype=float),
    per_x: wp.float64,
    per_y: wp.float64,
    found: wp.array3d(dtype=wp.float64),
):
    image, row, column = wp.tid()
    total = wp.float64(0.0)
    if column + 1 < found.shape[2]:
        total += _on_edge(slopes, image, row, column, 0) * per_x
    if column > 0:
        total -= _on_edge(slopes, image, row, column - 1, 0) * per_x
    if row + 1 < found.shape[1]:
        total += _on_edge(slopes, image, row, column, 1) * per_y
    if row > 0:
        total -= _on_edge(slopes, image, row - 1, column, 1) * per_y
    found[image, row, column] = total


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


def divergence_of(slopes: torch.Tensor, steps_m: tuple[float, float]) -> torch.Tensor:
    """Divergence [1/m] of slopes along the edges of pixels, float32, [image, h, w, 2]."""
    size = tuple(slopes.shape[:3])
    found = torch.empty(size, dtype=torch.float64, device=slopes.device)
    launch(_divergence_kernel, size, [slopes, *(1.0 / step for step in steps_m), found])
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
