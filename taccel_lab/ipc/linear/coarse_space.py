# SPDX-License-Identifier: Apache-2.0
"""A coarse space for CG: what large parts of a gel do together, as rigid bodies.

Clusters of neighbours know nothing of a gel that shears or bends as a whole: the larger it is, the
more iterations carry that from one end to the other. Two dozen parts, six rigid motions each, make
a matrix A_c = P^T A P small enough to be inverted by one thread block, and z = M^-1 r + P A_c^-1
P^T r preconditions with both [Nicolaides 1987, Deflation of conjugate gradients with applications
to boundary value problems; Mandel 1993, Balancing domain decomposition, for elasticity]. On Newton
matrices of a press of 2,005 nodes CG takes 40 iterations instead of 73.

A part is a range of clusters, so that what a thread block owns of it is whole clusters. Blocks of
the matrix outside of the pattern are left out of A_c, as they are in the clusters.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.ipc.linear.block_ops import (
    Team,
    block_barrier,
    launch_team,
    team,
    team_barrier,
)
from taccel_lab.ipc.linear.dense_inverse import (
    address_of_tile,
    get_symmetric,
    put_lower,
    room_for_inverse,
    sweep_all,
)
from taccel_lab.ipc.linear.preconditioner import Clusters
from taccel_lab.ipc.linear.problem import LinearProblem
from taccel_lab.ipc.linear.row_plan import RowPlan, neighbour_clusters
from taccel_lab.model.matrix_pattern import BlockPattern

wp.set_module_options({"enable_backward": False})

MODES = wp.constant(6)
"""Rigid motions of a part."""
PART_ROWS = 64
"""Rows of a part, where there are few enough of them."""
MOST_PARTS = 24
"""Parts for whose matrix (144 rows, 84 KiB) most GPUs have the shared memory: 99 KiB and more."""
CHUNKS = wp.constant(4)
"""Lanes that share a row of the product with A_c^-1."""
_LANES = 512
_STATIC_BYTES = 4096


@wp.struct
class CoarseSpace:
    """Parts and their matrices, for kernels; places as in a ``RowPlan``.

    width: rows of A_c, 0 without a coarse space.
    points: where rows are, from the middle of their part in units of its size, [row_count].
    parts: part of the row at each place, -1 for none, [row_count].
    spans: first cluster of each part and the end, [part_count].
    clusters: first cluster of each thread block, and the end, [block_count + 1]; without those that
    are in no part.
    inverses: A_c^-1, zero where A_c is not positive definite, [env_count, width^2].
    loads: P^T w of each cluster, [env_count, MODES cluster_count].
    motions: A_c^-1 P^T w, in CHUNKS parts that add up, [env_count, CHUNKS width].
    """

    width: int
    points: wp.array(dtype=wp.vec3d)
    parts: wp.array(dtype=wp.int32)
    spans: wp.array(dtype=wp.vec2i)
    clusters: wp.array(dtype=wp.int32)
    inverses: wp.array2d(dtype=wp.float64)
    loads: wp.array2d(dtype=wp.float64)
    motions: wp.array2d(dtype=wp.float64)


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


def part_groups(
    pattern: BlockPattern, rows: np.ndarray, cluster_rows: int, part_rows: int
) -> tuple[list[np.ndarray], np.ndarray]:
    """Clusters of so many neighbours, and the part of each, int, [cluster_count]: -1 where there
    would be less than two parts of so many rows, or ``part_rows`` is 0."""
    size = max(part_rows, -(-len(rows) // (MOST_PARTS - 1)))
    parts = neighbour_clusters(pattern, rows, size) if part_rows and len(rows) else []
    if not 2 <= len(parts) <= MOST_PARTS:
        clusters = neighbour_clusters(pattern, rows, cluster_rows)
        return clusters, np.full(len(clusters), -1)
    clusters = [neighbour_clusters(pattern, part, cluster_rows) for part in parts]
    owners = np.repeat(np.arange(len(parts)), [len(part) for part in clusters])
    return [cluster for part in clusters for cluster in part], owners


@wp.func
def _motion(point: wp.vec3d, mode: int) -> wp.vec3d:
    """Displacement at a point by a unit of a rigid motion: three translations, three turns."""
    k = mode % 3
    # Not by index, which would put the vector into memory.
    axis = wp.vec3d(wp.float64(k == 0), wp.float64(k == 1), wp.float64(k == 2))
    if mode < 3:
        return axis
    return wp.cross(axis, point)


@wp.kernel
def _matrix_kernel(
    active: wp.array(dtype=wp.int32),
    matrix: CoarseMatrix,
    points: wp.array(dtype=wp.vec3d),
    values: wp.array2d(dtype=wp.mat33d),
    blocks: wp.array3d(dtype=wp.float64),
):
    """One thread an entry of a 6x6 block, which it adds up in the order of the list."""
    env, pair, entry = wp.tid()
    if active[env] == 0:
        return
    total = wp.float64(0.0)
    for k in range(matrix.starts[pair], matrix.starts[pair + 1]):
        code = matrix.codes[k]
        block = values[env, code / 2]
        left = _motion(points[matrix.places[k][0]], entry / MODES)
        right = _motion(points[matrix.places[k][1]], entry % MODES)
        if code % 2 == 1:
            total += wp.dot(right, block * left)
        else:
            total += wp.dot(left, block * right)
    blocks[env, pair, entry] = total


@cache
def _inverse_kernel(room: int) -> Any:
    address = address_of_tile(room)

    @wp.kernel(grid_stride=False, module="unique", enable_backward=False)
    def invert_kernel(
        lanes: int,
        active: wp.array(dtype=wp.int32),
        width: int,
        pairs: wp.array(dtype=wp.vec2i),
        blocks: wp.array3d(dtype=wp.float64),
        inverses: wp.array2d(dtype=wp.float64),
    ):
        env, lane = wp.tid()
        memory = address(wp.tile_empty(shape=room, dtype=wp.float64, storage="shared"))
        if active[env] == 0:
            return
        for e in range(lane, width * width, lanes):
            i = e / width
            if e - width * i <= i:
                put_lower(memory, i, e - width * i, wp.float64(0.0))
        block_barrier()
        size = MODES * MODES
        for e in range(lane, size * pairs.shape[0], lanes):
            pair = pairs[e / size]
            i = MODES * pair[0] + e % size / MODES
            j = MODES * pair[1] + e % MODES
            if j <= i:
                put_lower(memory, i, j, blocks[env, e / size, e % size])
        definite = sweep_all(memory, width, lane, lanes)
        for e in range(lane, width * width, lanes):
            i = e / width
            value = wp.float64(0.0)
            if definite:
                value = -get_symmetric(memory, i, e - width * i)
            inverses[env, e] = value

    return invert_kernel


@wp.func
def _restrict(
    env: int,
    first: int,
    end: int,
    lane: int,
    lanes: int,
    coarse: CoarseSpace,
    clusters: Clusters,
    w: wp.array(dtype=wp.vec3d),
):
    """P^T w of clusters first to end."""
    for task in range(MODES * first + lane, MODES * end, lanes):
        span = clusters.spans[task / MODES]
        total = wp.float64(0.0)
        for place in range(span[0], span[0] + span[1]):
            total += wp.dot(_motion(coarse.points[place], task % MODES), w[place])
        coarse.loads[env, task] = total


@wp.func
def _move_parts(env: int, first: int, end: int, lane: int, lanes: int, coarse: CoarseSpace):
    """A_c^-1 P^T w of parts first to end, once all clusters are restricted."""
    width = coarse.width
    rows = MODES * (end - first)
    count = coarse.spans.shape[0]
    for task in range(lane, CHUNKS * rows, lanes):
        chunk = task / rows
        row = MODES * first + task % rows
        total = wp.float64(0.0)
        for part in range(chunk * count / CHUNKS, (chunk + 1) * count / CHUNKS):
            span = coarse.spans[part]
            for mode in range(MODES):
                load = wp.float64(0.0)
                for c in range(span[0], span[1]):
                    load += coarse.loads[env, MODES * c + mode]
                # Down a column, which equals the row: lanes side by side read side by side.
                total += coarse.inverses[env, width * (MODES * part + mode) + row] * load
        coarse.motions[env, chunk * width + row] = total


@wp.func
def _prolonged(env: int, place: int, coarse: CoarseSpace) -> wp.vec3d:
    """P A_c^-1 P^T w at a place."""
    shift = wp.vec3d()
    turn = wp.vec3d()
    for chunk in range(CHUNKS):
        at = chunk * coarse.width + MODES * coarse.parts[place]
        shift += wp.vec3d(
            coarse.motions[env, at], coarse.motions[env, at + 1], coarse.motions[env, at + 2]
        )
        turn += wp.vec3d(
            coarse.motions[env, at + 3], coarse.motions[env, at + 4], coarse.motions[env, at + 5]
        )
    return shift + wp.cross(turn, coarse.points[place])


@wp.func
def add_correction(
    env: int,
    owned: wp.vec2i,
    blocks: int,
    lane: int,
    lanes: int,
    coarse: CoarseSpace,
    clusters: Clusters,
    gates: wp.array(dtype=wp.int32),
    w: wp.array(dtype=wp.vec3d),
    m: wp.array(dtype=wp.vec3d),
):
    """Add P A_c^-1 P^T w to ``m``, by all lanes of a team of so many ``blocks``; the range
    ``owned`` of the plan's blocks is what this one works for. Ends without a barrier."""
    first = coarse.clusters[owned[0]]
    end = coarse.clusters[owned[1]]
    _restrict(env, first, end, lane, lanes, coarse, clusters, w)
    team_barrier(env, blocks, gates)
    if end > first:
        begin = clusters.spans[first][0]
        last = clusters.spans[end - 1]
        first_part = coarse.parts[begin]
        end_part = coarse.parts[last[0]] + 1
        # Parts that several blocks own are moved by each, to the same bits.
        _move_parts(env, first_part, end_part, lane, lanes, coarse)
        block_barrier()
        for place in range(begin + lane, last[0] + last[1], lanes):
            m[place] = m[place] + _prolonged(env, place, coarse)


