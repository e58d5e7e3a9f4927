# SPDX-License-Identifier: Apache-2.0
"""The kernel that factors and solves in block-arrow form, for each memory that a block may have."""

from __future__ import annotations

from functools import cache
from typing import Any

import warp as wp

from taccel_lab.ipc.device.block_ops import block_barrier, team_sum
from taccel_lab.ipc.device.dense_inverse import address_of_tile
from taccel_lab.ipc.linear.arrow.factor import (
    factor_columns,
    finish_factor,
    get_number,
    get_vector,
    load_matrix,
    put_vector,
    solve_factored,
)
from taccel_lab.ipc.linear.arrow.program import ArrowLayout
from taccel_lab.ipc.linear.problem.extra_rows import ExtraRows
from taccel_lab.ipc.linear.problem.packed_rows import RowSlices
from taccel_lab.ipc.linear.problem.row_products import multiply_extra, multiply_unpacked, row_sum

wp.set_module_options({"enable_backward": False})


@wp.struct
class ArrowLists:
    """What all environments share.

    order: row at each place. codes: block of the pattern of each block of the factor, -1 for none.
    program: see ``ArrowLayout``. border_codes: of the blocks of border rows among themselves.
    border_places: place of each row in the border, -1 for none. places: of all rows.
    """

    order: wp.array(dtype=wp.int32)
    codes: wp.array(dtype=wp.int32)
    program: wp.array(dtype=wp.int32)
    border_codes: wp.array(dtype=wp.int32)
    border_places: wp.array(dtype=wp.int32)
    places: wp.array(dtype=wp.int32)


@wp.struct
class ArrowWork:
    """What an environment has in global memory, [env_count, ...].

    numbers: the factor and its vectors, without shared memory. For CG: p by places and products of
    segments. dots, gates: see ``team_sum``."""

    numbers: wp.array2d(dtype=wp.float64)
    p: wp.array2d(dtype=wp.vec3d)
    p_scalars: wp.array2d(dtype=wp.float64)
    parts: wp.array2d(dtype=wp.vec3d)
    parts_scalars: wp.array2d(dtype=wp.float64)
    dots: wp.array2d(dtype=wp.vec3d)
    gates: wp.array(dtype=wp.int32)


@wp.func_native("return reinterpret_cast<wp::uint64>(numbers.data);")
def _address_of_numbers(numbers: wp.array(dtype=wp.float64)) -> wp.uint64: ...


@wp.func_native("return reinterpret_cast<wp::uint64>(words.data);")
def _address_of_words(words: wp.array(dtype=wp.int32)) -> wp.uint64: ...


# As a pointer: from a sum of integers the compiler would not know shared memory.
@wp.func_native(
    "return reinterpret_cast<wp::uint64>(reinterpret_cast<wp::float64*>(memory) + first);"
)
def _address_of_inner_words(memory: wp.uint64, first: int) -> wp.uint64: ...


