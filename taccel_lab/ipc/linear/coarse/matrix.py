# SPDX-License-Identifier: Apache-2.0
"""The parts of a coarse space, and its matrix A_c = P^T A P with its inverse: see ``coarse.space``.

A warp adds up each 6x6 block of A_c, and one thread block inverts it in shared memory.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.ipc.device.block_ops import Team, block_barrier, launch_team, team
from taccel_lab.ipc.device.dense_inverse import (
    address_of_tile,
    get_symmetric,
    lanes_for_inverse,
    put_lower,
    room_for_inverse,
    sweep_all,
)
from taccel_lab.ipc.device.native import native
from taccel_lab.ipc.linear.coarse.space import MODES, MOST_PARTS, CoarseSpace
from taccel_lab.ipc.linear.problem.arrays import LinearProblem
from taccel_lab.ipc.linear.problem.row_plan import RowPlan, connected_rows, neighbour_clusters
from taccel_lab.model.env_lists import EnvMask
from taccel_lab.model.launches import launch

wp.set_module_options({"enable_backward": False})

PART_ROWS = 64
"""Rows of a part, where there are few enough of them."""
_STATIC_BYTES = 4096


@wp.struct
class CoarseMatrix:
    """What adds up in the 6x6 blocks of the lower triangle of A_c.

    pairs: (part, part) of each, the second no larger, [pair_count].
    starts: range of each in the next two, [pair_count + 1].
    codes: block of the matrix as 2 block + transposed.
    places: places of its row and its column.
    """

    pairs: wp.array(dtype=wp.vec2i)
    starts: wp.array(dtype=wp.int32)
    codes: wp.array(dtype=wp.int32)
    places: wp.array(dtype=wp.vec2i)


def has_room(device: wp.Device) -> bool:
    """Whether a thread block of a device has the shared memory for A_c."""
    room = 8 * room_for_inverse(MODES * MOST_PARTS) + _STATIC_BYTES
    return device.is_cpu or int(device.max_shared_memory_per_block) >= room


def coarse_parts(
    problem: LinearProblem, bodies: Sequence[np.ndarray], part_rows: int = PART_ROWS
) -> list[np.ndarray]:
    """Rows of each part: of one gel, of those with more than two parts' worth of rows. None where
    there is no such gel, where the problem does not say where its rows are, and on a device
    without the shared memory.

    A small gel has no need, and none all of whose rows are ``held``, which neither shears nor bends
    as a whole: parts of the 17 gels of the hand saved no iteration. ``bodies``: rows that have
    their own blocks and are in no part.
    """
    rows = np.setdiff1d(np.arange(problem.pattern.free_count), np.concatenate([[], *bodies]))
    if problem.positions_m is None or not has_room(problem.device) or len(rows) <= 2 * part_rows:
        return []
    gels = [
        gel
        for gel in connected_rows(problem.pattern, rows)
        if len(gel) > 2 * part_rows and not problem.held[gel].all()
    ]
    if not 0 < len(gels) < MOST_PARTS:
        return []
    size = max(part_rows, -(-sum(map(len, gels)) // (MOST_PARTS - len(gels))))
    parts = [part for gel in gels for part in neighbour_clusters(problem.pattern, gel, size)]
    return parts if len(parts) <= MOST_PARTS else []


@wp.func_native(native("coarse", "warp_sum"))
def _warp_sum(value: wp.mat33d) -> wp.mat33d:
    """Sum over the lanes of a warp, of which all are there; the CPU has one."""
    ...


@wp.func
def _put_block(
    at: int, first: int, second: int, block: wp.mat33d, blocks: wp.array(dtype=wp.float64)
):
    for i in range(3):
        for j in range(3):
            blocks[at + 6 * (first + i) + second + j] = block[i, j]


@wp.kernel
def _matrix_kernel(
    lanes: int,
    active: wp.array(dtype=wp.int32),
    renewed: wp.array(dtype=wp.int32),
    matrix: CoarseMatrix,
    points: wp.array(dtype=wp.vec3d),
    values: wp.array2d(dtype=wp.mat33d),
    blocks: wp.array2d(dtype=wp.float64),
):
    """One warp a 6x6 block: with P = [I, W] of W v = v x point it is [B, B W; W^T B, W^T B W]."""
    env, pair, lane = wp.tid()
    if active[env] == 0 or renewed[env] == 0:
        return
    shift_shift = wp.mat33d()
    shift_turn = wp.mat33d()
    turn_shift = wp.mat33d()
    turn_turn = wp.mat33d()
    for k in range(matrix.starts[pair] + lane, matrix.starts[pair + 1], lanes):
        code = matrix.codes[k]
        block = values[env, code / 2]
        if code % 2 == 1:
            block = wp.transpose(block)
        left = wp.skew(points[matrix.places[k][0]])
        right = -wp.skew(points[matrix.places[k][1]])
        turned = left * block
        shift_shift += block
        shift_turn += block * right
        turn_shift += turned
        turn_turn += turned * right
    shift_shift = _warp_sum(shift_shift)
    shift_turn = _warp_sum(shift_turn)
    turn_shift = _warp_sum(turn_shift)
    turn_turn = _warp_sum(turn_turn)
    if lane == 0:
        at = 36 * pair
        _put_block(at, 0, 0, shift_shift, blocks[env])
        _put_block(at, 0, 3, shift_turn, blocks[env])
        _put_block(at, 3, 0, turn_shift, blocks[env])
        _put_block(at, 3, 3, turn_turn, blocks[env])


@cache
def _inverse_kernel(room: int) -> Any:
    address = address_of_tile(room)

    @wp.kernel(
        grid_stride=False,
        launch_bounds=(lanes_for_inverse(MODES * MOST_PARTS), 1),
        module="unique",
        enable_backward=False,
    )
    def invert_parts_kernel(
        lanes: int,
        active: wp.array(dtype=wp.int32),
        renewed: wp.array(dtype=wp.int32),
        width: int,
        pairs: wp.array(dtype=wp.vec2i),
        blocks: wp.array2d(dtype=wp.float64),
        inverses: wp.array2d(dtype=wp.float64),
    ):
        env, lane = wp.tid()
        memory = address(wp.tile_empty(shape=room, dtype=wp.float64, storage="shared"))
        if active[env] == 0 or renewed[env] == 0:
            return
        for e in range(lane, width * (width + 1) // 2, lanes):
            put_lower(memory, 0, e, wp.float64(0.0))
        block_barrier()
        size = MODES * MODES
        for e in range(lane, size * pairs.shape[0], lanes):
            pair = pairs[e / size]
            i = MODES * pair[0] + e % size / MODES
            j = MODES * pair[1] + e % MODES
            if j <= i:
                put_lower(memory, i, j, blocks[env, e])
        definite = sweep_all(memory, width, lane, lanes)
        for e in range(lane, width * width, lanes):
            i = e / width
            value = wp.float64(0.0)
            if definite:
                value = -get_symmetric(memory, i, e - width * i)
            inverses[env, e] = value

    return invert_parts_kernel


class CoarseCorrection:
    """The coarse space of a problem, and its matrix as it is now."""

    def __init__(
        self,
        problem: LinearProblem,
        plan: RowPlan,
        parts: Sequence[np.ndarray],
        lanes: int | None = None,
    ) -> None:
        """``parts``: rows of each, with which the plan's single rows begin.
        ``lanes``: of a thread block on the CPU, for tests."""
        self._problem = problem
        device, envs = problem.device, problem.env_count
        count = self._count = len(parts)
        owners = np.full(len(plan.order), -1)
        points = np.zeros((len(owners), 3))
        ends = plan.clustered + np.cumsum([0, *map(len, parts)])
        for part, (start, end) in enumerate(itertools.pairwise(ends)):
            assert problem.positions_m is not None
            own = problem.positions_m[plan.order[start:end]]
            own = own - own.mean(axis=0)
            owners[start:end] = part
            points[start:end] = own / max(float(np.abs(own).max()), np.finfo(float).tiny)

        def put(array: np.ndarray, dtype: type) -> wp.array:
            kind = float if dtype is wp.vec3d else np.int32
            return wp.array(np.asarray(array, dtype=kind), dtype=dtype, device=device)

        space = self.space = CoarseSpace()
        space.width = MODES * count
        space.points, space.parts = put(points, wp.vec3d), put(owners, wp.int32)
        chunks = _chunks(owners, plan.block_starts)
        space.chunks = put(chunks.reshape(-1, 3), wp.vec3i)
        space.block_chunks = put(np.searchsorted(chunks[:, 0], plan.block_starts), wp.int32)
        numbers = np.arange(count)
        spans = [np.searchsorted(chunks[:, 2], numbers, side) for side in ("left", "right")]
        space.spans = put(np.stack(spans, axis=1).reshape(-1, 2), wp.vec2i)
        width = int(space.width)
        for name, size in (
            ("inverses", width * width),
            ("loads", MODES * len(chunks)),
            ("motions", width),
        ):
            setattr(space, name, wp.zeros((envs, size), dtype=wp.float64, device=device))
        if count == 0:
            return
        matrix = self._matrix = _coarse_matrix(problem, plan, owners, put)
        shape = (envs, MODES * MODES * len(matrix.pairs))
        self._blocks = wp.zeros(shape, dtype=wp.float64, device=device)
        self._kernel = _inverse_kernel(room_for_inverse(MODES * MOST_PARTS))
        if not device.is_cpu:
            lanes = lanes_for_inverse(MODES * MOST_PARTS)
        self._team = Team(team(device, envs, 1, lanes).lanes)

    def __str__(self) -> str:
        return f", and the rigid motions of {self._count} parts" if self._count else ""

    def update(self, active: EnvMask) -> None:
        """Form and invert the coarse matrices of the active environments where ``renewed``."""
        if self._count == 0:
            return
        problem, matrix, space = self._problem, self._matrix, self.space
        lanes = 1 if problem.device.is_cpu else 32
        inputs = [lanes, active, problem.renewed, matrix, space.points, problem.values]
        launch(_matrix_kernel, (problem.env_count, len(matrix.pairs), lanes), *inputs, self._blocks)
        inputs = [self._team.lanes, active, problem.renewed, space.width, matrix.pairs]
        launch_team(
            self._kernel, problem.env_count, self._team, *inputs, self._blocks, space.inverses
        )


def _chunks(owners: np.ndarray, block_starts: np.ndarray) -> np.ndarray:
    """(first place, rows, part) of each chunk, int, [chunk_count, 3]."""
    cuts = np.flatnonzero(np.diff(owners, prepend=-1, append=-1))
    cuts = np.unique(np.concatenate([cuts, block_starts]))
    found = [(a, b - a, owners[a]) for a, b in itertools.pairwise(cuts) if owners[a] >= 0]
    return np.array(found, dtype=int).reshape(-1, 3)


def _coarse_matrix(
    problem: LinearProblem, plan: RowPlan, parts: np.ndarray, put: Any
) -> CoarseMatrix:
    """Lists of the blocks of the pattern by pairs of parts."""
    pattern = problem.pattern
    row, column = plan.places[pattern.rows], plan.places[pattern.columns]
    block = np.arange(pattern.block_count)
    off = row != column
    # Both triangles, of which the upper one of A_c is left out.
    first = np.concatenate([row, column[off]])
    second = np.concatenate([column, row[off]])
    code = np.concatenate([2 * block, 2 * block[off] + 1])
    wanted = (parts[first] >= parts[second]) & (parts[second] >= 0)
    first, second, code = first[wanted], second[wanted], code[wanted]
    key = parts[first].astype(np.int64) * len(parts) + parts[second]
    order = np.lexsort((code, key))
    pairs, starts = np.unique(key[order], return_index=True)
    matrix = CoarseMatrix()
    matrix.pairs = put(np.stack(np.divmod(pairs, len(parts)), axis=1), wp.vec2i)
    matrix.starts = put(np.append(starts, len(order)), wp.int32)
    matrix.codes = put(code[order], wp.int32)
    matrix.places = put(np.stack([first[order], second[order]], axis=1), wp.vec2i)
    return matrix
