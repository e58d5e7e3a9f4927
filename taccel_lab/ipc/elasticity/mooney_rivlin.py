# SPDX-License-Identifier: Apache-2.0
"""Compressible Mooney-Rivlin energy density, coupled form.

psi(F) = c10 (I1 - 3) + c01 (I2 - 3) - 2 (c10 + 2 c01) ln J + l/2 (ln J)^2

[FEBio Theory Manual, "Coupled Mooney-Rivlin"; the same split as Holzapfel 2000, eq. 6.147]. It is
coupled, not split into volume and shape, so that c01 = 0 is exactly the Neo-Hookean solid of
neo_hookean.py. Small strains see mu = 2 (c10 + c01) and lambda = l + 4 c01; the functions take mu,
lambda and the ratio r = c01 / (c10 + c01), and need l = lambda - 2 r mu >= 0, that is
nu >= r / (1 + 2 r).
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.elasticity.invariants import (
    cofactor,
    displacement_invariants,
    displacement_trace,
    hessian_of_slopes,
    matrix_invariants,
    piola_of_slopes,
    stretch_invariants,
)
from taccel_lab.ipc.elasticity.neo_hookean import log_excess
from taccel_lab.ipc.elasticity.principal import PrincipalHessian
from taccel_lab.ipc.svd import signed_svd_3x3

wp.set_module_options({"enable_backward": False})


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
