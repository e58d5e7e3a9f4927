# SPDX-License-Identifier: Apache-2.0
"""What keeps an affine body rigid, and where it is in free flight.

How far its map A is from a rotation:

V E / 8 |A^T A - I|^2 = V E / 8 (sum_i (|a_i|^2 - 1)^2 + 2 sum_{i<j} (a_i . a_j)^2)

with a_i the columns of A = [y1 y2 y3] / L [Lan et al. 2022, Affine Body Dynamics, eq. 6, with
kappa = E / 8]. It is St. Venant-Kirchhoff's energy of the uniform strain for lambda = 0 and
mu = E / 2: a solid of Young's modulus E and Poisson's ratio 0. So stress, Hessian and its
projection are that material's, in singular values and in closed form.

In free flight, without any strain: implicit Euler minimises sum_k m_k |y_k - y~_k|^2 / (2 s^2) over
the inertial positions y~, which lie off the rotations by the square of the angle turned. The
nearest rigid placement is an orthogonal Procrustes problem, solved by the singular vectors of sum_k
m_k y~_k e_k^T [Golub and Van Loan, Matrix Computations, section 6.4.1]. Newton's steps are straight
and stay within the square root of the body's compliance of the rotations: without this start a body
that spins fast takes many of them. Joints keep their points: bodies are placed from the root of
each mechanism on. A gel that is mounted on such a body rides along with it as it is.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.device.matrices import matrix_column, signed_svd_3x3
from taccel_lab.ipc.elasticity.principal import PrincipalHessian, principal_block
from taccel_lab.ipc.elasticity.st_venant_kirchhoff import (
    st_venant_kirchhoff_energy,
    st_venant_kirchhoff_hessian,
    st_venant_kirchhoff_piola,
)
from taccel_lab.model import Model
from taccel_lab.model.env_lists import EnvMask
from taccel_lab.model.launches import WARP_THREADS, launch

wp.set_module_options({"enable_backward": False, "block_dim": WARP_THREADS})


@wp.func
def affine_map(y1: wp.vec3d, y2: wp.vec3d, y3: wp.vec3d, length: wp.float64) -> wp.mat33d:
    """A of control vectors y_k = length * a_k [m]."""
    return wp.matrix_from_cols(y1, y2, y3) * (wp.float64(1.0) / length)


@wp.func
def body_map(
    env: int, start: int, length: wp.float64, nodes: wp.array2d(dtype=wp.vec3d)
) -> wp.mat33d:
    """Linear map of a body, or its change, from control nodes [m]."""
    return affine_map(nodes[env, start + 1], nodes[env, start + 2], nodes[env, start + 3], length)


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


@wp.kernel
def _predict_affine_kernel(
    active: wp.array(dtype=wp.int32),
    control_starts: wp.array(dtype=wp.int32),
    lengths: wp.array(dtype=wp.float64),
    masses: wp.array2d(dtype=wp.float64),
    inertial: wp.array2d(dtype=wp.vec3d),
    contact_forces: wp.array2d(dtype=wp.float64),
    first_body: int,
    jointed: int,
    predicted: wp.array2d(dtype=wp.vec3d),
    bends: wp.array(dtype=wp.float64),
):
    env, body = wp.tid()
    if active[env] == 0:
        return
    if contact_forces:
        for other in range(control_starts.shape[0]):
            if other == body or jointed != 0:
                if contact_forces[env, first_body + other] > wp.float64(0.0):
                    return
    start = control_starts[body]
    rest = env % masses.shape[0]
    y_1 = masses[rest, start + 1] * inertial[env, start + 1]
    y_2 = masses[rest, start + 2] * inertial[env, start + 2]
    y_3 = masses[rest, start + 3] * inertial[env, start + 3]
    u, _s, v = signed_svd_3x3(wp.matrix_from_cols(y_1, y_2, y_3))
    r = u * wp.transpose(v)
    predicted[env, start] = inertial[env, start]
    bend = wp.float64(0.0)
    for k in range(3):
        y = lengths[body] * matrix_column(r, k)
        bend = wp.max(bend, wp.length(inertial[env, start + 1 + k] - y) / lengths[body])
        predicted[env, start + 1 + k] = y
    wp.atomic_max(bends, env, bend)


def predict_affine(
    model: Model,
    active: EnvMask,
    inertial: wp.array,
    predicted: wp.array,
    bends: wp.array,
    contact_forces: wp.array | None = None,
) -> None:
    """Control nodes in free flight [m], written to ``predicted``, [env_count, node_count].

    ``inertial``: x~ of the step [m], shape [env_count, node_count]. ``bends``: how far off a
    rotation the inertial positions are, about the square of the largest angle turned, float64,
    shape [env_count]; zero where not active. ``contact_forces`` [N], [env_count, body_count]:
    bodies with one are left out; where bodies are joined, all are if one has.
    """
    affine = model.affine
    bends.zero_()
    inputs = [active, affine.control_starts, affine.lengths, model.masses, inertial]
    inputs += [contact_forces, len(model.scene.soft_bodies), int(bool(model.scene.joints))]
    launch(_predict_affine_kernel, (model.env_count, affine.count), *inputs, predicted, bends)


@wp.kernel
def _ride_kernel(
    active: wp.array(dtype=wp.int32),
    riders: wp.array(dtype=wp.vec2i),
    control_starts: wp.array(dtype=wp.int32),
    lengths: wp.array(dtype=wp.float64),
    positions: wp.array2d(dtype=wp.vec3d),
    predicted: wp.array2d(dtype=wp.vec3d),
):
    env, i = wp.tid()
    if active[env] == 0:
        return
    node = riders[i][0]
    body = riders[i][1]
    y = control_starts[body]
    x = positions[env]
    z = predicted[env]
    now = affine_map(x[y + 1], x[y + 2], x[y + 3], lengths[body])
    then = affine_map(z[y + 1], z[y + 2], z[y + 3], lengths[body])
    predicted[env, node] = z[y] + then * (wp.inverse(now) * (x[node] - x[y]))


def ride_along(model: Model, active: EnvMask, positions: wp.array, predicted: wp.array) -> None:
    """Free nodes of gels on affine bodies [m], written to ``predicted``, [env_count, node_count],
    where the control nodes of the bodies are already: they keep their places on the bodies."""
    affine = model.affine
    if len(affine.riders):
        inputs = [active, affine.riders, affine.control_starts, affine.lengths, positions]
        launch(_ride_kernel, (model.env_count, len(affine.riders)), *inputs, predicted)
