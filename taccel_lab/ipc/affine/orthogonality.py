# SPDX-License-Identifier: Apache-2.0
"""Energy that keeps an affine body rigid: how far its map A is from a rotation.

V E / 8 |A^T A - I|^2 = V E / 8 (sum_i (|a_i|^2 - 1)^2 + 2 sum_{i<j} (a_i . a_j)^2)

with a_i the columns of A = [y1 y2 y3] / L [Lan et al. 2022, Affine Body Dynamics, eq. 6, with
kappa = E / 8]. It is St. Venant-Kirchhoff's energy of the uniform strain for lambda = 0 and
mu = E / 2: a solid of Young's modulus E and Poisson's ratio 0. So stress, Hessian and its
projection are that material's, in singular values and in closed form.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.elasticity.principal import PrincipalHessian, principal_block
from taccel_lab.ipc.elasticity.st_venant_kirchhoff import (
    st_venant_kirchhoff_energy,
    st_venant_kirchhoff_hessian,
    st_venant_kirchhoff_piola,
)

wp.set_module_options({"enable_backward": False})


@wp.func
def affine_map(y1: wp.vec3d, y2: wp.vec3d, y3: wp.vec3d, length: wp.float64) -> wp.mat33d:
    """A of control vectors y_k = length * a_k [m]."""
    return wp.matrix_from_cols(y1, y2, y3) * (wp.float64(1.0) / length)


@wp.func
def orthogonality_energy(a: wp.mat33d, stiffness: wp.float64) -> wp.float64:
    """Energy [J] of a map A; stiffness = E V [J]."""
    return st_venant_kirchhoff_energy(a, wp.float64(0.5) * stiffness, wp.float64(0.0))


@wp.func
def orthogonality_gradient(a: wp.mat33d, length: wp.float64, stiffness: wp.float64) -> wp.mat33d:
    """dE/dy_k [N] as column k; stiffness = E V [J]."""
    stress = st_venant_kirchhoff_piola(a, wp.float64(0.5) * stiffness, wp.float64(0.0))
    return stress * (wp.float64(1.0) / length)


@wp.func
def orthogonality_hessian(a: wp.mat33d, stiffness: wp.float64, mode: int) -> PrincipalHessian:
    """d^2 E / dA^2 [J], its negative eigenvalues treated as ``mode`` says (PSD_*)."""
    return st_venant_kirchhoff_hessian(
        a, wp.float64(0.5) * stiffness, wp.float64(0.0), wp.float64(0.0), mode
    )


@wp.func
def orthogonality_block(h: PrincipalHessian, length: wp.float64, i: int, j: int) -> wp.mat33d:
    """d^2 E / dy_i dy_j [N/m] with i, j in 0..2 for y1..y3."""
    beta_i = wp.vec3d(h.v[i, 0], h.v[i, 1], h.v[i, 2])
    beta_j = wp.vec3d(h.v[j, 0], h.v[j, 1], h.v[j, 2])
    return principal_block(h, beta_i, beta_j) * (wp.float64(1.0) / (length * length))
