# SPDX-License-Identifier: Apache-2.0
"""Sums and minima over the entries of an environment, on the device; sums in a fixed order.

One thread block an environment (one thread on the CPU): each thread makes a strided partial sum,
with compensation [Neumaier 1974], and the block adds its threads up as a tree. However many
environments there are and whatever they hold, the sum of one of them is bitwise the same.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.capacity import ListRoom, list_end

wp.set_module_options({"enable_backward": False})

BLOCK_THREADS = 128
"""Threads of a block on a GPU."""


@wp.func_native("""
    double* const place = wp::address(values, env);
#if defined(__CUDA_ARCH__)
    atomicMin(reinterpret_cast<long long*>(place), __double_as_longlong(value));
#else
    if (value < *place) *place = value;
#endif
""")
def lower_to(values: wp.array(dtype=wp.float64), env: int, value: wp.float64) -> None:
    """Lower an entry to a value, whoever else does so meanwhile; both at least 0, or the entry
    becomes some negative value.

    The bits of such numbers are ordered as integers, of which a GPU finds the least without a
    thread waiting for another one, as those of ``wp.atomic_min`` of doubles do.
    """
    ...


@wp.func
def add_compensated(sum_and_loss: wp.vec2d, value: wp.float64) -> wp.vec2d:
    """A sum and what rounding has taken from it so far, with one value more."""
    total = sum_and_loss[0] + value
    if wp.abs(sum_and_loss[0]) >= wp.abs(value):
        return wp.vec2d(total, sum_and_loss[1] + ((sum_and_loss[0] - total) + value))
    return wp.vec2d(total, sum_and_loss[1] + ((value - total) + sum_and_loss[0]))


@wp.func
def compensated_total(sum_and_loss: wp.vec2d) -> wp.float64:
    """The sum; without its loss when that is not a number (a sum that is infinite)."""
    if wp.isfinite(sum_and_loss[1]):
        return sum_and_loss[0] + sum_and_loss[1]
    return sum_and_loss[0]


@wp.func
def block_total(value: wp.float64) -> wp.float64:
    """Sum of one value of each thread of the block."""
    return wp.tile_extract(wp.tile_sum(wp.tile(value)), 0)


@wp.func
def lane_sum(env: int, lane: int, values: wp.array2d(dtype=wp.float64), count: int) -> wp.float64:
    """Strided partial sum of the first entries of a row."""
    total = wp.vec2d()
    for i in range(lane, count, wp.block_dim()):
        total = add_compensated(total, values[env, i])
    return compensated_total(total)


@wp.func
def lane_list_sum(
    env: int, lane: int, values: wp.array(dtype=wp.float64), room: ListRoom
) -> wp.float64:
    """Strided partial sum of a list."""
    total = wp.vec2d()
    for at in range(room.starts[env] + lane, list_end(env, room), wp.block_dim()):
        total = add_compensated(total, values[at])
    return compensated_total(total)


@wp.kernel
def _add_rows_kernel(
    active: wp.array(dtype=wp.int32),
    values: wp.array2d(dtype=wp.float64),
    totals: wp.array(dtype=wp.float64),
):
    env, lane = wp.tid()
    if active[env] == 0:
        return
    total = block_total(lane_sum(env, lane, values, values.shape[1]))
    if lane == 0:
        totals[env] += total


@wp.kernel
def _add_lists_kernel(
    active: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.float64),
    room: ListRoom,
    totals: wp.array(dtype=wp.float64),
):
    env, lane = wp.tid()
    if active[env] == 0:
        return
    total = block_total(lane_list_sum(env, lane, values, room))
    if lane == 0:
        totals[env] += total


@wp.func
def block_slope(
    env: int,
    lane: int,
    gradient_a: wp.array2d(dtype=wp.vec3d),
    gradient_b: wp.array2d(dtype=wp.vec3d),
    gradient_c: wp.array2d(dtype=wp.vec3d),
    direction: wp.array2d(dtype=wp.vec3d),
) -> wp.float64:
    """Sum of three nodal gradients times a direction, of an environment, by its block."""
    total = wp.vec2d()
    for i in range(lane, direction.shape[1], wp.block_dim()):
        g = gradient_a[env, i] + gradient_b[env, i] + gradient_c[env, i]
        total = add_compensated(total, wp.dot(g, direction[env, i]))
    return block_total(compensated_total(total))


@wp.func
def lane_lengths(
    env: int, lane: int, vectors: wp.array2d(dtype=wp.vec3d), first: int, end: int
) -> wp.float64:
    """Strided partial sum of the lengths of vectors of a range."""
    total = wp.vec2d()
    for i in range(first + lane, end, wp.block_dim()):
        total = add_compensated(total, wp.length(vectors[env, i]))
    return compensated_total(total)


@wp.kernel
def _body_sums_kernel(
    active: wp.array(dtype=wp.int32),
    reduced: wp.array2d(dtype=wp.vec3d),
    contact: wp.array2d(dtype=wp.vec3d),
    rows: wp.array(dtype=wp.vec2i),
    nodes: wp.array(dtype=wp.vec2i),
    residuals: wp.array2d(dtype=wp.float64),
    contact_forces: wp.array2d(dtype=wp.float64),
):
    env, body, lane = wp.tid()
    if active[env] == 0:
        return
    residual = block_total(lane_lengths(env, lane, reduced, rows[body][0], rows[body][1]))
    force = block_total(lane_lengths(env, lane, contact, nodes[body][0], nodes[body][1]))
    if lane == 0:
        residuals[env, body] = residual
        contact_forces[env, body] = force


def launch_rows(kernel: wp.Kernel, inputs: list, outputs: list) -> None:
    """Launch one thread block for each entry of the mask that comes first in ``inputs``."""
    active = inputs[0]
    wp.launch_tiled(
        kernel,
        dim=[len(active)],
        inputs=inputs,
        outputs=outputs,
        block_dim=BLOCK_THREADS,
        device=active.device,
    )


def add_row_sums(
    active: wp.array, values: wp.array, room: ListRoom | None, totals: wp.array
) -> None:
    """Add the sum of each row, or of the entries of each environment in a list with such a
    ``room``, to ``totals``."""
    if room is None:
        launch_rows(_add_rows_kernel, [active, values], [totals])
    else:
        launch_rows(_add_lists_kernel, [active, values, room], [totals])


def force_sums(
    active: wp.array,
    reduced: wp.array,
    contact_gradient: wp.array,
    rows: wp.array,
    nodes: wp.array,
    residuals: wp.array,
    contact_forces: wp.array,
) -> None:
    """Sums of the magnitudes of the gradient by the unknowns [N] and of the contact forces on the
    nodes [N] of each body, [env_count, body_count].

    ``rows``, ``nodes``: ranges of each body in the two gradients, vec2i, [body_count].
    """
    wp.launch_tiled(
        _body_sums_kernel,
        dim=[len(active), len(rows)],
        inputs=[active, reduced, contact_gradient, rows, nodes],
        outputs=[residuals, contact_forces],
        block_dim=BLOCK_THREADS,
        device=active.device,
    )
