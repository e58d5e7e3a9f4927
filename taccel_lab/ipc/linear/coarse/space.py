# SPDX-License-Identifier: Apache-2.0
"""A coarse space for CG: what large parts of a gel do together, as rigid bodies.

Diagonal blocks know nothing of a gel that shears or bends as a whole: the larger it is, the more
iterations carry that from one end to the other. Two dozen parts, six rigid motions each, make a
matrix A_c = P^T A P small enough to be inverted by one thread block (``coarse.matrix``), and
z = D^-1 r + P A_c^-1 P^T r preconditions with both [Nicolaides 1987, Deflation of conjugate
gradients with applications to boundary value problems; Mandel 1993, Balancing domain decomposition,
for elasticity]. On Newton matrices of a press of 2,005 nodes CG takes 52 iterations in place of
104; inverted clusters of 16 neighbours beside it would save another dozen, and read as much as the
matrix in each.

Rows of a part follow each other in the order of the solver. Blocks of the matrix outside of the
pattern are left out of A_c.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.device.block_ops import MAX_LANES, team_barrier
from taccel_lab.ipc.device.native import native

wp.set_module_options({"enable_backward": False})

MODES = wp.constant(6)
"""Rigid motions of a part."""
MOST_PARTS = 24
"""Parts for whose matrix (144 rows, 84 KiB) most GPUs have the shared memory: 99 KiB and more."""


@wp.struct
class CoarseSpace:
    """Parts and their matrices, for kernels; places as in a ``RowPlan``.

    width: rows of A_c, 0 without a coarse space.
    points: where rows are, from the middle of their part in units of its size, [row_count].
    parts: part of the row at each place, -1 for none, [row_count].
    chunks: (first place, rows, part) of the rows of one part that one thread block owns, in the
    order of places, [chunk_count].
    block_chunks: first chunk of each thread block, and the end, [block_count + 1].
    spans: first chunk of each part and the end, [part_count].
    inverses: A_c^-1, zero where A_c is not positive definite, [env_count, width^2].
    loads: P^T w of each chunk, [env_count, MODES chunk_count].
    motions: A_c^-1 P^T w, on the CPU; a GPU keeps it in shared memory; [env_count, width].
    """

    width: int
    points: wp.array(dtype=wp.vec3d)
    parts: wp.array(dtype=wp.int32)
    chunks: wp.array(dtype=wp.vec3i)
    block_chunks: wp.array(dtype=wp.int32)
    spans: wp.array(dtype=wp.vec2i)
    inverses: wp.array2d(dtype=wp.float64)
    loads: wp.array2d(dtype=wp.float64)
    motions: wp.array2d(dtype=wp.float64)


@wp.func_native(native("coarse", "restrict"))
def _restrict(
    first: int,
    end: int,
    lane: int,
    lanes: int,
    chunks: wp.array(dtype=wp.vec3i),
    points: wp.array(dtype=wp.vec3d),
    w: wp.array(dtype=wp.vec3d),
    loads: wp.array(dtype=wp.float64),
) -> None:
    """P^T w of chunks first to end."""
    ...


@wp.func_native(native("coarse", "move_parts", WIDTH=MODES * MOST_PARTS, LANES=MAX_LANES))
def _move_parts(
    first: int,
    end: int,
    from_place: int,
    to_place: int,
    lane: int,
    lanes: int,
    width: int,
    ahead: wp.vec2i,
    spans: wp.array(dtype=wp.vec2i),
    inverses: wp.array(dtype=wp.float64),
    loads: wp.array(dtype=wp.float64),
    motions: wp.array(dtype=wp.float64),
    parts: wp.array(dtype=wp.int32),
    points: wp.array(dtype=wp.vec3d),
    w: wp.array(dtype=wp.vec3d),
    m: wp.array(dtype=wp.vec3d),
) -> wp.float64:
    """Rows first to end of A_c^-1 P^T w, once all chunks are restricted, and m += P of that at a
    range of places; returns the part of a lane in w . P A_c^-1 P^T w. For all lanes of a block.
    ``ahead``: the span of the part of row ``lane``, read while others were waited for."""
    ...


@wp.struct
class OwnedParts:
    """What a thread block does for a coarse space: ranges of chunks, of rows of A_c^-1, and of
    places; all empty where it owns no part of one."""

    chunks: wp.vec2i
    rows: wp.vec2i
    places: wp.vec2i


@wp.func
def owned_parts(coarse: CoarseSpace, first_block: int, end_block: int) -> OwnedParts:
    """The share of a block that works for blocks first to end of the plan."""
    owned = OwnedParts()
    if coarse.width > 0:
        first = coarse.block_chunks[first_block]
        end = coarse.block_chunks[end_block]
        owned.chunks = wp.vec2i(first, end)
        if end > first:
            begin = coarse.chunks[first]
            last = coarse.chunks[end - 1]
            # Parts that several blocks own are moved by each, to the same bits.
            owned.rows = wp.vec2i(MODES * begin[2], MODES * (last[2] + 1))
            owned.places = wp.vec2i(begin[0], last[0] + last[1])
    return owned


@wp.func
def add_correction(
    env: int,
    owned: OwnedParts,
    blocks: int,
    lane: int,
    lanes: int,
    coarse: CoarseSpace,
    gates: wp.array(dtype=wp.int32),
    w: wp.array(dtype=wp.vec3d),
    m: wp.array(dtype=wp.vec3d),
) -> wp.float64:
    """Add P A_c^-1 P^T w to ``m``, by all lanes of a team of ``blocks`` that have waited
    for w of their own block; returns the part of a lane in w . P A_c^-1 P^T w. Waits for the rest,
    and for ``m``, but not for what it adds."""
    loads = coarse.loads[env]
    _restrict(owned.chunks[0], owned.chunks[1], lane, lanes, coarse.chunks, coarse.points, w, loads)
    ahead = coarse.spans[wp.min(lane, coarse.width - 1) / MODES]
    team_barrier(env, blocks, gates)
    if owned.rows[1] == 0:
        return wp.float64(0.0)
    return _move_parts(
        owned.rows[0],
        owned.rows[1],
        owned.places[0],
        owned.places[1],
        lane,
        lanes,
        coarse.width,
        ahead,
        coarse.spans,
        coarse.inverses[env],
        loads,
        coarse.motions[env],
        coarse.parts,
        coarse.points,
        w,
        m,
    )
