# SPDX-License-Identifier: Apache-2.0
"""Sums over the entries of an environment, on the device and in a fixed order.

One thread block an environment (one thread on the CPU): each thread adds every so manyth entry,
with compensation [Neumaier 1974], and the block adds its threads up as a tree. However many
environments there are and whatever they hold, the sum of one of them is bitwise the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

wp.set_module_options({"enable_backward": False})

BLOCK_THREADS = 128
"""Threads of a block on a GPU."""


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
def _lane_sum(env: int, lane: int, values: wp.array2d(dtype=wp.float64), count: int) -> wp.float64:
    """Sum of every so manyth of the first entries of a row."""
    total = wp.vec2d()
    for i in range(lane, count, wp.block_dim()):
        total = add_compensated(total, values[env, i])
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
    total = block_total(_lane_sum(env, lane, values, values.shape[1]))
    if lane == 0:
        totals[env] += total


@wp.kernel
def _add_lists_kernel(
    active: wp.array(dtype=wp.int32),
    values: wp.array2d(dtype=wp.float64),
    counts: wp.array(dtype=wp.int32),
    totals: wp.array(dtype=wp.float64),
):
    env, lane = wp.tid()
    if active[env] == 0:
        return
    total = block_total(_lane_sum(env, lane, values, wp.min(counts[env], values.shape[1])))
    if lane == 0:
        totals[env] += total


@wp.kernel
def _energies_kernel(
    active: wp.array(dtype=wp.int32),
    fixed: wp.array2d(dtype=wp.float64),
    contact: wp.array2d(dtype=wp.float64),
    contact_counts: wp.array(dtype=wp.int32),
    friction: wp.array2d(dtype=wp.float64),
    friction_counts: wp.array(dtype=wp.int32),
    base: wp.array(dtype=wp.float64),
    totals: wp.array(dtype=wp.float64),
):
    env, lane = wp.tid()
    if active[env] == 0:
        return
    if fixed:
        count = wp.min(contact_counts[env], contact.shape[1])
        mine = _lane_sum(env, lane, fixed, fixed.shape[1])
        mine += _lane_sum(env, lane, contact, count)
        all_of_base = block_total(mine)
        if lane == 0:
            base[env] = all_of_base
            totals[env] = all_of_base
    if friction:
        mine = _lane_sum(env, lane, friction, wp.min(friction_counts[env], friction.shape[1]))
        all_of_friction = block_total(mine)
        if lane == 0:
            totals[env] = base[env] + all_of_friction


@wp.kernel
def _slope_kernel(
    active: wp.array(dtype=wp.int32),
    gradient_a: wp.array2d(dtype=wp.vec3d),
    gradient_b: wp.array2d(dtype=wp.vec3d),
    gradient_c: wp.array2d(dtype=wp.vec3d),
    direction: wp.array2d(dtype=wp.vec3d),
    totals: wp.array(dtype=wp.float64),
):
    env, lane = wp.tid()
    if active[env] == 0:
        return
    total = wp.vec2d()
    for i in range(lane, direction.shape[1], wp.block_dim()):
        g = gradient_a[env, i] + gradient_b[env, i] + gradient_c[env, i]
        total = add_compensated(total, wp.dot(g, direction[env, i]))
    total_of_block = block_total(compensated_total(total))
    if lane == 0:
        totals[env] = total_of_block


@wp.kernel
def _norms_kernel(
    active: wp.array(dtype=wp.int32),
    reduced: wp.array2d(dtype=wp.vec3d),
    contact: wp.array2d(dtype=wp.vec3d),
    residuals: wp.array(dtype=wp.float64),
    contact_forces: wp.array(dtype=wp.float64),
):
    env, lane = wp.tid()
    if active[env] == 0:
        return
    squares = wp.vec2d()
    for i in range(lane, reduced.shape[1], wp.block_dim()):
        squares = add_compensated(squares, wp.length_sq(reduced[env, i]))
    lengths = wp.vec2d()
    for i in range(lane, contact.shape[1], wp.block_dim()):
        lengths = add_compensated(lengths, wp.length(contact[env, i]))
    square = block_total(compensated_total(squares))
    length = block_total(compensated_total(lengths))
    if lane == 0:
        residuals[env] = wp.sqrt(square)
        # Action and reaction: half of the sum over both sides of all contacts.
        contact_forces[env] = wp.float64(0.5) * length


def _launch(kernel: wp.Kernel, inputs: list, outputs: list) -> None:
    active = inputs[0]
    wp.launch_tiled(
        kernel,
        dim=[len(active)],
        inputs=inputs,
        outputs=outputs,
        block_dim=BLOCK_THREADS,
        device=active.device,
    )


def sum_energies(
    active: wp.array,
    fixed: wp.array | None,
    contact: EnergyTerm,
    friction: EnergyTerm | None,
    base: wp.array,
    totals: wp.array,
) -> None:
    """Sum the energies that terms have written: without friction to ``base``, with it to ``totals``
    [J], [env_count]. ``fixed``: those of ``share_buffer``; when None the base is taken as it is."""
    if fixed is None and friction is None:
        wp.copy(totals, base)
        return
    frozen = [friction.energies, friction.counts] if friction else [None, None]
    _launch(
        _energies_kernel, [active, fixed, contact.energies, contact.counts, *frozen], [base, totals]
    )


def slopes(active: wp.array, gradients: list[wp.array], direction: wp.array, out: wp.array) -> None:
    """Sum of three nodal gradients times a direction, by environment, to ``out`` [env_count]."""
    _launch(_slope_kernel, [active, *gradients, direction], [out])


def force_norms(
    active: wp.array,
    reduced: wp.array,
    contact_gradient: wp.array,
    residuals: wp.array,
    contact_forces: wp.array,
) -> None:
    """Norm of the gradient by the unknowns [N], and the sum of all contact forces [N]."""
    _launch(_norms_kernel, [active, reduced, contact_gradient], [residuals, contact_forces])


class EnergyTerm:
    """A term of the energy whose sum may also be asked for by the host."""

    energies: wp.array
    """Energy of each item [J], float64, shape [env_count, item_count]."""
    counts: wp.array | None = None
    """How many items there are, int32, shape [env_count]; all when None."""

    def write_energies(self, active: wp.array, at: Any, /) -> None:
        """Fill ``energies`` of active environments."""
        raise NotImplementedError

    def add_energy(self, active: wp.array, positions: Any, totals: wp.array) -> None:
        """Add the energy [J] to ``totals``, float64, shape [env_count], where active."""
        self.write_energies(active, positions)
        if self.counts is None:
            _launch(_add_rows_kernel, [active, self.energies], [totals])
        else:
            _launch(_add_lists_kernel, [active, self.energies, self.counts], [totals])

    def energy(self, active: wp.array, positions: Any) -> np.ndarray:
        """Energy [J] at positions (or, of friction, after a motion), shape [env_count]; zero where
        not active."""
        totals = wp.zeros(len(active), dtype=wp.float64, device=active.device)
        self.add_energy(active, positions, totals)
        return totals.numpy()


def share_buffer(terms: Sequence[EnergyTerm], env_count: int, device: wp.Device) -> wp.array:
    """Energies of all terms side by side, float64, [env_count, all items]: one sum for all."""
    widths = [term.energies.shape[1] for term in terms]
    buffer = wp.zeros((env_count, max(sum(widths), 1)), dtype=wp.float64, device=device)
    start = 0
    for term, width in zip(terms, widths, strict=True):
        term.energies = buffer[:, start : start + width]
        start += width
    return buffer
