# SPDX-License-Identifier: Apache-2.0
"""Neo-Hookean energy densities, stable and with a second invariant too.

Compressible Neo-Hookean energy density and its derivatives.

psi(F) = mu/2 (tr F^T F - 3) - mu ln J + lambda/2 (ln J)^2,  J = det F

[Bonet and Wood 2008, Nonlinear Continuum Mechanics, eq. 6.27]. It grows without bound as J -> 0,
so a line search on the energy keeps tets from inverting.

The symmetric and antisymmetric modes of a pair of axes a, b (see principal.py) have eigenvalues
mu +- c / (s_a s_b), c = mu - lambda ln J. Stretches of an element that is not inverted are found
from F^T F, which is faster than the signed singular values that other materials need.

Stable Neo-Hookean energy density: finite, with a restoring stress, through inversion.

psi(F) = m/2 (I1 - 3) + l/2 (J - a)^2 - m/2 ln(I1 + 1) + const,  a = 1 + 3 m / (4 l)

[Smith, de Goes and Kim 2018, Stable Neo-Hookean Flesh Simulation, eq. 14]. With m = 4/3 mu and
l = lambda + 5/6 mu small strains see the Lame parameters mu and lambda (their section 3.4); the
constant makes psi zero at rest. The arguments ``mu`` and ``lam`` are the Lame parameters.

Compressible Mooney-Rivlin energy density, coupled form.

psi(F) = c10 (I1 - 3) + c01 (I2 - 3) - 2 (c10 + 2 c01) ln J + l/2 (ln J)^2

[FEBio Theory Manual, "Coupled Mooney-Rivlin"; the same split as Holzapfel 2000, eq. 6.147]. It is
coupled, not split into volume and shape, so that c01 = 0 is exactly the Neo-Hookean solid of
neo_hookean.py. Small strains see mu = 2 (c10 + c01) and lambda = l + 4 c01; the functions take mu,
lambda and the ratio r = c01 / (c10 + c01), and need l = lambda - 2 r mu >= 0, that is
nu >= r / (1 + 2 r).
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.device.matrices import signed_svd_3x3, symmetric_eigen_3x3
from taccel_lab.ipc.elasticity.principal import (
    PrincipalHessian,
    cofactor,
    displacement_invariants,
    displacement_trace,
    hessian_of_slopes,
    lifted,
    matrix_invariants,
    piola_of_slopes,
    stretch_invariants,
)

wp.set_module_options({"enable_backward": False})


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
    invariants = displacement_invariants(f)
    higher = invariants[1] + invariants[2]
    growth = displacement_trace(f) + higher
    excess = log_excess(growth)
    log_j = growth - excess
    return (
        mu * (wp.float64(0.5) * invariants[0] + excess - higher)
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
    """a, c and e of the exact Hessian of psi + pressure J [Pa], see principal.py."""
    j = wp.determinant(f)
    push = pressure * j
    return wp.vec3d(mu, mu - lam * wp.log(j) - push, lam + push)


@wp.func
def stable_moduli(mu: wp.float64, lam: wp.float64) -> wp.vec2d:
    """(m, l) of the energy from the Lame parameters [Pa]; l > 0 for every nu in (-1, 0.5)."""
    return wp.vec2d(
        wp.float64(4.0) / wp.float64(3.0) * mu, lam + wp.float64(5.0) / wp.float64(6.0) * mu
    )


@wp.func
def stable_neo_hookean_energy(f: wp.mat33d, mu: wp.float64, lam: wp.float64) -> wp.float64:
    """Energy density psi [J/m^3].

    Written in H = F - I, terms of first order cancelled by hand (see displacement_invariants):
    m (3/8 H:H - 3/4 (II + III)) + m/2 (x - ln(1 + x)) + l/2 (J - 1)^2 with x = (I1 - 3) / 4.
    """
    k = stable_moduli(mu, lam)
    invariants = displacement_invariants(f)
    trace = displacement_trace(f)
    higher = invariants[1] + invariants[2]
    growth = trace + higher
    x = wp.float64(0.25) * (wp.float64(2.0) * trace + invariants[0])
    return (
        k[0]
        * (
            wp.float64(0.375) * invariants[0]
            - wp.float64(0.75) * higher
            + wp.float64(0.5) * log_excess(x)
        )
        + wp.float64(0.5) * k[1] * growth * growth
    )


@wp.func
def stable_slopes(invariants: wp.vec3d, k: wp.vec2d) -> wp.vec3d:
    """(psi_1, psi_2, psi_J) [Pa]."""
    one = wp.float64(1.0)
    return wp.vec3d(
        wp.float64(0.5) * k[0] * invariants[0] / (invariants[0] + one),
        wp.float64(0.0),
        k[1] * (invariants[2] - one) - wp.float64(0.75) * k[0],
    )


@wp.func
def stable_neo_hookean_piola(f: wp.mat33d, mu: wp.float64, lam: wp.float64) -> wp.mat33d:
    """First Piola-Kirchhoff stress P = d psi / d F [Pa]."""
    invariants = matrix_invariants(f)
    return piola_of_slopes(f, invariants, stable_slopes(invariants, stable_moduli(mu, lam)))


@wp.func
def stable_neo_hookean_hessian(
    f: wp.mat33d, mu: wp.float64, lam: wp.float64, pressure: wp.float64, mode: int
) -> PrincipalHessian:
    """Hessian of psi + pressure J, with its negative eigenvalues treated as ``mode`` says
    (PSD_*)."""
    u, s, v = signed_svd_3x3(f)
    k = stable_moduli(mu, lam)
    invariants = stretch_invariants(s)
    more = invariants[0] + wp.float64(1.0)
    curvatures = wp.vec3d(wp.float64(0.5) * k[0] / (more * more), wp.float64(0.0), k[1])
    slopes = stable_slopes(invariants, k)
    slopes[2] = slopes[2] + pressure
    return hessian_of_slopes(u, s, v, slopes, curvatures, mode)


@wp.func
def mooney_constants(mu: wp.float64, lam: wp.float64, ratio: wp.float64) -> wp.vec3d:
    """(c10, c01, l) [Pa] from the Lame parameters [Pa] and c01 / (c10 + c01)."""
    c01 = wp.float64(0.5) * mu * ratio
    return wp.vec3d(wp.float64(0.5) * mu - c01, c01, lam - wp.float64(4.0) * c01)


@wp.func
def mooney_rivlin_energy(
    f: wp.mat33d, mu: wp.float64, lam: wp.float64, ratio: wp.float64
) -> wp.float64:
    """Energy density psi [J/m^3]; +inf for an inverted or flat element.

    Written in H = F - I, terms of first order cancelled by hand (see displacement_invariants):
    I2 = |cof F|^2 and cof F = I + K with K = tr H I - H^T + cof H.
    """
    if not (wp.determinant(f) > wp.float64(0.0)):
        return wp.float64(wp.inf)
    two = wp.float64(2.0)
    c = mooney_constants(mu, lam, ratio)
    eye = wp.identity(n=3, dtype=wp.float64)
    h = f - eye
    invariants = displacement_invariants(f)
    trace = displacement_trace(f)
    higher = invariants[1] + invariants[2]
    growth = trace + higher
    excess = log_excess(growth)
    log_j = growth - excess
    k = trace * eye - wp.transpose(h) + cofactor(h)
    first = invariants[0] + two * (excess - higher)
    second = two * invariants[1] + wp.ddot(k, k) + wp.float64(4.0) * (excess - higher)
    return c[0] * first + c[1] * second + wp.float64(0.5) * c[2] * log_j * log_j


@wp.func
def mooney_slopes(j: wp.float64, c: wp.vec3d) -> wp.vec3d:
    """(psi_1, psi_2, psi_J) [Pa]."""
    two = wp.float64(2.0)
    pull = c[2] * wp.log(j) - two * (c[0] + two * c[1])
    return wp.vec3d(c[0], c[1], pull / j)


@wp.func
def mooney_rivlin_piola(
    f: wp.mat33d, mu: wp.float64, lam: wp.float64, ratio: wp.float64
) -> wp.mat33d:
    """First Piola-Kirchhoff stress P = d psi / d F [Pa]; not a number for J <= 0."""
    invariants = matrix_invariants(f)
    slopes = mooney_slopes(invariants[2], mooney_constants(mu, lam, ratio))
    return piola_of_slopes(f, invariants, slopes)


@wp.func
def mooney_rivlin_hessian(
    f: wp.mat33d,
    mu: wp.float64,
    lam: wp.float64,
    ratio: wp.float64,
    pressure: wp.float64,
    mode: int,
) -> PrincipalHessian:
    """Hessian of psi + pressure J, with its negative eigenvalues treated as ``mode`` says
    (PSD_*)."""
    u, s, v = signed_svd_3x3(f)
    c = mooney_constants(mu, lam, ratio)
    j = stretch_invariants(s)[2]
    slopes = mooney_slopes(j, c)
    # psi_JJ = (l - J psi_J) / J^2
    curvatures = wp.vec3d(wp.float64(0.0), wp.float64(0.0), (c[2] / j - slopes[2]) / j)
    slopes[2] = slopes[2] + pressure
    return hessian_of_slopes(u, s, v, slopes, curvatures, mode)