class CoarseCorrection:
    """The coarse space of a problem, and its matrix as it is now."""

    def __init__(
        self,
        problem: LinearProblem,
        plan: RowPlan,
        owners: np.ndarray,
        positions_m: np.ndarray | None,
        lanes: int | None = None,
    ) -> None:
        """``owners``: part of each cluster of the plan, ascending after those of none (-1), int,
        [cluster_count]. ``positions_m``: of the rows [m], [row_count, 3], where there are parts.
        ``lanes``: of a thread block, for tests."""
        self._problem = problem
        device, envs = problem.device, problem.env_count
        count = int(owners.max(initial=-1)) + 1
        self._count = count
        parts = np.full(len(plan.order), -1)
        parts[: plan.clustered] = np.repeat(owners, plan.cluster_sizes)
        points = np.zeros((len(parts), 3))
        for part in range(count):
            assert positions_m is not None
            inside = parts == part
            own = positions_m[plan.order[inside]]
            own = own - own.mean(axis=0)
            points[inside] = own / max(float(np.abs(own).max()), np.finfo(float).tiny)

        def put(array: np.ndarray, dtype: type) -> wp.array:
            kind = float if dtype is wp.vec3d else np.int32
            return wp.array(np.asarray(array, dtype=kind), dtype=dtype, device=device)

        space = self.space = CoarseSpace()
        space.width = MODES * count
        space.points, space.parts = put(points, wp.vec3d), put(parts, wp.int32)
        numbers = np.arange(count)
        spans = [np.searchsorted(owners, numbers, side) for side in ("left", "right")]
        space.spans = put(np.stack(spans, axis=1).reshape(-1, 2), wp.vec2i)
        starts = np.concatenate([[0], np.cumsum(plan.cluster_sizes)])
        first = int((owners < 0).sum())
        cuts = np.clip(np.searchsorted(starts, plan.block_starts), first, len(owners))
        space.clusters = put(cuts, wp.int32)
        width = int(space.width)
        for name, size in (
            ("inverses", width * width),
            ("loads", MODES * len(owners) if count else 0),
            ("motions", CHUNKS * width),
        ):
            setattr(space, name, wp.zeros((envs, size), dtype=wp.float64, device=device))
        if count == 0:
            return
        matrix = self._matrix = _coarse_matrix(problem, plan, parts, put)
        shape = (envs, len(matrix.pairs), MODES * MODES)
        self._blocks = wp.zeros(shape, dtype=wp.float64, device=device)
        self._kernel = _inverse_kernel(room_for_inverse(MODES * MOST_PARTS))
        self._team = Team(team(device, envs, 1, lanes or _LANES).lanes)

    def update(self, active: wp.array) -> None:
        """Form and invert the coarse matrices of the active environments."""
        if self._count == 0:
            return
        problem, matrix, space = self._problem, self._matrix, self.space
        wp.launch(
            _matrix_kernel,
            dim=self._blocks.shape,
            inputs=[active, matrix, space.points, problem.values],
            outputs=[self._blocks],
            device=problem.device,
        )
        launch_team(
            self._kernel,
            problem.env_count,
            self._team,
            [self._team.lanes, active, space.width, matrix.pairs, self._blocks],
            [space.inverses],
            problem.device,
        )


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
