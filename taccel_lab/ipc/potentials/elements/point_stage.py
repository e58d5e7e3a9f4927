# SPDX-License-Identifier: Apache-2.0
"""Matrices at quadrature points of ten-node tets, and their sums over an element.

Second derivatives of an energy density at a point, in the form that shape functions multiply.

Matrices of ten-node tets, added up over their quadrature points before anything is written.

A lane evaluates one of the four points of an element and lays its second derivatives down in shared
memory; then the lanes of the warp take the 55 blocks of its eight elements in turn, each the sum
over the points. Added up in memory, element by element by one thread each, the blocks of 64 presses
of 1,152 elements took 3.5 ms on an H200, of which writing them once is 0.1. The CPU, where one
thread is all lanes one after the other, lays the points down in memory that stays in its cache,
and adds them up after the last lane.

For kernels over (environment, lane) with four lanes an element in modules that state
``STAGED_THREADS``. All lanes of a warp come to the sum, also those that have no element.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.device.matrices import matrix_column
from taccel_lab.ipc.elasticity.principal import PrincipalHessian, exact_block
from taccel_lab.ipc.potentials.elements.quadratic_shape import mat103d

wp.set_module_options({"enable_backward": False})


@wp.struct
class PointHessian:
    """Second derivatives of an energy density [Pa]: of F = sum_a x_a g_a^T the block of nodes a, b
    is sum_kl (frame^T g_a)_k k_kl (frame^T g_b)_l, with k_lk = k_kl^T."""

    frame: wp.mat33d
    k_00: wp.mat33d
    k_01: wp.mat33d
    k_02: wp.mat33d
    k_11: wp.mat33d
    k_12: wp.mat33d
    k_22: wp.mat33d


@wp.func
def _diagonal_block(h: PrincipalHessian, k: int) -> wp.mat33d:
    direct = wp.vec3d(h.direct[0, k], h.direct[1, k], h.direct[2, k])
    return h.u * wp.diag(direct) * wp.transpose(h.u)


@wp.func
def _coupling_block(h: PrincipalHessian, k: int, m: int) -> wp.mat33d:
    u_k = matrix_column(h.u, k)
    u_m = matrix_column(h.u, m)
    return h.stretch[k, m] * wp.outer(u_k, u_m) + h.swap[k, m] * wp.outer(u_m, u_k)


@wp.func
def point_hessian(p: PrincipalHessian) -> PointHessian:
    """The blocks of a principal Hessian, in its frame V."""
    h = PointHessian()
    h.frame = p.v
    h.k_00 = _diagonal_block(p, 0)
    h.k_11 = _diagonal_block(p, 1)
    h.k_22 = _diagonal_block(p, 2)
    h.k_01 = _coupling_block(p, 0, 1)
    h.k_02 = _coupling_block(p, 0, 2)
    h.k_12 = _coupling_block(p, 1, 2)
    return h


@wp.func
def exact_point_hessian(f: wp.mat33d, curvatures: wp.vec3d) -> PointHessian:
    """The blocks of curvatures as in ``elasticity.principal``, in the frame of the gradients."""
    c = curvatures[1]
    e = curvatures[2]
    inverse = wp.transpose(wp.inverse(f))
    g_0 = matrix_column(inverse, 0)
    g_1 = matrix_column(inverse, 1)
    g_2 = matrix_column(inverse, 2)
    none = wp.float64(0.0)
    h = PointHessian()
    h.frame = wp.identity(n=3, dtype=wp.float64)
    h.k_00 = exact_block(c, e, curvatures[0], g_0, g_0)
    h.k_11 = exact_block(c, e, curvatures[0], g_1, g_1)
    h.k_22 = exact_block(c, e, curvatures[0], g_2, g_2)
    h.k_01 = exact_block(c, e, none, g_0, g_1)
    h.k_02 = exact_block(c, e, none, g_0, g_2)
    h.k_12 = exact_block(c, e, none, g_1, g_2)
    return h


POINT_LANES = 4
"""Lanes of an element, one a quadrature point."""

# Odd strides, so that the lanes of a warp write to their own banks.
_SIZES = """
    const int point_stride = 85;
    const int element_stride = 33;
    const int points = 32 * point_stride;
"""
_STAGE_SNIPPET = """
#if defined(__CUDA_ARCH__)
    __shared__ double numbers[WP_TILE_BLOCK_DIM / 32][32 * 85 + 8 * 33];
    return reinterpret_cast<wp::uint64>(numbers[threadIdx.x / 32]);
#else
    static double numbers[32 * 85 + 8 * 33];
    return reinterpret_cast<wp::uint64>(numbers);
#endif
"""


@wp.func_native(_STAGE_SNIPPET)
def stage_points() -> wp.uint64:
    """Where the lanes of a warp lay down their points."""
    ...


@wp.func_native(
    _SIZES
    + """
    const double* const from = reinterpret_cast<const double*>(&h.k_00);
    const double* const rows = reinterpret_cast<const double*>(&shapes);
    double* const to = reinterpret_cast<double*>(stage) + lane % 32 * point_stride;
    for (int i = 0; i < 54; ++i)
        to[i] = from[i];
    for (int i = 0; i < 30; ++i)
        to[54 + i] = rows[i];