@cache
def solve_kernel(room: int, words_inside: bool) -> Any:
    """The kernel for a ``Placement``; in its own module, so that none is compiled that no scene
    needs."""
    address = address_of_tile(max(room, 1))

    @wp.kernel(grid_stride=False, launch_bounds=(512, 1), module="unique", enable_backward=False)
    def arrow_kernel(
        lanes: int,
        active: wp.array(dtype=wp.int32),
        lists: ArrowLists,
        layout: ArrowLayout,
        slices: RowSlices,
        values: wp.array2d(dtype=wp.float64),
        extra_counts: wp.array(dtype=wp.int32),
        extra: ExtraRows,
        extra_places: wp.array(dtype=wp.vec2i),
        extra_values: wp.array(dtype=wp.float64),
        rhs: wp.array2d(dtype=wp.vec3d),
        tolerances: wp.array(dtype=wp.float64),
        max_iterations: int,
        reach: wp.float64,
        work: ArrowWork,
        solutions: wp.array2d(dtype=wp.vec3d),
        iterations: wp.array(dtype=wp.int32),
        residuals: wp.array(dtype=wp.float64),
        breakdowns: wp.array(dtype=wp.int32),
    ):
        env, lane = wp.tid()
        # Decided as it is compiled: the compiler has to see which kind of memory it is.
        if room:
            tile = wp.tile_empty(shape=room, dtype=wp.float64, storage="shared")
            memory = address(tile)
        else:
            memory = _address_of_numbers(work.numbers[env])
        if words_inside:
            program = _address_of_inner_words(memory, layout.words)
        else:
            program = _address_of_words(lists.program)
        n = rhs.shape[1]
        dots = work.dots[env]
        zero = wp.float64(0.0)
        infinity = wp.float64(wp.inf)
        share = wp.vec3d()
        for place in range(lane, n, lanes):
            row = lists.order[place]
            load = rhs[env, row]
            solutions[env, row] = wp.vec3d()
            share[0] += wp.dot(load, load)
            put_vector(memory, layout.r, place, load)
            put_vector(memory, layout.z, place, load)
        if lane == 0:
            iterations[env] = 0
            residuals[env] = zero
            breakdowns[env] = 0
        if active[env] == 0:
            return
        b_sq = team_sum(share, env, 0, 1, lane, 0, work.gates, dots)[0]
        if b_sq == zero:
            return
        first = extra.starts[env][0]
        end = extra.starts[env + 1][0]
        extra_count = int(0)
        if extra_counts[env] > 0:
            extra_count = extra.totals[env, 0]
        load_matrix(
            memory,
            program,
            lane,
            lanes,
            layout,
            lists.program,
            lists.codes,
            values[env],
            lists.border_codes,
            lists.places,
            lists.border_places,
            extra_count,
            extra.codes[2 * first : 2 * end],
            extra_places[first:end],
            extra_values[9 * first : 9 * end],
        )
        factor_columns(memory, program, lane, lanes, layout)
        finish_factor(memory, program, lane, lanes, layout)
        exact = get_number(memory, layout.flag) == zero
        p = work.p[env]
        p_scalars = work.p_scalars[env]
        parts = work.parts_scalars[env]
        goal = tolerances[env] * tolerances[env] * b_sq
        r_sq = b_sq
        rho_old = zero
        scale = wp.float64(1.0)
        count = int(0)
        broken = int(0)
        # One loop for both cases: a second copy of the solve would double the code to fetch.
        going = int(1)
        while going == 1:
            going = int(0)
            solve_factored(memory, program, lane, lanes, layout, int(count == 0))
            share = wp.vec3d()
            for place in range(lane, n, lanes):
                x_row = get_vector(memory, layout.x, place)
                share[0] += wp.dot(get_vector(memory, layout.r, place), x_row)
                share[1] += wp.dot(x_row, x_row)
            # The other turn than the sum before, or barriers between them.
            share = team_sum(share, env, 0, 1, lane, 1, work.gates, dots)
            rho = share[0]
            shrink = wp.min(reach / wp.sqrt(share[1]), wp.float64(1.0))
            if count == 0 and get_number(memory, layout.flag + 1) != zero:
                broken = int(1)
                scale = shrink
            if not (rho > zero and rho < infinity and b_sq < infinity):
                broken = int(1)
            elif exact:
                for place in range(lane, n, lanes):
                    solutions[env, lists.order[place]] = scale * get_vector(memory, layout.x, place)
                count = int(1)
                r_sq = zero
            else:
                for place in range(lane, n, lanes):
                    p_row = get_vector(memory, layout.x, place)
                    if count > 0:
                        p_row += rho / rho_old * p[place]
                    p[place] = p_row
                rho_old = rho
                block_barrier()
                end = 3 * slices.segments.shape[0]
                share = wp.vec3d()
                share[0] = multiply_unpacked(
                    lane, end, lanes, slices, values[env], p_scalars, parts
                )
                share[0] += multiply_extra(env, lane, lanes, extra, extra_values, p_scalars)
                curvature = team_sum(share, env, 0, 1, lane, 0, work.gates, dots)[0]
                if count == 0 and curvature <= zero and curvature > -infinity:
                    # The factor is positive definite: this way leads down, further and further.
                    for place in range(lane, n, lanes):
                        solutions[env, lists.order[place]] = shrink * p[place]
                    count = int(1)
                    broken = int(1)
                elif not (curvature > zero and curvature < infinity):
                    broken = int(1)
                else:
                    alpha = rho / curvature
                    share = wp.vec3d()
                    for place in range(lane, n, lanes):
                        row = lists.order[place]
                        solutions[env, row] = solutions[env, row] + alpha * p[place]
                        r_row = get_vector(memory, layout.r, place)
                        r_row -= alpha * row_sum(env, place, slices, True, extra, work.parts[env])
                        put_vector(memory, layout.r, place, r_row)
                        put_vector(memory, layout.z, place, r_row)
                        share[0] += wp.dot(r_row, r_row)
                    r_sq = team_sum(share, env, 0, 1, lane, 1, work.gates, dots)[0]
                    count += 1
                    if r_sq > goal and count < max_iterations:
                        going = int(1)
        if lane == 0:
            iterations[env] = count
            breakdowns[env] = broken
            residuals[env] = wp.sqrt(r_sq / b_sq)
            if count == 0:
                residuals[env] = wp.float64(1.0)

    return arrow_kernel
