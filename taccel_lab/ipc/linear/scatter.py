# SPDX-License-Identifier: Apache-2.0
"""Adding 3x3 blocks of a contact stencil to the Newton system."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.struct
class NewtonSystem:
    """H p = rhs of all environments, over free nodes.

    free_index: row of a node or -1 when its motion is prescribed, [node_count].
    row_starts, columns: shared block pattern of the lower triangle.
    values: blocks of the lower triangle [N/m], [env_count, block_count].
    rhs: right-hand side [N], [env_count, free_count].
    displacements: motion of prescribed nodes over this iteration [m], [env_count, node_count].
    """

    free_index: wp.array(dtype=wp.int32)
    row_starts: wp.array(dtype=wp.int32)
    columns: wp.array(dtype=wp.int32)
    values: wp.array2d(dtype=wp.mat33d)
    rhs: wp.array2d(dtype=wp.vec3d)
    displacements: wp.array2d(dtype=wp.vec3d)


@wp.func
def find_block(
    row: int, column: int, row_starts: wp.array(dtype=wp.int32), columns: wp.array(dtype=wp.int32)
) -> int:
    """Index of block (row, column), column <= row, in the pattern, -1 when absent."""
    low = row_starts[row]
    high = row_starts[row + 1] - 1
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


@wp.func
def add_block(env: int, node_i: int, node_j: int, block: wp.mat33d, system: NewtonSystem):
    """Add d^2E/dx_i dx_j: to the matrix, or to the right-hand side when node j is prescribed.

    Called for both orders of a pair; only the one in the lower triangle is stored.
    """
    row = system.free_index[node_i]
    if row < 0:
        return
    column = system.free_index[node_j]
    if column < 0:
        wp.atomic_sub(system.rhs, env, row, block * system.displacements[env, node_j])
    elif column <= row:
        index = find_block(row, column, system.row_starts, system.columns)
        wp.atomic_add(system.values, env, index, block)