"""
)
def put_point(stage: wp.uint64, lane: int, h: PointHessian, shapes: mat103d) -> None:
    """Lay down the second derivatives at a point and the shape gradients in their frame."""
    ...


@wp.func_native(
    _SIZES
    + """
    const double* const rows = reinterpret_cast<const double*>(&slope);
    double* const to =
        reinterpret_cast<double*>(stage) + points + lane % 32 / 4 * element_stride;
    to[0] = weight;
    to[1] = bulk;
    for (int i = 0; i < 30; ++i)
        to[2 + i] = rows[i];
"""
)
def put_element(
    stage: wp.uint64, lane: int, weight: wp.float64, bulk: wp.float64, slope: mat103d
) -> None:
    """Lay down the weight of the points of an element [m^3], and ``bulk`` [J] of the outer product
    of ``slope`` with itself that is added to them."""
    ...


_SUM_SNIPPET = (
    _SIZES
    + """
    const double* const staged = reinterpret_cast<const double*>(stage);
    const int first = lane / 32 * 8;
    const int count = first + 8 < blocks.shape[1] ? 8 : static_cast<int>(blocks.shape[1]) - first;
    double* const to = reinterpret_cast<double*>(blocks.data)
        + (static_cast<size_t>(env) * blocks.shape[1] + first) * (9 * 55);
#if defined(__CUDA_ARCH__)
    __syncwarp();
    #pragma unroll 1
    for (int task = lane % 32; task < 55 * count; task += 32) {
        const int element = task / 55;
        int a = 0, b = task - 55 * element;
        while (b >= 10 - a) {
            b -= 10 - a;
            ++a;
        }
        b += a;
        const double* const e = staged + points + element * element_stride;
        double total[9];
        #pragma unroll
        for (int i = 0; i < 9; ++i)
            total[i] = e[1] * e[2 + 3 * a + i / 3] * e[2 + 3 * b + i % 3];
        #pragma unroll 1
        for (int q = 0; q < 4; ++q) {
            const double* const k = staged + (4 * element + q) * point_stride;
            const double* const s = k + 54;
            const double g0 = e[0] * s[3 * a], g1 = e[0] * s[3 * a + 1], g2 = e[0] * s[3 * a + 2];
            const double t0 = s[3 * b], t1 = s[3 * b + 1], t2 = s[3 * b + 2];
            #pragma unroll
            for (int i = 0; i < 9; ++i) {
                const int turned = i % 3 * 3 + i / 3;
                total[i] += t0 * g0 * k[i] + t1 * g1 * k[27 + i] + t2 * g2 * k[45 + i]
                    + t1 * g0 * k[9 + i] + t0 * g1 * k[9 + turned]
                    + t2 * g0 * k[18 + i] + t0 * g2 * k[18 + turned]
                    + t2 * g1 * k[36 + i] + t1 * g2 * k[36 + turned];
            }
        }
        #pragma unroll
        for (int i = 0; i < 9; ++i)
            to[9 * task + i] = total[i];
    }
    __syncwarp();
#else
    if (lane % 32 != 31)
        return;
    for (int element = 0; element < count; ++element) {
        const double* const e = staged + points + element * element_stride;
        double* const sums = to + 9 * 55 * element;
        int pair = 0;
        for (int a = 0; a < 10; ++a)
            for (int b = a; b < 10; ++b, ++pair)
                for (int i = 0; i < 9; ++i)
                    sums[9 * pair + i] = e[1] * e[2 + 3 * a + i / 3] * e[2 + 3 * b + i % 3];
        for (int q = 0; q < 4; ++q) {
            const double* const k = staged + (4 * element + q) * point_stride;
            const double* const s = k + 54;
            pair = 0;
            for (int a = 0; a < 10; ++a) {
                const double g0 = e[0] * s[3 * a];
                const double g1 = e[0] * s[3 * a + 1];
                const double g2 = e[0] * s[3 * a + 2];
                double left[3][9];
                for (int i = 0; i < 9; ++i) {
                    const int turned = i % 3 * 3 + i / 3;
                    left[0][i] = g0 * k[i] + g1 * k[9 + turned] + g2 * k[18 + turned];
                    left[1][i] = g0 * k[9 + i] + g1 * k[27 + i] + g2 * k[36 + turned];
                    left[2][i] = g0 * k[18 + i] + g1 * k[36 + i] + g2 * k[45 + i];
                }
                for (int b = a; b < 10; ++b, ++pair)
                    for (int i = 0; i < 9; ++i)
                        sums[9 * pair + i] += s[3 * b] * left[0][i] + s[3 * b + 1] * left[1][i]
                            + s[3 * b + 2] * left[2][i];
            }
        }
    }
#endif
"""
)


@wp.func_native(_SUM_SNIPPET)
def write_blocks(
    stage: wp.uint64, env: int, lane: int, blocks: wp.array3d(dtype=wp.mat33d)
) -> None:
    """Write the blocks of the elements of a warp, pairs (a, b) of nodes with a <= b in rows, shape
    [env_count, element_count, 55]."""
    ...


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    const int first = lane / 4;
    return wp::vec_t<2, wp::int32>(first, lane % 4 == 0 && first < count ? first + 1 : first);
#else
    const int first = lane / 32 * 8;
    const int end = first + 8 < count ? first + 8 : count;
    return wp::vec_t<2, wp::int32>(first, lane % 32 == 31 ? end : first);
#endif
""")
def written_elements(lane: int, count: int) -> wp.vec2i:
    """Elements, of ``count``, to whose blocks a lane may add after ``write_blocks``."""
    ...
