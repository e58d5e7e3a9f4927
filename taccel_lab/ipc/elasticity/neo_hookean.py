# SPDX-License-Identifier: Apache-2.0
"""Compressible Neo-Hookean energy density and its derivatives.

psi(F) = mu/2 (tr F^T F - 3) - mu ln J + lambda/2 (ln J)^2,  J = det F

[Bonet and Wood 2008, Nonlinear Continuum Mechanics, eq. 6.27]. It grows without bound as J -> 0,
so a line search on the energy keeps tets from inverting.

The symmetric and antisymmetric modes of a pair of axes a, b (see principal.py) have eigenvalues
mu +- c / (s_a s_b), c = mu - lambda ln J. Stretches of an element that is not inverted are found
from F^T F, which is faster than the signed singular values that other materials need.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.eigen import symmetric_eigen_3x3
from taccel_lab.ipc.elasticity.invariants import hessian_of_slopes
from taccel_lab.ipc.elasticity.principal import (
    PSD_CLAMP,
    PSD_NONE,
    PrincipalHessian,
    lifted,
    principal_block,
)

wp.set_module_options({"enable_backward": False})

__all__ = [
    "PSD_CLAMP",
    "PSD_NONE",
    "log_excess",
    "neo_hookean_curvatures",
    "neo_hookean_energy",
    "neo_hookean_hessian",
    "neo_hookean_piola",
    "neo_hookean_pressed_hessian",
    "principal_block",
]


@wp.func
def log_excess(x: wp.float64) -> wp.float64:
    """x - ln(1 + x) for x > -1, without the cancellation of its two terms at small x.

    ln(1 + x) = 2 artanh(s) and x - 2 s = x s with s = x / (2 + x).
    """
    s = x / (wp.float64(2.0) + x)
    if wp.abs(s) > wp.float64(0.05):
        return x - wp.log(wp.float64(1.0) + x)
    q = s * s
    tail = wp.float64(1.0) / wp.float64(13.0)
    for k in range(5):
        tail = tail * q + wp.float64(1.0) / wp.float64(11 - 2 * k)
    return x * s - wp.float64(2.0) * s * q * tail


@wp.func
def neo_hookean_energy(f: wp.mat33d, mu: wp.float64, lam: wp.float64) -> wp.float64:
    """Energy density psi [J/m^3]; +inf for an inverted or flat element.

    Written in H = F - I, whose invariants I, II, III give J - 1 = I + II + III: the terms of psi
    are of order one, psi itself of order H^2, and the line search compares tiny changes of it.
    """
    if not (wp.determinant(f) > wp.float64(0.0)):
        return wp.float64(wp.inf)
    h = f - wp.identity(n=3, dtype=wp.float64)
    second = (
        h[0, 0] * h[1, 1]
        - h[0, 1] * h[1, 0]
        + h[1, 1] * h[2, 2]
        - h[1, 2] * h[2, 1]
        + h[2, 2] * h[0, 0]
        - h[2, 0] * h[0, 2]
    )
    higher = second + wp.determinant(h)
    growth = wp.trace(h) + higher
    excess = log_excess(growth)
    log_j = growth - excess
    return (
        mu * (wp.float64(0.5) * wp.ddot(h, h) + excess - higher)
        + wp.float64(0.5) * lam * log_j * log_j
    )


@wp.func
def neo_hookean_piola(f: wp.mat33d, mu: wp.float64, lam: wp.float64) -> wp.mat33d:
    """First Piola-Kirchhoff stress P = d psi / d F [Pa]: mu (F - F^-T) + lambda ln J F^-T."""
    f_inv_t = wp.transpose(wp.inverse(f))
    log_j = wp.log(wp.determinant(f))
    return mu * f + (lam * log_j - mu) * f_inv_t


@wp.func
def stretch_hessian(
    s: wp.vec3d, mu: wp.float64, lam: wp.float64, c: wp.float64, mode: int
) -> wp.mat33d:
    """Hessian of psi in the singular values: delta_ab (mu + c / s_a^2) + lambda / (s_a s_b)."""
    inv = wp.cw_div(wp.vec3d(wp.float64(1.0)), s)
    h = lam * wp.outer(inv, inv)
    for a in range(3):
        h[a, a] = h[a, a] + mu + c * inv[a] * inv[a]
    # Positive definite when c >= 0; otherwise only the eigenvalues tell.
    if mode == 0 or c >= wp.float64(0.0):
        return h
    values, vectors = symmetric_eigen_3x3(h)
    for a in range(3):
        values[a] = lifted(values[a], mode)
    return vectors * wp.diag(values) * wp.transpose(vectors)


@wp.func
def neo_hookean_hessian(
    f: wp.mat33d, mu: wp.float64, lam: wp.float64, mode: int
) -> PrincipalHessian:
    """Hessian of psi, with its negative eigenvalues treated as ``mode`` says (PSD_*)."""
    half = wp.float64(0.5)
    squares, v = symmetric_eigen_3x3(wp.transpose(f) * f)
    s = wp.vec3d(wp.sqrt(squares[0]), wp.sqrt(squares[1]), wp.sqrt(squares[2]))
    h = PrincipalHessian()
    h.u = f * v * wp.diag(wp.cw_div(wp.vec3d(wp.float64(1.0)), s))
    h.v = v
    c = mu - lam * wp.log(s[0] * s[1] * s[2])
    stretch = stretch_hessian(s, mu, lam, c, mode)
    direct = wp.diag(wp.get_diag(stretch))
    swap = wp.mat33d()
    for k in range(3):
        a = k
        b = (k + 1) % 3
        ratio = c / (s[a] * s[b])
        flip = lifted(mu + ratio, mode)
        twist = lifted(mu - ratio, mode)
        direct[a, b] = half * (flip + twist)
        direct[b, a] = direct[a, b]
        swap[a, b] = half * (flip - twist)
        swap[b, a] = swap[a, b]
        stretch[k, k] = wp.float64(0.0)
    h.direct = direct
    h.stretch = stretch
    h.swap = swap
    return h


@wp.func
def neo_hookean_pressed_hessian(
    f: wp.mat33d, mu: wp.float64, lam: wp.float64, pressure: wp.float64, mode: int
) -> PrincipalHessian:
    """Hessian of psi + pressure J, with its negative eigenvalues treated as ``mode`` says
    (PSD_*)."""
    squares, v = symmetric_eigen_3x3(wp.transpose(f) * f)
    s = wp.vec3d(wp.sqrt(squares[0]), wp.sqrt(squares[1]), wp.sqrt(squares[2]))
    u = f * v * wp.diag(wp.cw_div(wp.vec3d(wp.float64(1.0)), s))
    zero = wp.float64(0.0)
    j = s[0] * s[1] * s[2]
    pull = mu - lam * wp.log(j)
    slopes = wp.vec3d(wp.float64(0.5) * mu, zero, pressure - pull / j)
    curvatures = wp.vec3d(zero, zero, (pull + lam) / (j * j))
    return hessian_of_slopes(u, s, v, slopes, curvatures, mode)


@wp.func
def neo_hookean_curvatures(
    f: wp.mat33d, mu: wp.float64, lam: wp.float64, pressure: wp.float64
) -> wp.vec3d:
    """a, c and e of the exact Hessian of psi + pressure J [Pa], see exact_hessian.py."""
    j = wp.determinant(f)
    push = pressure * j
    return wp.vec3d(mu, mu - lam * wp.log(j) - push, lam + push)
