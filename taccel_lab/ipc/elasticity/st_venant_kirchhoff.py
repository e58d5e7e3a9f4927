# SPDX-License-Identifier: Apache-2.0
"""St. Venant-Kirchhoff energy density: linear elasticity in the Green strain.

psi(F) = mu E : E + lambda/2 (tr E)^2,  E = (F^T F - I) / 2

[Holzapfel 2000, Nonlinear Solid Mechanics, eq. 6.151]. For large rotations with small strains: it
softens in compression (a bar yields below a stretch of 1/sqrt(3)), costs nothing extra to turn
inside out, and its energy stays finite there.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.device.matrices import signed_svd_3x3
from taccel_lab.ipc.elasticity.principal import PrincipalHessian, hessian_of_slopes

wp.set_module_options({"enable_backward": False})


@wp.func
def green_strain(f: wp.mat33d) -> wp.mat33d:
    """E = (H + H^T + H^T H) / 2 with H = F - I, exact for small strains."""
    h = f - wp.identity(n=3, dtype=wp.float64)
    h_t = wp.transpose(h)
    return wp.float64(0.5) * (h + h_t + h_t * h)


@wp.func
def st_venant_kirchhoff_energy(f: wp.mat33d, mu: wp.float64, lam: wp.float64) -> wp.float64:
    """Energy density psi [J/m^3]."""
    e = green_strain(f)
    trace = wp.trace(e)
    return mu * wp.ddot(e, e) + wp.float64(0.5) * lam * trace * trace


@wp.func
def st_venant_kirchhoff_piola(f: wp.mat33d, mu: wp.float64, lam: wp.float64) -> wp.mat33d:
    """First Piola-Kirchhoff stress P = F (2 mu E + lambda tr E I) [Pa]."""
    e = green_strain(f)
    return f * (wp.float64(2.0) * mu * e) + lam * wp.trace(e) * f


@wp.func
def st_venant_kirchhoff_hessian(
    f: wp.mat33d, mu: wp.float64, lam: wp.float64, pressure: wp.float64, mode: int
) -> PrincipalHessian:
    """Hessian of psi + pressure tr E, with its negative eigenvalues treated as ``mode`` says
    (PSD_*).

    In invariants psi = mu/4 (I1^2 - 2 I2 - 2 I1 + 3) + lambda/8 (I1 - 3)^2.
    """
    u, s, v = signed_svd_3x3(f)
    half = wp.float64(0.5)
    quarter = wp.float64(0.25)
    trace = wp.dot(s, s)
    slopes = wp.vec3d(
        half * (mu * (trace - wp.float64(1.0)) + pressure)
        + quarter * lam * (trace - wp.float64(3.0)),
        -half * mu,
        wp.float64(0.0),
    )
    curvatures = wp.vec3d(half * mu + quarter * lam, wp.float64(0.0), wp.float64(0.0))
    return hessian_of_slopes(u, s, v, slopes, curvatures, mode)
