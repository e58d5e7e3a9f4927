# SPDX-License-Identifier: Apache-2.0
"""Stress and Hessian of any energy psi(I1, I2, J) of an isotropic solid, for any F.

I1 = tr C, I2 = (I1^2 - tr C^2) / 2, J = det F, C = F^T F. In signed singular values s of F
[Irving et al. 2004] the quotients that make principal stretches delicate at s_a = +-s_b [Stomakhin
et al. 2012; Smith et al. 2019] divide out exactly: with p_a = d psi / d s_a and c the third axis,

(p_a - p_b) / (s_a - s_b) = 2 psi_1 + 2 psi_2 (s_c^2 - s_a s_b) - psi_J s_c
(p_a + p_b) / (s_a + s_b) = 2 psi_1 + 2 psi_2 (s_c^2 + s_a s_b) + psi_J s_c

so equal, vanishing and negative stretches need no special case. An energy gives its ``slopes``
(psi_1, psi_2, psi_J) and ``curvatures`` (psi_11, psi_22, psi_JJ); energies with mixed second
derivatives are left out, since no material here has any.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.elasticity.principal import PrincipalHessian, principal_hessian

wp.set_module_options({"enable_backward": False})


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
