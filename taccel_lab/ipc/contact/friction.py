# SPDX-License-Identifier: Apache-2.0
"""Coulomb friction of one collision, and the motion that counts as sliding.

Lagged, mollified Coulomb friction (Li et al. 2020, Incremental Potential Contact, section 5).

For a contact with lagged normal n, weights w and normal force lambda, the tangential displacement
of the step is u = (I - n n^T) sum_i w_i (x_i - x_i_prev), and the dissipative potential is
mu lambda f0(|u|) with

    f0(y) = -y^3 / (3 eps^2) + y^2 / eps + eps / 3   for y < eps, else y;   eps = eps_v dt [m].

Its Hessian is positive semidefinite as it stands: f0 is convex and u is linear in x.

What of a step's motion brought a pair together, and is no sliding.

Friction counts sliding from where the step began. A pair that meets in a step comes from afar, and
where its normal has turned meanwhile, what it came by leans against the tangent plane: a node that
goes 50 um straight to a sharp edge and ends 0.5 um beside it, 5 um away, has a normal of 0.1 rad
and would seem to have slid 5 um. Friction would push it across, its normal tilt to the other side,
and freezing never settle. Seen from the edge, a node at r n that was at r0 n0 has come by
(r - r0) n0 and slid by r (n - n0): the way in is taken along the normal where the step began.

A node that slides over a face to its edge, and hardly comes nearer, did not come from afar. Its
normal where the step began is that of the face as long as the face is nearest, and leans as far as
it came once the edge is: friction would jump, and where it has to hold the node there, no residual
below the jump exists. So the way in is taken along the normal now unless it is as long as the gap.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.contact.collision_lists import ContactGeometry, closest_pair
from taccel_lab.ipc.distance.closest_pairs import ClosestPair, combine
from taccel_lab.ipc.distance.derivatives import pair_normal

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


@wp.struct
class WayIn:
    """How a pair has come together.

    along: relative motion along the normal now [m]. distance: now [m]. before: unit normal where
    the step began.
    share: how much the way in is along that, 0 to 1, r^4 / (1 + r^4) of r = along / distance;
    slope: its derivative by r.
    """

    along: wp.float64
    distance: wp.float64
    before: wp.vec3d
    share: wp.float64
    slope: wp.float64


@wp.func
def way_in(
    env: int,
    kind: int,
    nodes: wp.vec4i,
    pair: ClosestPair,
    now: wp.array2d(dtype=wp.vec3d),
    then: wp.array2d(dtype=wp.vec3d),
    geometry: ContactGeometry,
) -> WayIn:
    """How ``pair``, the collision ``now``, has come together since the positions ``then``."""
    moved = combine(
        pair.weights,
        now[env, nodes[0]] - then[env, nodes[0]],
        now[env, nodes[1]] - then[env, nodes[1]],
        now[env, nodes[2]] - then[env, nodes[2]],
        now[env, nodes[3]] - then[env, nodes[3]],
    )
    way = WayIn()
    way.along = wp.dot(moved, pair_normal(pair))
    way.before = pair_normal(closest_pair(env, kind, nodes, then, geometry))
    way.distance = wp.sqrt(pair.distance_sq)
    ratio = way.along / way.distance
    cubed = ratio * ratio * ratio
    rest = wp.float64(1.0) / (wp.float64(1.0) + cubed * ratio)
    way.share = wp.float64(1.0) - rest
    way.slope = wp.float64(4.0) * cubed * rest * rest
    return way


@wp.func
def normal_motion(way: WayIn, n: wp.vec3d) -> wp.vec3d:
    """Relative motion since the step began that is no sliding [m]: what it is along the normal n of
    the collision now, along that and the normal that it had then.

    Its length is not that of the gaps: in sliding from one face to the next the gap to a face, and
    the normal with it, may have been anything; along the normal there is hardly any motion.
    """
    return way.along * (n + way.share * (way.before - n))


@wp.func
def normal_motion_change(
    way: WayIn,
    n: wp.vec3d,
    along: wp.float64,
    distance: wp.float64,
    dn: wp.vec3d,
    dbefore: wp.vec3d,
) -> wp.vec3d:
    """Change of ``normal_motion`` [m] as ``way.along`` and ``way.distance`` change by ``along`` and
    ``distance`` [m], and the normals now and before by ``dn`` and ``dbefore``."""
    lean = way.before - n
    steeper = way.slope * (along - way.along / way.distance * distance) / way.distance
    turned = dn + way.share * (dbefore - dn)
    return along * (n + way.share * lean) + way.along * (steeper * lean + turned)
