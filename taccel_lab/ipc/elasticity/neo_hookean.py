# SPDX-License-Identifier: Apache-2.0
"""Compressible Neo-Hookean energy density and its derivatives.

psi(F) = mu/2 (tr F^T F - 3) - mu ln J + lambda/2 (ln J)^2,  J = det F

[Bonet and Wood 2008, Nonlinear Continuum Mechanics, eq. 6.27]. It grows without bound as J -> 0,
so a line search on the energy keeps tets from inverting. Left out: viscosity, quasi-incompressible
(mixed) forms; linear tets lock as nu -> 0.5.

The Hessian is written block by block for two nodes with rest-shape gradients b_i, b_j. Its
indefinite part lives in the spectral modes of the operator dF -> F^-T dF^T F^-T, which are known
in closed form from the singular values of F [Smith et al. 2019, Analytic Eigensystems for
Isotropic Distortion Energies].
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func
def neo_hookean_energy(f: wp.mat33d, mu: wp.float64, lam: wp.float64) -> wp.float64:
    """Energy density psi [J/m^3]; +inf for an inverted or flat element."""
    j = wp.determinant(f)
    if not (j > wp.float64(0.0)):
        return wp.float64(wp.inf)
    log_j = wp.log(j)
    return (
        wp.float64(0.5) * mu * (wp.ddot(f, f) - wp.float64(3.0))
        - mu * log_j
        + wp.float64(0.5) * lam * log_j * log_j
    )


@wp.func
def neo_hookean_piola(f: wp.mat33d, mu: wp.float64, lam: wp.float64) -> wp.mat33d:
    """First Piola-Kirchhoff stress P = d psi / d F [Pa]: mu (F - F^-T) + lambda ln J F^-T."""
    f_inv_t = wp.transpose(wp.inverse(f))
    log_j = wp.log(wp.determinant(f))
    return mu * f + (lam * log_j - mu) * f_inv_t


@wp.func
def neo_hookean_block(
    b_i: wp.vec3d,
    b_j: wp.vec3d,
    g_i: wp.vec3d,
    g_j: wp.vec3d,
    mu: wp.float64,
    lam: wp.float64,
    log_j: wp.float64,
) -> wp.mat33d:
    """Hessian block d^2 psi / dx_i dx_j per rest volume, with g = F^-T b.

    mu (b_i.b_j) I + (mu - lambda ln J) g_j g_i^T + lambda g_i g_j^T
    """
    return (
        mu * wp.dot(b_i, b_j) * wp.identity(n=3, dtype=wp.float64)
        + (mu - lam * log_j) * wp.outer(g_j, g_i)
        + lam * wp.outer(g_i, g_j)
    )


@wp.func
def twist_flip_value(
    s_a: wp.float64, s_b: wp.float64, sign: wp.float64, mu: wp.float64, c: wp.float64
) -> wp.float64:
    """Eigenvalue of the flip (sign +1) or twist (sign -1) mode of singular values s_a, s_b."""
    return mu + sign * c / (s_a * s_b)


@wp.func
def diagonal_block(
    s: wp.vec3d, mu: wp.float64, lam: wp.float64, c: wp.float64
) -> wp.mat33d:
    """Hessian of psi in the three singular values: delta_ab (mu + c/s_a^2) + lambda/(s_a s_b)."""
    inv = wp.vec3d(
        wp.float64(1.0) / s[0], wp.float64(1.0) / s[1], wp.float64(1.0) / s[2]
    )
    d = wp.vec3d(mu + c * inv[0] * inv[0], mu + c * inv[1] * inv[1], mu + c * inv[2] * inv[2])
    return wp.diag(d) + lam * wp.outer(inv, inv)
