# SPDX-License-Identifier: Apache-2.0
"""Block-arrow factorisation and solves by one thread block.

A level of the factorisation costs two barriers and some tens of reads, of shared memory where there
is room. The right-hand side is one more row of the factor: when that is known, so is the first
solve's way forward. At the end blocks are scaled to A = L D L^T with unit L. So a level of a solve
costs one barrier: who knows its value at last takes it from those that need it; in the other
direction D comes first.

``memory`` and ``program`` are the addresses of the numbers and of the words, of either kind of
memory; see ``ArrowLayout`` for what is where.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.device.native import native
from taccel_lab.ipc.linear.arrow.program import (
    BORDER_CHUNKS,
    SCHUR_CHUNKS,
    ArrowLayout,
)
from taccel_lab.ipc.linear.problem.turned import LEAST_TURNED

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
    border_codes: wp.array(dtype=wp.int32),
    places: wp.array(dtype=wp.int32),
    border_places: wp.array(dtype=wp.int32),
    extra_count: int,
    extra_codes: wp.array(dtype=wp.int32),
    extra_places: wp.array(dtype=wp.vec2i),
    extra_values: wp.array(dtype=wp.float64),
) -> None:
    """Copy the ``listed`` program, and the matrix to its places in the factor; of the border among
    itself to the Schur complement. The flag says whether extra blocks between gel rows were left
    out. Ends without a barrier: nothing is subtracted from the first level."""
    ...


@wp.func_native(native("arrow", "factor_columns", NAMES=NAMES, LEAST_TURNED=LEAST_TURNED))
def factor_columns(
    memory: wp.uint64, program: wp.uint64, lane: int, lanes: int, layout: ArrowLayout
) -> None:
    """Find the Cholesky factor of all columns, and z as one more row of it; inverses of its
    diagonal blocks go to the roots."""
    ...


@wp.func_native(native("arrow", "finish_factor", NAMES=NAMES, SCHUR_CHUNKS=SCHUR_CHUNKS))
def finish_factor(
    memory: wp.uint64,
    program: wp.uint64,
    lane: int,
    lanes: int,
    layout: ArrowLayout,
) -> None:
    """Scale the factor, diagonal blocks to the inverses of D, and invert the Schur complement of
    the border, in the half of its copies where ``solve_factored`` looks for it; z as after the way
    forward, times the inverses of D. Ends with a barrier."""
    ...


@wp.func_native(native("arrow", "solve_factored", NAMES=NAMES, BORDER_CHUNKS=BORDER_CHUNKS))
def solve_factored(
    memory: wp.uint64,
    program: wp.uint64,
    lane: int,
    lanes: int,
    layout: ArrowLayout,
    first_solve: int,
) -> None:
    """Solve x = (factored matrix)^-1 z, by places; z is overwritten. The first solve begins where
    ``finish_factor`` left z. Ends with a barrier."""
    ...


@wp.func_native(
    "double* const at = reinterpret_cast<double*>(memory) + first + 3 * place;"
    "at[0] = value[0]; at[1] = value[1]; at[2] = value[2];"
)
def put_vector(memory: wp.uint64, first: int, place: int, value: wp.vec3d) -> None:
    """Write a vector of those that begin at number ``first``."""
    ...


@wp.func_native(
    "const double* const at = reinterpret_cast<const double*>(memory) + first + 3 * place;"
    "return wp::vec_t<3, wp::float64>(at[0], at[1], at[2]);"
)
def get_vector(memory: wp.uint64, first: int, place: int) -> wp.vec3d:
    """Read a vector."""
    ...


@wp.func_native("return reinterpret_cast<const double*>(memory)[index];")
def get_number(memory: wp.uint64, index: int) -> wp.float64:
    """Read a number."""
    ...
