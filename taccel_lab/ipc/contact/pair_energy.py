# SPDX-License-Identifier: Apache-2.0
"""Gradient and Hessian of an energy of the distance of a pair, mollified or not.

Gradient and Hessian of an energy E(d) of the distance of a pair, in closed form.

With the frame (n, t_a) and the slide vectors c_a of a pair (see `distance/derivatives.py`) and
(w (x) v)_i = w_i v, the second derivative of the distance is

    d2d = (w w^T) (x) (sum over fixed t_a of t_a t_a^T) / d
        - sum over free t_a of [ (w t_a) (c_a n)^T + (c_a n) (w t_a)^T + d (c_a n) (c_a n)^T ]

so E'' grad d grad d^T + E' d2d is a term along w n and one for each tangent, in the span of w t_a
and c_a n, which are orthogonal. Each is projected to positive semidefinite by itself, a 2x2 matrix
in closed form; any 3x3 block is formed from these seven numbers where it is needed. What the terms
along n share makes the projection of the whole a little smaller: solving for its 5x5 matrix by
rotations cost a contact most of its time and saved 0.5 % of the Newton iterations of a peg. Own
derivation; d must be > 0.

Gradient and Hessian of the mollified edge-edge energy m(c(x)) E(d(x)).

    grad = m E' grad d + E grad m
    hess = m hess E + E' (grad m grad d^T + grad d grad m^T) + E hess m

The positive semidefinite version sums the projections of its parts, each in closed form:
  * m hess E: its terms (as above);
  * the mixed term: a b^T + b a^T has the projection |a||b|/2 (a^ + b^)(a^ + b^)^T;
  * E hess m: m'' < 0 is dropped and of m' hess c the Gauss-Newton part 2 m' J^T J is kept, which is
    exact for parallel edges.
It needs E >= 0, which holds for a barrier with positive weight. On edges of 1 mm at angles of 1e-4
to 0.03 rad and gaps below dhat = 0.1 mm it differs from the projection of the whole by 2 % in the
median and 24 % at the ninth decile (Frobenius norm), where the rank-one Gauss-Newton term alone
misses more than 99 %; both leave the gradient exact and only steer the Newton direction.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.device.matrices import mat43d
from taccel_lab.ipc.distance.closest_pairs import ClosestPair
from taccel_lab.ipc.distance.derivatives import outer_rows, pair_frame, pair_normal
from taccel_lab.ipc.distance.edge_edge_mollifier import (
    cross_sq_hessian,
    edge_edge_cross_sq,
    edge_edge_cross_sq_gradient,
    edge_edge_mollifier,
    edge_edge_mollifier_d1,
    edge_edge_mollifier_d2,
)
from taccel_lab.ipc.elasticity.principal import PSD_CLAMP, PSD_NONE

wp.set_module_options({"enable_backward": False})

GAUSS_NEWTON = 2
"""Mode of a pair alone, beside PSD_*: max(E'', 0) grad d grad d^T."""


@wp.struct
class PairHessian:
    """Hessian of a pair: block (i, j) is axes * local_ij * axes^T, see ``local_block``.

    axes: columns n, t1, t2.
    weights, slide_1, slide_2: w, c_1 and c_2, 4-vectors.
    normal: coefficient of (w n) (w n)^T [N/m].
    tangent_1, tangent_2: coefficients of (w t_a) (w t_a)^T [N/m], of both mixed terms [N] and of
        (c_a n) (c_a n)^T [N m].
    """

    axes: wp.mat33d
    weights: wp.vec4d
    slide_1: wp.vec4d
    slide_2: wp.vec4d
    normal: wp.float64
    tangent_1: wp.vec3d
    tangent_2: wp.vec3d


@wp.func
def pair_gradient(pair: ClosestPair, e1: wp.float64) -> mat43d:
    """Gradient [N] of E(d), row i for node i; e1 = dE/dd [N]."""
    return outer_rows(pair.weights, e1 * pair_normal(pair))


@wp.func
def _positive_part(terms: wp.vec3d, first_sq: wp.float64, second_sq: wp.float64) -> wp.vec3d:
    """Coefficients of the projection to positive semidefinite of p u u^T + q (u v^T + v u^T)
    + r v v^T, with u and v orthogonal and of these squared lengths; where q is not 0, p is."""
    zero = wp.float64(0.0)
    if terms[1] == zero or first_sq == zero or second_sq == zero:
        return wp.vec3d(wp.max(terms[0], zero), zero, wp.max(terms[2], zero))
    # In unit vectors the matrix is [[0, mixed], [mixed, own]]; its one positive eigenvalue has the
    # eigenvector (mixed, value).
    half = wp.float64(0.5)
    mixed = terms[1] * wp.sqrt(first_sq * second_sq)
    own = half * terms[2] * second_sq
    root = wp.sqrt(own * own + mixed * mixed)
    value = root + own
    if own < zero:
        value = mixed * mixed / (root - own)
    share = value / (mixed * mixed + value * value)
    return wp.vec3d(
        share * mixed * mixed / first_sq,
        share * mixed * value / wp.sqrt(first_sq * second_sq),
        share * value * value / second_sq,
    )


@wp.func
def pair_hessian(
    pair: ClosestPair,
    x0: wp.vec3d,
    x1: wp.vec3d,
    x2: wp.vec3d,
    x3: wp.vec3d,
    e1: wp.float64,
    e2: wp.float64,
    mode: wp.int32,
) -> PairHessian:
    """Hessian of E(d) at the positions [m] of the pair; e1 = dE/dd [N], e2 = d2E/dd2 [N/m].

    mode: PSD_NONE, PSD_CLAMP (each of its terms is projected: at least the Hessian itself) or
    GAUSS_NEWTON.
    """
    zero = wp.float64(0.0)
    frame = pair_frame(pair, x0, x1, x2, x3)
    h = PairHessian()
    h.axes = frame.axes
    h.weights = pair.weights
    h.normal = e2
    if mode != PSD_NONE:
        h.normal = wp.max(e2, zero)
    if mode == GAUSS_NEWTON:
        return h
    h.slide_1 = frame.slide_1
    h.slide_2 = frame.slide_2
    distance = wp.sqrt(pair.distance_sq)
    held = wp.vec3d(e1 / distance, zero, zero)
    slides = wp.vec3d(zero, -e1, -e1 * distance)
    h.tangent_1 = wp.where(pair.free_count > 0, slides, held)
    h.tangent_2 = wp.where(pair.free_count > 1, slides, held)
    if mode == PSD_CLAMP:
        weight_sq = wp.length_sq(h.weights)
        h.tangent_1 = _positive_part(h.tangent_1, weight_sq, wp.length_sq(h.slide_1))
        h.tangent_2 = _positive_part(h.tangent_2, weight_sq, wp.length_sq(h.slide_2))
    return h


@wp.func
def local_block(
    h: PairHessian,
    w_i: wp.float64,
    w_j: wp.float64,
    slide_1i: wp.float64,
    slide_1j: wp.float64,
    slide_2i: wp.float64,
    slide_2j: wp.float64,
) -> wp.mat33d:
    """Block of two nodes in the axes n, t1, t2 [N/m], from their weights and slides [1/m]."""
    zero = wp.float64(0.0)
    one = h.tangent_1
    two = h.tangent_2
    ww = w_i * w_j
    nn = h.normal * ww + one[2] * slide_1i * slide_1j + two[2] * slide_2i * slide_2j
    return wp.mat33d(
        nn, one[1] * slide_1i * w_j, two[1] * slide_2i * w_j,
        one[1] * w_i * slide_1j, one[0] * ww, zero,
        two[1] * w_i * slide_2j, zero, two[0] * ww,
    )  # fmt: skip


@wp.func
def pair_hessian_block(h: PairHessian, i: wp.int32, j: wp.int32) -> wp.mat33d:
    """Block d2E/dx_i dx_j [N/m]."""
    w = h.weights
    local = local_block(h, w[i], w[j], h.slide_1[i], h.slide_1[j], h.slide_2[i], h.slide_2[j])
    return h.axes * local * wp.transpose(h.axes)


@wp.struct
class MollifierTerms:
    """What the mollifier adds to m times the Hessian of E: bilinear in three coefficients of two
    nodes, see ``mollifier_coefficients``.

    edge_a, edge_b: the two edges u and v [m].
    by_a, by_b: derivative of c = |u x v|^2 by them [m^3]; of a node it is ``turned``.
    normal: of the pair.
    left, right: mixed term left right^T + right left^T, each as a factor of the gradient of c and
        one of the normal times the node's weight.
    turn, bend: coefficients of hess c [N/m^3] and of grad c grad c^T [N/m^7].
    curvature: 1 for the exact hess c, 0 for its Gauss-Newton part.
    """

    edge_a: wp.vec3d
    edge_b: wp.vec3d
    by_a: wp.vec3d
    by_b: wp.vec3d
    normal: wp.vec3d
    left: wp.vec2d
    right: wp.vec2d
    turn: wp.float64
    bend: wp.float64
    curvature: wp.float64


@wp.func
def mollified_gradient(
    pair: ClosestPair,
    ea0: wp.vec3d,
    ea1: wp.vec3d,
    eb0: wp.vec3d,
    eb1: wp.vec3d,
    threshold: wp.float64,
    e0: wp.float64,
    e1: wp.float64,
) -> mat43d:
    """Gradient [N] of m E(d); e0 = E [J], e1 = dE/dd [N], threshold [m^4] of the mollifier."""
    cross_sq = edge_edge_cross_sq(ea0, ea1, eb0, eb1)
    gradient = pair_gradient(pair, edge_edge_mollifier(cross_sq, threshold) * e1)
    if cross_sq < threshold:
        slope = e0 * edge_edge_mollifier_d1(cross_sq, threshold)
        gradient += slope * edge_edge_cross_sq_gradient(ea0, ea1, eb0, eb1)
    return gradient


@wp.func
def mollifier_terms(
    pair: ClosestPair,
    ea0: wp.vec3d,
    ea1: wp.vec3d,
    eb0: wp.vec3d,
    eb1: wp.vec3d,
    threshold: wp.float64,
    e0: wp.float64,
    e1: wp.float64,
    mode: wp.int32,
) -> MollifierTerms:
    """What the mollifier adds to m times the Hessian of E; arguments of `mollified_gradient`.

    mode: PSD_NONE, or PSD_CLAMP for the sum of projected parts.
    """
    one = wp.float64(1.0)
    zero = wp.float64(0.0)
    cross_sq = edge_edge_cross_sq(ea0, ea1, eb0, eb1)
    h = MollifierTerms()
    if cross_sq >= threshold:
        return h
    slope = edge_edge_mollifier_d1(cross_sq, threshold)
    gradient = edge_edge_cross_sq_gradient(ea0, ea1, eb0, eb1)
    h.edge_a = ea1 - ea0
    h.edge_b = eb1 - eb0
    h.by_a = gradient[1]
    h.by_b = gradient[3]
    h.normal = pair_normal(pair)
    h.turn = e0 * slope
    h.left = wp.vec2d(slope, zero)
    h.right = wp.vec2d(zero, e1)
    if mode == PSD_NONE:
        h.bend = e0 * edge_edge_mollifier_d2(cross_sq, threshold)
        h.curvature = one
    if mode == PSD_CLAMP:
        left_norm = slope * wp.sqrt(wp.ddot(gradient, gradient))
        right_norm = wp.abs(e1) * wp.length(pair.weights)
        if left_norm > zero and right_norm > zero:
            # Sum of the two, each scaled to the geometric mean of both norms; `left right^T +
            # right left^T` with left = right = sum / 2 is then the projection.
            balance = wp.sqrt(right_norm / left_norm)
            h.left = wp.float64(0.5) * wp.vec2d(balance * slope, e1 / balance)
            h.right = h.left
    return h


@wp.func
def mollifier_coefficients(weights: wp.vec4d, i: wp.int32) -> wp.vec3d:
    """Weight of node i in the offset of its pair, and by how much of its own way it moves the first
    edge and the second."""
    sign = wp.float64(2 * (i % 2) - 1)
    zero = wp.float64(0.0)
    if i < 2:
        return wp.vec3d(weights[i], sign, zero)
    return wp.vec3d(weights[i], zero, sign)


@wp.func
def turned(h: MollifierTerms, a: wp.vec3d) -> wp.vec3d:
    """Derivative of c by a node [m^3]."""
    return a[1] * h.by_a + a[2] * h.by_b


@wp.func
def mollifier_block(h: MollifierTerms, a: wp.vec3d, b: wp.vec3d) -> wp.mat33d:
    """The part of a block [N/m] that the mollifier adds, of two nodes by their coefficients."""
    turned_a = turned(h, a)
    turned_b = turned(h, b)
    along_a = a[0] * h.normal
    along_b = b[0] * h.normal
    left_a = h.left[0] * turned_a + h.left[1] * along_a
    left_b = h.left[0] * turned_b + h.left[1] * along_b
    right_a = h.right[0] * turned_a + h.right[1] * along_a
    right_b = h.right[0] * turned_b + h.right[1] * along_b
    block = wp.outer(left_a, right_b) + wp.outer(right_a, left_b)
    block += h.bend * wp.outer(turned_a, turned_b)
    first = wp.vec2d(a[1], a[2])
    second = wp.vec2d(b[1], b[2])
    return block + h.turn * cross_sq_hessian(h.edge_a, h.edge_b, first, second, h.curvature)


@wp.func
def mollifier_pull(h: MollifierTerms, a: wp.vec3d, ways: wp.mat33d) -> wp.vec3d:
    """Sum of the blocks of a node with others times the ways of these [N]; row k of ``ways``: sum
    of these ways [m] times their coefficient k."""
    two = wp.float64(2.0)
    turns = wp.dot(h.by_a, ways[1]) + wp.dot(h.by_b, ways[2])
    along = wp.dot(h.normal, ways[0])
    mine = turned(h, a)
    force = (h.right[0] * turns + h.right[1] * along) * (
        h.left[0] * mine + h.left[1] * a[0] * h.normal
    )
    force += (h.left[0] * turns + h.left[1] * along) * (
        h.right[0] * mine + h.right[1] * a[0] * h.normal
    )
    force += h.bend * turns * mine
    arm = a[1] * h.edge_b - a[2] * h.edge_a
    change = wp.cross(ways[1], h.edge_b) + wp.cross(h.edge_a, ways[2])
    normal = wp.cross(h.edge_a, h.edge_b)
    bent = wp.cross(normal, a[1] * ways[2] - a[2] * ways[1])
    return force + h.turn * two * (wp.cross(arm, change) - h.curvature * bent)
