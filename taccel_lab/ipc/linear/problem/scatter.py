# SPDX-License-Identifier: Apache-2.0
"""Adding 3x3 blocks between nodes of any kind to the Newton system."""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.device.native import native
from taccel_lab.ipc.device.ragged_lists import ListRoom, claim_place
from taccel_lab.ipc.device.sums import (
    MEASURE,
    SumStage,
    add_vector,
    block_exponent,
    note_addend,
    place_anchor,
    rounded_block,
)

wp.set_module_options({"enable_backward": False})


@wp.struct
class NewtonSystem:
    """H p = rhs of all environments, over free nodes.

    free_index: row of a node or -1 when it has none, [node_count].
    parents: first control node of the affine body that a node is embedded in, or -1, [node_count].
    weights: weights of the four control nodes of an embedded node, [node_count].
    row_starts, columns: shared block pattern of the lower triangle.
    values: blocks of the lower triangle [N/m], [env_count, block_count].
    extra_room, extra_places, extra_values: list of blocks (row > column) outside of the pattern,
    which add up, [capacity]; counts beyond the room tell the host to grow the list and to assemble
    again.
    rhs: right-hand side [N], [env_count, free_count].
    displacements: motion of prescribed nodes over this iteration [m], [env_count, node_count].
    block_sums, rhs_sums: how blocks and right-hand sides are added up. Blocks outside of the
    pattern count as addends of the diagonal of their row.
    """

    free_index: wp.array(dtype=wp.int32)
    parents: wp.array(dtype=wp.int32)
    weights: wp.array(dtype=wp.vec4d)
    row_starts: wp.array(dtype=wp.int32)
    columns: wp.array(dtype=wp.int32)
    values: wp.array2d(dtype=wp.mat33d)
    extra_room: ListRoom
    extra_places: wp.array(dtype=wp.vec2i)
    extra_values: wp.array(dtype=wp.mat33d)
    rhs: wp.array2d(dtype=wp.vec3d)
    displacements: wp.array2d(dtype=wp.vec3d)
    block_sums: SumStage
    rhs_sums: SumStage


@wp.func
def find_block(
    row: int, column: int, row_starts: wp.array(dtype=wp.int32), columns: wp.array(dtype=wp.int32)
) -> int:
    """Index of block (row, column), column <= row, in the pattern, -1 when absent.

    The diagonal comes last. Where the pattern holds all columns up to it the place of a column is
    known: so it is for the diagonal itself and among the control nodes of an affine body, eleven of
    the fifteen blocks of a gel node on a face of such a body. Others are behind that place, and are
    searched for.
    """
    low = row_starts[row]
    high = row_starts[row + 1] - 1
    known = high - (row - column)
    if known >= low:
        if columns[known] == column:
            return known
        low = known + 1
    while low <= high:
        middle = (low + high) / 2
        found = columns[middle]
        if found == column:
            return middle
        if found < column:
            low = middle + 1
        else:
            high = middle - 1
    return -1


@wp.func_native(native("scatter", "add_to_block"))
def add_to_block(
    env: int,
    index: int,
    block: wp.mat33d,
    anchor: wp.float64,
    values: wp.array2d(dtype=wp.mat33d),
) -> None:
    """Add to a block of the matrices of all environments, [env_count, block_count]; on the grid of
    an anchor other than zero."""
    ...


@wp.func
def add_entry(env: int, row: int, column: int, block: wp.mat33d, system: NewtonSystem):
    """Add a block of the lower triangle; one of the upper triangle is left to its mirror image."""
    if column > row:
        return
    index = find_block(row, column, system.row_starts, system.columns)
    anchor = wp.float64(0.0)
    if system.block_sums.stage > 0:
        place = index
        if index < 0:
            place = system.row_starts[row + 1] - 1
        if system.block_sums.stage == MEASURE:
            note_addend(env, place, block_exponent(block), system.block_sums)
            return
        anchor = place_anchor(env, place, system.block_sums)
    if index >= 0:
        add_to_block(env, index, block, anchor, system.values)
        return
    at = claim_place(env, system.extra_room)
    if at >= 0:
        system.extra_places[at] = wp.vec2i(row, column)
        system.extra_values[at] = rounded_block(block, anchor)


@wp.func
def take_from_rhs(env: int, row: int, force: wp.vec3d, system: NewtonSystem):
    """Subtract a force [N] from the right-hand side."""
    add_vector(env, row, -force, system.rhs, system.rhs_sums)


@wp.func
def add_block(env: int, node_i: int, node_j: int, block: wp.mat33d, system: NewtonSystem):
    """Add d^2E/dx_i dx_j: to the matrix, or to the right-hand side when node j is prescribed.

    A node embedded in an affine body stands for its four control nodes. Called for both orders of
    a pair; only the one in the lower triangle is stored.
    """
    row = system.free_index[node_i]
    column = system.free_index[node_j]
    parent_i = system.parents[node_i]
    parent_j = system.parents[node_j]
    # Held in a variable: unrolled, these loops take minutes to compile for a GPU.
    count = int(4)
    if row >= 0:
        if column >= 0:
            add_entry(env, row, column, block, system)
        elif parent_j >= 0:
            for k in range(count):
                w = system.weights[node_j][k]
                add_entry(env, row, system.free_index[parent_j + k], w * block, system)
        else:
            take_from_rhs(env, row, block * system.displacements[env, node_j], system)
    elif parent_i >= 0:
        for k in range(count):
            scaled = system.weights[node_i][k] * block
            row_k = system.free_index[parent_i + k]
            if column >= 0:
                add_entry(env, row_k, column, scaled, system)
            elif parent_j >= 0:
                for m in range(count):
                    w = system.weights[node_j][m]
                    add_entry(env, row_k, system.free_index[parent_j + m], w * scaled, system)
            else:
                take_from_rhs(env, row_k, scaled * system.displacements[env, node_j], system)
