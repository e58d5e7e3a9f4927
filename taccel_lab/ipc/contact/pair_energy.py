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
    cross_sq_hessian_block,
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
    """What the mollifier adds to m times the Hessian of E, in factors.

    left, right: mixed term left right^T + right left^T, rows per node.
    turn, bend: coefficients of hess c [N/m^3] and of grad c grad c^T [N/m^7].
    curvature: 1 for the exact hess c, 0 for its Gauss-Newton part.
    edge_a, edge_b: the two edges [m].
    cross_gradient: grad c [m^3].
    """

    left: mat43d
    right: mat43d
    turn: wp.float64
    bend: wp.float64
    curvature: wp.float64
    edge_a: wp.vec3d
    edge_b: wp.vec3d
    cross_gradient: mat43d


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
def _norm(rows: mat43d) -> wp.float64:
    return wp.sqrt(wp.ddot(rows, rows))


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
    half = wp.float64(0.5)
    cross_sq = edge_edge_cross_sq(ea0, ea1, eb0, eb1)
    h = MollifierTerms()
    if cross_sq >= threshold:
        return h
    slope = edge_edge_mollifier_d1(cross_sq, threshold)
    h.edge_a = ea1 - ea0
    h.edge_b = eb1 - eb0
    h.turn = e0 * slope
    h.cross_gradient = edge_edge_cross_sq_gradient(ea0, ea1, eb0, eb1)
    h.left = slope * h.cross_gradient
    h.right = outer_rows(pair.weights, e1 * pair_normal(pair))
    if mode == PSD_NONE:
        h.bend = e0 * edge_edge_mollifier_d2(cross_sq, threshold)
        h.curvature = wp.float64(1.0)
    if mode == PSD_CLAMP:
        left_norm = _norm(h.left)
        right_norm = _norm(h.right)
        if left_norm > wp.float64(0.0) and right_norm > wp.float64(0.0):
            # Sum of the two, each scaled to the geometric mean of both norms; `left right^T +
            # right left^T` with left = right = sum / 2 is then the projection.
            balance = wp.sqrt(right_norm / left_norm)
            h.left = half * (balance * h.left + h.right / balance)
            h.right = h.left
    return h


@wp.func
def mollifier_block(h: MollifierTerms, i: wp.int32, j: wp.int32) -> wp.mat33d:
    """The part of a block [N/m] that the mollifier adds."""
    block = wp.outer(h.left[i], h.right[j]) + wp.outer(h.right[i], h.left[j])
    block += h.turn * cross_sq_hessian_block(h.edge_a, h.edge_b, i, j, h.curvature)
    block += h.bend * wp.outer(h.cross_gradient[i], h.cross_gradient[j])
    return block
