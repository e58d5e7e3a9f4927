# SPDX-License-Identifier: Apache-2.0
"""Hessian of an isotropic energy in the principal frame, and its projection.

With F = U diag(s) V^T the Hessian falls apart: the three stretches couple in a 3x3 matrix, and each
pair of axes has a symmetric and an antisymmetric mode [Smith et al. 2019, Analytic Eigensystems for
Isotropic Distortion Energies]. Negative eigenvalues are lifted there, at the cost of nine numbers.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.eigen import symmetric_eigen_3x3

wp.set_module_options({"enable_backward": False})

PSD_NONE = 0
"""The exact Hessian."""
PSD_CLAMP = 1
"""Negative element eigenvalues become zero [Teran et al. 2005]."""


@wp.struct
class PrincipalHessian:
    """d^2 psi of a change X = U^T dF V: sum_ab direct_ab X_ab^2 + stretch_ab X_aa X_bb
    + swap_ab X_ab X_ba, where ``stretch`` and ``swap`` have no diagonal [Pa]."""

    u: wp.mat33d
    v: wp.mat33d
    direct: wp.mat33d
    stretch: wp.mat33d
    swap: wp.mat33d


@wp.func
def lifted(value: wp.float64, mode: int) -> wp.float64:
    """An eigenvalue, clamped when it is negative."""
    if value >= wp.float64(0.0) or mode == 0:
        return value
    return wp.float64(0.0)


@wp.func
def lifted_matrix(h: wp.mat33d, mode: int) -> wp.mat33d:
    """A symmetric matrix with its negative eigenvalues treated as ``mode`` says (PSD_*)."""
    if mode == 0:
        return h
    # Sylvester: positive leading minors need no eigenvalues.
    zero = wp.float64(0.0)
    minor = h[0, 0] * h[1, 1] - h[0, 1] * h[0, 1]
    if h[0, 0] > zero and minor > zero and wp.determinant(h) > zero:
        return h
    values, vectors = symmetric_eigen_3x3(h)
    for a in range(3):
        values[a] = lifted(values[a], mode)
    return vectors * wp.diag(values) * wp.transpose(vectors)


@wp.func
def principal_hessian(
    u: wp.mat33d,
    v: wp.mat33d,
    stretch: wp.mat33d,
    symmetric: wp.vec3d,
    antisymmetric: wp.vec3d,
    mode: int,
) -> PrincipalHessian:
    """The Hessian of modes [Pa]: ``symmetric[k]`` and ``antisymmetric[k]`` are those of the two
    axes other than k, (p_a - p_b) / (s_a - s_b) and (p_a + p_b) / (s_a + s_b)."""
    half = wp.float64(0.5)
    h = PrincipalHessian()
    h.u = u
    h.v = v
    coupled = lifted_matrix(stretch, mode)
    direct = wp.diag(wp.get_diag(coupled))
    swap = wp.mat33d()
    for k in range(3):
        a = (k + 1) % 3
        b = (k + 2) % 3
        even = lifted(symmetric[k], mode)
        odd = lifted(antisymmetric[k], mode)
        direct[a, b] = half * (even + odd)
        direct[b, a] = direct[a, b]
        swap[a, b] = half * (even - odd)
        swap[b, a] = swap[a, b]
    for k in range(3):
        coupled[k, k] = wp.float64(0.0)
    h.direct = direct
    h.stretch = coupled
    h.swap = swap
    return h


@wp.func
def principal_block(h: PrincipalHessian, beta_i: wp.vec3d, beta_j: wp.vec3d) -> wp.mat33d:
    """Hessian block d^2 psi / dx_i dx_j per rest volume, with beta = V^T b of the rest-shape
    gradients b: dF = sum_i dx_i b_i^T."""
    middle = (
        wp.diag(h.direct * wp.cw_mul(beta_i, beta_j))
        + wp.cw_mul(h.stretch, wp.outer(beta_i, beta_j))
        + wp.cw_mul(h.swap, wp.outer(beta_j, beta_i))
    )
    return h.u * middle * wp.transpose(h.u)
