# SPDX-License-Identifier: Apache-2.0
"""Lagged, mollified Coulomb friction (Li et al. 2020, Incremental Potential Contact, section 5).

For a contact with lagged normal n, weights w and normal force lambda, the tangential displacement
of the step is u = (I - n n^T) sum_i w_i (x_i - x_i_prev), and the dissipative potential is
mu lambda f0(|u|) with

    f0(y) = -y^3 / (3 eps^2) + y^2 / eps + eps / 3   for y < eps, else y;   eps = eps_v dt [m].

Its Hessian is positive semidefinite as it stands: f0 is convex and u is linear in x.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.distance.closest_pair import combine

wp.set_module_options({"enable_backward": False})


@wp.func
def tangential(n: wp.vec3d, v: wp.vec3d) -> wp.vec3d:
    """Part of v across the unit normal n."""
    return v - wp.dot(n, v) * n


@wp.func
def relative_displacement(
    weights: wp.vec4d, dx0: wp.vec3d, dx1: wp.vec3d, dx2: wp.vec3d, dx3: wp.vec3d
) -> wp.vec3d:
    """Displacement of the first primitive relative to the second at the contact point [m]."""
    return combine(weights, dx0, dx1, dx2, dx3)


@wp.func
def friction_f0(u_norm: wp.float64, eps_u: wp.float64) -> wp.float64:
    """f0 [m]: displacement beyond eps_u, smoothed below it."""
    if u_norm >= eps_u:
        return u_norm
    y = u_norm / eps_u
    third = wp.float64(1.0) / wp.float64(3.0)
    return eps_u * (y * y * (wp.float64(1.0) - third * y) + third)


@wp.func
def friction_f1_over_u(u_norm: wp.float64, eps_u: wp.float64) -> wp.float64:
    """f0'(u) / u [1/m]; 2 / eps_u at u = 0."""
    if u_norm >= eps_u:
        return wp.float64(1.0) / u_norm
    return (wp.float64(2.0) - u_norm / eps_u) / eps_u


@wp.func
def friction_f2(u_norm: wp.float64, eps_u: wp.float64) -> wp.float64:
    """f0''(u) [1/m]."""
    if u_norm >= eps_u:
        return wp.float64(0.0)
    return wp.float64(2.0) * (wp.float64(1.0) - u_norm / eps_u) / eps_u


@wp.func
def friction_potential(u: wp.vec3d, mu_lambda: wp.float64, eps_u: wp.float64) -> wp.float64:
    """Potential [J] of the tangential displacement u [m]; mu_lambda = mu * normal force [N]."""
    return mu_lambda * friction_f0(wp.length(u), eps_u)


@wp.func
def friction_gradient(u: wp.vec3d, mu_lambda: wp.float64, eps_u: wp.float64) -> wp.vec3d:
    """Derivative [N] by the relative displacement; that by node i is weights[i] times it."""
    return mu_lambda * friction_f1_over_u(wp.length(u), eps_u) * u


@wp.func
def friction_hessian(
    n: wp.vec3d, u: wp.vec3d, mu_lambda: wp.float64, eps_u: wp.float64, sharpness: wp.float64
) -> wp.mat33d:
    """Second derivative [N/m] by the relative displacement; block (i, j) is w_i w_j times it.

    In the frame (along u, across u, n) it is mu lambda diag(f0'', f0' / |u|, 0) for a ``sharpness``
    of 1. For 0 it is mu lambda f0' / |u| diag(1, 1, 0), that of a parabola through u that lies
    above the potential everywhere, so that no full step overshoots where sliding turns round;
    between the two it is the mean with these weights.
    """
    size = wp.length(u)
    across = friction_f1_over_u(size, eps_u)
    plane = wp.identity(n=3, dtype=wp.float64) - wp.outer(n, n)
    direction = wp.normalize(u)
    bend = sharpness * (friction_f2(size, eps_u) - across)
    return mu_lambda * (across * plane + bend * wp.outer(direction, direction))
