# SPDX-License-Identifier: Apache-2.0
"""Stress and Hessian of isotropic energies, and the projection of the Hessian.

Hessian of an isotropic energy in the principal frame, and its projection.

With F = U diag(s) V^T the Hessian falls apart: the three stretches couple in a 3x3 matrix, and each
pair of axes has a symmetric and an antisymmetric mode [Smith et al. 2019, Analytic Eigensystems for
Isotropic Distortion Energies]. Negative eigenvalues are lifted there, at the cost of nine numbers.

Stress and Hessian of any energy psi(I1, I2, J) of an isotropic solid, for any F.

I1 = tr C, I2 = (I1^2 - tr C^2) / 2, J = det F, C = F^T F. In signed singular values s of F
[Irving et al. 2004] the quotients that make principal stretches delicate at s_a = +-s_b [Stomakhin
et al. 2012; Smith et al. 2019] divide out exactly: with p_a = d psi / d s_a and c the third axis,

(p_a - p_b) / (s_a - s_b) = 2 psi_1 + 2 psi_2 (s_c^2 - s_a s_b) - psi_J s_c
(p_a + p_b) / (s_a + s_b) = 2 psi_1 + 2 psi_2 (s_c^2 + s_a s_b) + psi_J s_c

so equal, vanishing and negative stretches need no special case. An energy gives its ``slopes``
(psi_1, psi_2, psi_J) and ``curvatures`` (psi_11, psi_22, psi_JJ); energies with mixed second
derivatives are left out, since no material here has any.

Exact Hessians of energies of tr F^T F and J alone, without singular values.

For psi = a/2 tr F^T F + phi(J) a change dF turns the stress P = a F + phi' J F^-T by

    a dF - phi' J F^-T dF^T F^-T + (phi'' J^2 + phi' J) tr(F^-1 dF) F^-T,

so that the block of two nodes with shape gradients b_i, b_j is a (b_i . b_j) I + c g_j g_i^T
+ e g_i g_j^T, where g = F^-T b, c = -phi' J and e = phi'' J^2 + phi' J. On one core that takes a
fifth of the time of the principal frame (principal.py), which a projection needs.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.device.matrices import symmetric_eigen_3x3

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


@wp.func
def cofactor(f: wp.mat33d) -> wp.mat33d:
    """dJ/dF = J F^-T, also where J = 0."""
    rows_0 = wp.vec3d(f[0, 0], f[0, 1], f[0, 2])
    rows_1 = wp.vec3d(f[1, 0], f[1, 1], f[1, 2])
    rows_2 = wp.vec3d(f[2, 0], f[2, 1], f[2, 2])
    return wp.matrix_from_rows(
        wp.cross(rows_1, rows_2), wp.cross(rows_2, rows_0), wp.cross(rows_0, rows_1)
    )


@wp.func
def matrix_invariants(f: wp.mat33d) -> wp.vec3d:
    """(I1, I2, J) of a deformation gradient."""
    c = cofactor(f)
    return wp.vec3d(wp.ddot(f, f), wp.ddot(c, c), wp.determinant(f))


@wp.func
def stretch_invariants(s: wp.vec3d) -> wp.vec3d:
    """(I1, I2, J) of signed singular values."""
    a = s[1] * s[2]
    b = s[2] * s[0]
    c = s[0] * s[1]
    return wp.vec3d(wp.dot(s, s), a * a + b * b + c * c, s[0] * a)


@wp.func
def displacement_invariants(f: wp.mat33d) -> wp.vec3d:
    """(H : H, II, III) of H = F - I, with II = tr cof H and III = det H.

    Energies are written in these: J - 1 = tr H + II + III, and psi is of order H^2, which
    differences of I1, I2 and J would lose to rounding.
    """
    h = f - wp.identity(n=3, dtype=wp.float64)
    second = (
        h[0, 0] * h[1, 1]
        - h[0, 1] * h[1, 0]
        + h[1, 1] * h[2, 2]
        - h[1, 2] * h[2, 1]
        + h[2, 2] * h[0, 0]
        - h[2, 0] * h[0, 2]
    )
    return wp.vec3d(wp.ddot(h, h), second, wp.determinant(h))


@wp.func
def displacement_trace(f: wp.mat33d) -> wp.float64:
    """tr H, summed from small terms."""
    one = wp.float64(1.0)
    return (f[0, 0] - one) + (f[1, 1] - one) + (f[2, 2] - one)


@wp.func
def piola_of_slopes(f: wp.mat33d, invariants: wp.vec3d, slopes: wp.vec3d) -> wp.mat33d:
    """P = 2 psi_1 F + 2 psi_2 (I1 F - F F^T F) + psi_J dJ/dF [Pa]."""
    two = wp.float64(2.0)
    linear = two * (slopes[0] + slopes[1] * invariants[0])
    cubic = two * slopes[1]
    return linear * f - cubic * (f * (wp.transpose(f) * f)) + slopes[2] * cofactor(f)


@wp.func
def hessian_of_slopes(
    u: wp.mat33d, s: wp.vec3d, v: wp.mat33d, slopes: wp.vec3d, curvatures: wp.vec3d, mode: int
) -> PrincipalHessian:
    """Hessian at F = U diag(s) V^T, negative eigenvalues treated as ``mode`` says (PSD_*)."""
    two = wp.float64(2.0)
    trace = wp.dot(s, s)
    # Gradients of I1 / 2, I2 / 2 and J in s.
    grad_2 = wp.vec3d()
    grad_j = wp.vec3d()
    for a in range(3):
        grad_2[a] = s[a] * (trace - s[a] * s[a])
        grad_j[a] = s[(a + 1) % 3] * s[(a + 2) % 3]
    stretch = (
        wp.float64(4.0) * curvatures[0] * wp.outer(s, s)
        + wp.float64(4.0) * curvatures[1] * wp.outer(grad_2, grad_2)
        + curvatures[2] * wp.outer(grad_j, grad_j)
    )
    symmetric = wp.vec3d()
    antisymmetric = wp.vec3d()
    for c in range(3):
        a = (c + 1) % 3
        b = (c + 2) % 3
        square = s[c] * s[c]
        product = s[a] * s[b]
        stretch[c, c] = stretch[c, c] + two * slopes[0] + two * slopes[1] * (trace - square)
        coupling = wp.float64(4.0) * slopes[1] * product + slopes[2] * s[c]
        stretch[a, b] = stretch[a, b] + coupling
        stretch[b, a] = stretch[b, a] + coupling
        symmetric[c] = two * (slopes[0] + slopes[1] * (square - product)) - slopes[2] * s[c]
        antisymmetric[c] = two * (slopes[0] + slopes[1] * (square + product)) + slopes[2] * s[c]
    return principal_hessian(u, v, stretch, symmetric, antisymmetric, mode)


@wp.func
def exact_block(
    c: wp.float64, e: wp.float64, stretch: wp.float64, g_i: wp.vec3d, g_j: wp.vec3d
) -> wp.mat33d:
    """The block of two nodes [Pa/m^2]; ``stretch`` is a (b_i . b_j)."""
    cg = c * g_j
    eg = e * g_i
    return wp.mat33d(
        stretch + cg[0] * g_i[0] + eg[0] * g_j[0],
        cg[0] * g_i[1] + eg[0] * g_j[1],
        cg[0] * g_i[2] + eg[0] * g_j[2],
        cg[1] * g_i[0] + eg[1] * g_j[0],
        stretch + cg[1] * g_i[1] + eg[1] * g_j[1],
        cg[1] * g_i[2] + eg[1] * g_j[2],
        cg[2] * g_i[0] + eg[2] * g_j[0],
        cg[2] * g_i[1] + eg[2] * g_j[1],
        stretch + cg[2] * g_i[2] + eg[2] * g_j[2],
    )
