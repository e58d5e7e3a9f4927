# SPDX-License-Identifier: Apache-2.0
"""Mollifier of nearly parallel edges (Li et al. 2020, Incremental Potential Contact, section 4.3).

    m(c) = c/e (2 - c/e) for c < e, else 1;   c = |u x v|^2;   e = 1e-3 |u_rest|^2 |v_rest|^2

with u, v the two edges. It takes the edge-edge energy, whose gradient jumps where the closest
points of parallel edges switch, smoothly to zero. Derivatives: own derivation, with
dc = 2 (u x v) . (du x v + u x dv).
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.device.matrices import mat43d

wp.set_module_options({"enable_backward": False})

_RELATIVE_THRESHOLD = wp.constant(wp.float64(1.0e-3))


@wp.func
def edge_edge_mollifier_threshold(
    ea0_rest: wp.vec3d, ea1_rest: wp.vec3d, eb0_rest: wp.vec3d, eb1_rest: wp.vec3d
) -> wp.float64:
    """Squared cross product below which a pair is mollified [m^4], from rest positions [m]."""
    size_sq = wp.length_sq(ea1_rest - ea0_rest) * wp.length_sq(eb1_rest - eb0_rest)
    return _RELATIVE_THRESHOLD * size_sq


@wp.func
def edge_edge_cross_sq(ea0: wp.vec3d, ea1: wp.vec3d, eb0: wp.vec3d, eb1: wp.vec3d) -> wp.float64:
    """Squared norm of the cross product of the two edges [m^4]."""
    return wp.length_sq(wp.cross(ea1 - ea0, eb1 - eb0))


@wp.func
def edge_edge_mollifier(cross_sq: wp.float64, threshold: wp.float64) -> wp.float64:
    """Mollifier m in [0, 1]."""
    if cross_sq >= threshold:
        return wp.float64(1.0)
    y = cross_sq / threshold
    return y * (wp.float64(2.0) - y)


@wp.func
def edge_edge_mollifier_d1(cross_sq: wp.float64, threshold: wp.float64) -> wp.float64:
    """dm/dc [1/m^4]."""
    if cross_sq >= threshold:
        return wp.float64(0.0)
    return wp.float64(2.0) * (wp.float64(1.0) - cross_sq / threshold) / threshold


@wp.func
def edge_edge_mollifier_d2(cross_sq: wp.float64, threshold: wp.float64) -> wp.float64:
    """d2m/dc2 [1/m^8]."""
    if cross_sq >= threshold:
        return wp.float64(0.0)
    return -wp.float64(2.0) / (threshold * threshold)


@wp.func
def edge_edge_cross_sq_gradient(
    ea0: wp.vec3d, ea1: wp.vec3d, eb0: wp.vec3d, eb1: wp.vec3d
) -> mat43d:
    """Derivative of the squared cross product by the nodes [m^3]."""
    u = ea1 - ea0
    v = eb1 - eb0
    normal = wp.float64(2.0) * wp.cross(u, v)
    by_u = wp.cross(v, normal)
    by_v = wp.cross(normal, u)
    return wp.matrix_from_rows(-by_u, by_u, -by_v, by_v)


@wp.func
def cross_sq_hessian(
    u: wp.vec3d, v: wp.vec3d, first: wp.vec2d, second: wp.vec2d, curvature: wp.float64
) -> wp.mat33d:
    """Second derivative of |u x v|^2 [m^2] by two points, which move u by ``first[0]`` and
    ``second[0]`` times themselves, v by ``first[1]`` and ``second[1]``.

    With curvature 1 it is exact; with 0 it is the Gauss-Newton part 2 J^T J, J = d(u x v)/dx, which
    is positive semidefinite and exact for parallel edges.
    """
    two = wp.float64(2.0)
    # J = skew(arm) up to its sign, and skew(a)^T skew(b) = (a . b) I - b a^T.
    a = first[0] * v - first[1] * u
    b = second[0] * v - second[1] * u
    block = two * (wp.dot(a, b) * wp.identity(n=3, dtype=wp.float64) - wp.outer(b, a))
    # N . (du x dv) = -du . (N x dv)
    mixed = first[0] * second[1] - first[1] * second[0]
    return block - two * curvature * mixed * wp.skew(wp.cross(u, v))
