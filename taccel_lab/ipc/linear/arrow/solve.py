# SPDX-License-Identifier: Apache-2.0
"""Solves with the factors of ``arrow.factor``.

A level costs one barrier: who knows its value at last takes it from those that need it, which a
factor L D L^T with unit L allows; in the other direction D comes first.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.device.native import native
from taccel_lab.ipc.linear.arrow.factor import NAMES
from taccel_lab.ipc.linear.arrow.program import BORDER_CHUNKS, ArrowLayout

wp.set_module_options({"enable_backward": False})


@wp.func_native(native("arrow", "solve_factored", NAMES=NAMES, BORDER_CHUNKS=BORDER_CHUNKS))
def solve_factored(
    memory: wp.uint64, program: wp.uint64, lane: int, lanes: int, layout: ArrowLayout
) -> None:
    """x = (factored matrix)^-1 z, by places; z is overwritten. Ends with a barrier."""
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
