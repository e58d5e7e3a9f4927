# SPDX-License-Identifier: Apache-2.0
"""Block-arrow factorisation by one thread block.

A level costs two barriers and some tens of reads, of shared memory where there is room. At the end
blocks are scaled to A = L D L^T with unit L, for the sake of the solves (``arrow.solve``).

``memory`` and ``program`` are the addresses of the numbers and of the words, of either kind of
memory; see ``ArrowLayout`` for what is where.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.device.native import native
from taccel_lab.ipc.linear.arrow.program import SCHUR_CHUNKS, ArrowLayout

wp.set_module_options({"enable_backward": False})

NAMES = native("arrow", "names")
"""How snippets call what is in memory."""


@wp.func_native(native("arrow", "load_matrix", NAMES=NAMES))
def load_matrix(
    memory: wp.uint64,
    program: wp.uint64,
    lane: int,
    lanes: int,
    layout: ArrowLayout,
    listed: wp.array(dtype=wp.int32),
    codes: wp.array(dtype=wp.int32),
    values: wp.array(dtype=wp.float64),
    places: wp.array(dtype=wp.int32),
    border_places: wp.array(dtype=wp.int32),
    extra_count: int,
    extra_codes: wp.array(dtype=wp.int32),
    extra_places: wp.array(dtype=wp.vec2i),
    extra_values: wp.array(dtype=wp.float64),
) -> None:
    """The ``listed`` program, and blocks of the matrix at their places in the factor, without the
    border among itself. The flag says whether extra blocks between gel rows were left out. Ends
    without a barrier: nothing of the first level subtracts anything."""
    ...


@wp.func_native(native("arrow", "factor_columns", NAMES=NAMES))
def factor_columns(
    memory: wp.uint64, program: wp.uint64, lane: int, lanes: int, layout: ArrowLayout
) -> None:
    """Cholesky factor of all columns; inverses of its diagonal blocks go to the roots."""
    ...


@wp.func_native(native("arrow", "finish_factor", NAMES=NAMES, SCHUR_CHUNKS=SCHUR_CHUNKS))
def finish_factor(
    memory: wp.uint64,
    program: wp.uint64,
    lane: int,
    lanes: int,
    layout: ArrowLayout,
    values: wp.array(dtype=wp.float64),
    border_codes: wp.array(dtype=wp.int32),
    border_places: wp.array(dtype=wp.int32),
    extra_count: int,
    extra_codes: wp.array(dtype=wp.int32),
    extra_places: wp.array(dtype=wp.vec2i),
    extra_values: wp.array(dtype=wp.float64),
) -> None:
    """Scale the factor, diagonal blocks to the inverses of D, and invert the Schur complement of
    the border, in the half of its copies where ``solve_factored`` looks for it, after barriers of
    its own."""
    ...
