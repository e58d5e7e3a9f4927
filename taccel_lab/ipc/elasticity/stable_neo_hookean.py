# SPDX-License-Identifier: Apache-2.0
"""Stable Neo-Hookean energy density: finite, with a restoring stress, through inversion.

psi(F) = m/2 (I1 - 3) + l/2 (J - a)^2 - m/2 ln(I1 + 1) + const,  a = 1 + 3 m / (4 l)

[Smith, de Goes and Kim 2018, Stable Neo-Hookean Flesh Simulation, eq. 14]. With m = 4/3 mu and
l = lambda + 5/6 mu small strains see the Lame parameters mu and lambda (their section 3.4); the
constant makes psi zero at rest. The arguments ``mu`` and ``lam`` are the Lame parameters.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.elasticity.invariants import (
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
