# SPDX-License-Identifier: Apache-2.0
"""Sums and minima on the device that do not depend on the order of their addends.

Over the entries of an environment, one thread block (one thread on the CPU) works: each thread
makes a strided partial sum, with compensation [Neumaier 1974], and the block adds its threads up as
a tree. However many environments there are and whatever they hold, the sum of one of them is
bitwise the same.

Atomic additions arrive in any order on a GPU, and each rounds. They do not where all addends of a
place are multiples of one power of two that is coarse enough for every partial sum: then the sum is
exact in any order. So addends are rounded to such a grid first, as in pre-rounded summation [Rump,
Ogita and Oishi 2008; Demmel and Nguyen 2013, Fast reproducible floating-point summation]. With
n addends of a place, of which the largest is below 2^e, the grid is 2^(e + log2 n - 51) or finer: a
place with a dozen of them keeps 47 bits of the largest.

Where the grid lies is found by the same kernel over the same addends, launched once to measure and
once more to add. What is added to must be zero before.
"""

from __future__ import annotations

from collections.abc import Iterator

import warp as wp

from taccel_lab.ipc.device.native import native
from taccel_lab.ipc.device.ragged_lists import ListRoom, list_end
from taccel_lab.model.env_lists import EnvMask, Envs, env_at
from taccel_lab.model.launches import launch_blocks

BLOCK_THREADS = 128
"""Threads of a block on a GPU."""
wp.set_module_options({"enable_backward": False, "block_dim": BLOCK_THREADS})


@wp.func_native(native("sums", "lower_to"))
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
    active: Envs,
    values: wp.array2d(dtype=wp.float64),
    totals: wp.array(dtype=wp.float64),
):
    place, lane = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    total = block_total(lane_sum(env, lane, values, values.shape[1]))
    if lane == 0:
        totals[env] += total


@wp.kernel
def _add_lists_kernel(
    active: Envs,
    values: wp.array(dtype=wp.float64),
    room: ListRoom,
    totals: wp.array(dtype=wp.float64),
):
    place, lane = wp.tid()
    env = env_at(place, active)
    if env < 0:
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
    active: Envs,
    reduced: wp.array2d(dtype=wp.vec3d),
    contact: wp.array2d(dtype=wp.vec3d),
    rows: wp.array(dtype=wp.vec2i),
    nodes: wp.array(dtype=wp.vec2i),
    residuals: wp.array2d(dtype=wp.float64),
    contact_forces: wp.array2d(dtype=wp.float64),
):
    place, body, lane = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    residual = block_total(lane_lengths(env, lane, reduced, rows[body][0], rows[body][1]))
    force = block_total(lane_lengths(env, lane, contact, nodes[body][0], nodes[body][1]))
    if lane == 0:
        residuals[env, body] = residual
        contact_forces[env, body] = force


def add_row_sums(
    active: EnvMask, values: wp.array, room: ListRoom | None, totals: wp.array
) -> None:
    """Add the sum of each row, or of the entries of each environment in a list with such a
    ``room``, to ``totals``."""
    if room is None:
        launch_blocks(_add_rows_kernel, len(active), active, values, totals)
    else:
        launch_blocks(_add_lists_kernel, len(active), active, values, room, totals)


def force_sums(
    active: EnvMask,
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
    inputs = [active, reduced, contact_gradient, rows, nodes, residuals, contact_forces]
    launch_blocks(_body_sums_kernel, (len(active), len(rows)), *inputs)


MEASURE = wp.constant(1)
ROUND = wp.constant(2)


@wp.struct
class SumStage:
    """What a kernel does with its addends.

    stage: 0 added as they are, MEASURE noted but not added, ROUND added on the grid of their place.
    seen: largest exponent of the addends of a place, as the bits of a double have it, and their
    number, [env_count, place_count, 2].
    """

    stage: wp.int32
    seen: wp.array3d(dtype=wp.int32)


@wp.func_native(native("sums", "vector_exponent"))
def vector_exponent(value: wp.vec3d) -> int:
    """Exponent e + 1023 of the largest component, in [2^e, 2^(e + 1)); 0 of zero, 2047 of what is
    not finite."""
    ...


@wp.func_native(native("sums", "block_exponent"))
def block_exponent(block: wp.mat33d) -> int:
    """``vector_exponent`` of a block."""
    ...


@wp.func_native(native("sums", "anchor_of"))
def anchor_of(exponent: int, count: int) -> wp.float64:
    """A number 1.5 2^k whose last bit is the grid of ``count`` (1 or more) addends: adding it to
    one of them and taking it away again rounds that. Not a number where one is not finite."""
    ...


@wp.func_native(native("sums", "rounded_block"))
def rounded_block(block: wp.mat33d, anchor: wp.float64) -> wp.mat33d:
    """Every entry on the grid of the anchor."""
    ...


@wp.func
def note_addend(env: int, place: int, exponent: int, sums: SumStage):
    """One addend more, the exponent of whose largest component is given."""
    wp.atomic_max(sums.seen, env, place, 0, exponent)
    wp.atomic_add(sums.seen, env, place, 1, 1)


@wp.func
def place_anchor(env: int, place: int, sums: SumStage) -> wp.float64:
    """The anchor of a place whose addends were noted."""
    return anchor_of(sums.seen[env, place, 0], sums.seen[env, place, 1])


@wp.func_native(native("sums", "add_rounded"))
def _add_rounded(
    env: int, place: int, value: wp.vec3d, anchor: wp.float64, totals: wp.array2d(dtype=wp.vec3d)
) -> None:
    """Add on the grid of an anchor, or as it is where that is zero."""
    ...


@wp.func
def add_vector(
    env: int, place: int, value: wp.vec3d, totals: wp.array2d(dtype=wp.vec3d), sums: SumStage
):
    """Add to one of the vectors of an environment, [env_count, place_count], or note it."""
    anchor = wp.float64(0.0)
    if sums.stage > 0:
        if sums.stage == MEASURE:
            note_addend(env, place, vector_exponent(value), sums)
            return
        anchor = place_anchor(env, place, sums)
    _add_rounded(env, place, value, anchor, totals)


class ReproducibleSums:
    """The stages in which the sums of an array are formed: one that adds addends as they are, or
    two."""

    def __init__(self, shape: tuple[int, int], device: wp.Device, in_any_order: bool) -> None:
        """``shape``: [env_count, place_count] of what is added to. ``in_any_order``: whether sums
        shall be the same bits in any order."""
        self._seen = None
        if in_any_order:
            self._seen = wp.zeros((*shape, 2), dtype=wp.int32, device=device)

    def stages(self) -> Iterator[SumStage]:
        """What to launch the kernels with that add, one launch of all of them after the other."""
        if self._seen is None:
            yield SumStage()
            return
        self._seen.zero_()
        for number in (MEASURE, ROUND):
            stage = SumStage()
            stage.stage, stage.seen = int(number), self._seen
            yield stage
