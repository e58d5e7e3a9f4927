# SPDX-License-Identifier: Apache-2.0
"""Second derivatives of an energy density at a point, in the form that shape functions multiply."""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.elasticity.exact_hessian import exact_block
from taccel_lab.ipc.elasticity.principal import PrincipalHessian
from taccel_lab.ipc.svd import matrix_column

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
    """The blocks of curvatures as in exact_hessian.py, in the frame of the gradients."""
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
