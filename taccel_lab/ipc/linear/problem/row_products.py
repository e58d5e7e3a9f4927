# SPDX-License-Identifier: Apache-2.0
"""Products of the matrix with a vector, by the lanes of thread blocks."""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.device.native import native
from taccel_lab.ipc.linear.problem.extra_rows import ExtraRows, extra_slice
from taccel_lab.ipc.linear.problem.packed_rows import RowSlices, packed_product

wp.set_module_options({"enable_backward": False})


@wp.func_native(native("row_products", "segment_product"))
def _segment_product(
    first: int,
    end: int,
    stride: int,
    component: int,
    columns: wp.array(dtype=wp.int32),
    codes: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.float64),
    x: wp.array(dtype=wp.float64),
) -> wp.float64:
    """One scalar row of the product of listed blocks with x; every ``stride``-th, up to none."""
    ...


@wp.func
def unpacked_product(
    task: int,
    layout: RowSlices,
    values: wp.array(dtype=wp.float64),
    x: wp.array(dtype=wp.float64),
) -> wp.float64:
    """Product of a scalar row of a slice with x, straight from the blocks of the pattern."""
    span = layout.slices[task / 32]
    return _segment_product(
        span[0] + task % 32,
        span[0] + 32 * span[1],
        32,
        task % 3,
        layout.columns,
        layout.codes,
        values,
        x,
    )


@wp.func
def multiply_unpacked(
    first: int,
    end: int,
    step: int,
    layout: RowSlices,
    values: wp.array(dtype=wp.float64),
    x: wp.array(dtype=wp.float64),
    parts: wp.array(dtype=wp.float64),
) -> wp.float64:
    """parts = A x for tasks first, first + step, ...: scalar rows of segments, without the extra
    blocks; straight from the pattern, for few products. Returns their share of x . A x."""
    share = wp.float64(0.0)
    for task in range(first, end, step):
        segment = layout.segments[task / 3]
        if segment[0] >= 0:
            part = unpacked_product(task, layout, values, x)
            parts[3 * segment[1] + task % 3] = part
            share += part * x[3 * segment[0] + task % 3]
    return share


@wp.func
def multiply_extra(
    env: int,
    first: int,
    step: int,
    extra: ExtraRows,
    extra_values: wp.array(dtype=wp.float64),
    x: wp.array(dtype=wp.float64),
) -> wp.float64:
    """The same for the segments of extra blocks, which have their own parts."""
    share = wp.float64(0.0)
    blocks = extra.starts[env][0]
    segments = extra.starts[env][1]
    packed = extra.starts[env][2]
    slices = extra_slice(env, extra)
    for task in range(first, 3 * extra.totals[env, 1], step):
        segment = extra.segments[segments + task / 3]
        span = extra.slices[slices + task / 32]
        part = wp.float64(0.0)
        if span[0] >= 0:
            part = packed_product(
                packed + span[0], span[1], task % 32, extra.packed_columns, extra.packed, x
            )
        else:
            part = _segment_product(
                2 * blocks + segment[1],
                2 * blocks + segment[2],
                1,
                task % 3,
                extra.columns,
                extra.codes,
                extra_values[9 * blocks : 9 * extra.starts[env + 1][0]],
                x,
            )
        extra.part_scalars[3 * segments + task] = part
        share += part * x[3 * segment[0] + task % 3]
    return share


@wp.func
def row_sum(
    env: int,
    row: int,
    layout: RowSlices,
    has_extra: bool,
    extra: ExtraRows,
    parts: wp.array(dtype=wp.vec3d),
) -> wp.vec3d:
    """A row of the product from its segments. ``has_extra``: whether there are any extra blocks,
    whose lists are not read otherwise."""
    total = wp.vec3d()
    for s in range(layout.row_segments[row], layout.row_segments[row + 1]):
        total += parts[s]
    if not has_extra:
        return total
    more = extra.row_segments[env, row]
    first = extra.starts[env][1] + more[0]
    for s in range(first, first + more[1]):
        total += extra.parts[s]
    return total


@wp.func
def row_component(
    env: int,
    task: int,
    layout: RowSlices,
    has_extra: bool,
    extra: ExtraRows,
    parts: wp.array(dtype=wp.float64),
) -> wp.float64:
    """One scalar of ``row_sum``, ``task`` = 3 row + component."""
    row = task / 3
    component = task - 3 * row
    total = wp.float64(0.0)
    for s in range(layout.row_segments[row], layout.row_segments[row + 1]):
        total += parts[3 * s + component]
    if not has_extra:
        return total
    more = extra.row_segments[env, row]
    first = extra.starts[env][1] + more[0]
    for s in range(first, first + more[1]):
        total += extra.part_scalars[3 * s + component]
    return total
