# SPDX-License-Identifier: Apache-2.0
"""Solves with the factors of ``arrow.factor``.

A level costs one barrier: who knows its value at last takes it from those that need it, which a
factor L D L^T with unit L allows; in the other direction D comes first.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.linear.arrow.factor import NAMES
from taccel_lab.ipc.linear.arrow.program import BORDER_CHUNKS, ArrowLayout

wp.set_module_options({"enable_backward": False})

_SOLVE_SNIPPET = (
    NAMES
    + """
    double* const z = numbers + layout.z;
    double* const x = numbers + layout.x;
    const int n = layout.n;
    const int width = 3 * layout.m;
    const int* const step_starts = words + layout.step_starts;
    const int* const targets = words + layout.targets;
    const int* const entries = words + layout.entries;
    // Words never change: the first that a lane needs after a barrier are read before it.
    int first = step_starts[0], end = step_starts[1], next_end = step_starts[2];
    unsigned target = targets[first + lane / 3];
    int stop = targets[first + lane / 3 + 1] & 0xffff;
    double* y = z;
    int across = 1, down = 3;
    #pragma unroll 1
    for (int step = 0; step <= layout.step_count; ++step) {
        if (step == layout.forward_steps) {
            const int* const starts = words + layout.starts;
            if (width > 0) {
                double* const sums = numbers + layout.sums;
                double* const rest = sums + @BORDER_CHUNKS@ * width;
                #pragma unroll 1
                for (int task = lane; task < @BORDER_CHUNKS@ * width; task += lanes) {
                    const int i = task / @BORDER_CHUNKS@;
                    double total = 0.0, more = 0.0, last = 0.0;
                    #pragma unroll 3
                    for (int j = task % @BORDER_CHUNKS@; j < n; j += @BORDER_CHUNKS@) {
                        const double* const a = factor + 9 * (starts[j] + 1) + 3 * i;
                        const double* const u = z + 3 * j;
                        total += a[0] * u[0];
                        more += a[1] * u[1];
                        last += a[2] * u[2];
                    }
                    sums[task] = total + more + last;
                }
                WP_TILE_SYNC();
                #pragma unroll 1
                for (int i = lane; i < width; i += lanes) {
                    double total = z[3 * n + i], more = 0.0;
                    // Lanes begin at their own banks.
                    #pragma unroll 4
                    for (int k = 0; k < @BORDER_CHUNKS@; k += 2) {
                        total -= sums[i * @BORDER_CHUNKS@ + (k + i) % @BORDER_CHUNKS@];
                        more += sums[i * @BORDER_CHUNKS@ + (k + 1 + i) % @BORDER_CHUNKS@];
                    }
                    rest[i] = total - more;
                }
                WP_TILE_SYNC();
                const double* const inverse = numbers + layout.schur + width % 2 * width * width;
                #pragma unroll 1
                for (int i = lane; i < width; i += lanes) {
                    double total = 0.0, more = 0.0;
                    #pragma unroll 3
                    for (int k = 0; k < width; k += 3) {
                        // Down a column of the symmetric inverse.
                        total += inverse[k * width + i] * rest[k];
                        more += inverse[(k + 1) * width + i] * rest[k + 1];
                        total += inverse[(k + 2) * width + i] * rest[k + 2];
                    }
                    x[3 * n + i] = total + more;
                }
                WP_TILE_SYNC();
            }
            const double* const border = x + 3 * n;
            #pragma unroll 1
            for (int task = lane; task < 3 * n; task += lanes) {
                const int column = task / 3;
                const int c = task % 3;
                const double* const own = factor + 9 * starts[column];
                const double* const u = z + 3 * column;
                double total = own[3 * c] * u[0] + own[3 * c + 1] * u[1] + own[3 * c + 2] * u[2];
                double more = 0.0, last = 0.0;
                #pragma unroll 4
                for (int k = 0; k < width; k += 3) {
                    total -= own[9 + 3 * k + c] * border[k];
                    more += own[9 + 3 * k + 3 + c] * border[k + 1];
                    last += own[9 + 3 * k + 6 + c] * border[k + 2];
                }
                x[task] = total - more - last;
            }
            y = x;
            across = 3;
            down = 1;
            WP_TILE_SYNC();
        }
        if (step == layout.step_count)
            break;
        #pragma unroll 1
        for (int task = 3 * first + lane; task < 3 * end; task += lanes) {
            const int c = task % 3;
            if (task >= 3 * first + lanes) {
                target = targets[task / 3];
                stop = targets[task / 3 + 1] & 0xffff;
            }
            double total = 0.0, more = 0.0, last = 0.0;
            #pragma unroll 2
            for (int e = target & 0xffffu; e < stop; ++e) {
                const unsigned entry = entries[e];
                const double* const a = factor + 9 * (entry >> 16) + c * down;
                const double* const u = y + 3 * (entry & 0xffffu);
                total += a[0] * u[0];
                more += a[across] * u[1];
                last += a[2 * across] * u[2];
            }
            y[3 * (target >> 16) + c] -= total + more + last;
        }
        first = end;
        end = next_end;
        next_end = step_starts[step + 3];
        if (3 * first + lane < 3 * end) {
            target = targets[first + lane / 3];
            stop = targets[first + lane / 3 + 1] & 0xffff;
        }
        WP_TILE_SYNC();
    }
""".replace("@BORDER_CHUNKS@", str(BORDER_CHUNKS))
)


@wp.func_native(_SOLVE_SNIPPET)
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
