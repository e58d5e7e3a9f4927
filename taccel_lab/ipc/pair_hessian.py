# SPDX-License-Identifier: Apache-2.0
"""Gradient and Hessian of an energy E(d) of the distance of a pair, in a basis of five vectors.

With the frame (n, t_a) and the slide vectors c_a of a pair (see `distance/derivatives.py`) and
(w (x) v)_i = w_i v, the second derivative of the distance is

    d2d = (w w^T) (x) (sum over fixed t_a of t_a t_a^T) / d
        - sum over free t_a of [ (w t_a) (c_a n)^T + (c_a n) (w t_a)^T + d (c_a n) (c_a n)^T ]

so E'' grad d grad d^T + E' d2d lives in the span of w n, w t1, w t2, c1 n and c2 n. With
(w, c1, c2) orthonormalised in R^4 these are five orthonormal 12-vectors and a 5x5 matrix, whose
projection to positive semidefinite *is* the projection of the 12x12 matrix, at a fraction of its
cost, and from which any 3x3 block is formed where it is needed. Own derivation; d must be > 0.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.distance.closest_pair import ClosestPair
from taccel_lab.ipc.distance.derivatives import outer_rows, pair_frame, pair_normal
from taccel_lab.ipc.matrix_types import mat35d, mat43d, mat55d, vec5d
from taccel_lab.ipc.psd import project_psd_5x5

wp.set_module_options({"enable_backward": False})

HESSIAN_EXACT = wp.constant(0)
"""The second derivative itself, in general indefinite."""
HESSIAN_PSD = wp.constant(1)
"""Its exact projection to positive semidefinite."""
HESSIAN_GAUSS_NEWTON = wp.constant(2)
"""Only max(E'', 0) grad d grad d^T."""


@wp.struct
class PairHessian:
    """Hessian of a pair: sum over basis vectors of basis_a core_ab basis_b^T.

    axes: columns n, t1, t2.
    basis_w, basis_1, basis_2: orthonormal 4-vectors; the five basis vectors are basis_w n,
        basis_w t1, basis_w t2, basis_1 n, basis_2 n.
    core: symmetric 5x5 [N/m].
    """

    axes: wp.mat33d
    basis_w: wp.vec4d
    basis_1: wp.vec4d
    basis_2: wp.vec4d
    core: mat55d


@wp.func
def pair_gradient(pair: ClosestPair, e1: wp.float64) -> mat43d:
    """Gradient [N] of E(d), row i for node i; e1 = dE/dd [N]."""
    return outer_rows(pair.weights, e1 * pair_normal(pair))


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

    mode: HESSIAN_EXACT, HESSIAN_PSD or HESSIAN_GAUSS_NEWTON.
    """
    zero = wp.float64(0.0)
    frame = pair_frame(pair, x0, x1, x2, x3)
    weight_norm = wp.length(pair.weights)
    w = pair.weights / weight_norm
    h = PairHessian()
    h.axes = frame.axes
    h.basis_w = w

    if mode == HESSIAN_GAUSS_NEWTON:
        h.core[0, 0] = wp.max(e2, zero) * weight_norm * weight_norm
        return h

    along_1 = wp.dot(w, frame.slide_1)
    rest_1 = frame.slide_1 - along_1 * w
    norm_1 = wp.length(rest_1)
    h.basis_1 = wp.normalize(rest_1)
    along_2 = wp.dot(w, frame.slide_2)
    cross_2 = wp.dot(h.basis_1, frame.slide_2)
    rest_2 = frame.slide_2 - along_2 * w - cross_2 * h.basis_1
    h.basis_2 = wp.normalize(rest_2)

    distance = wp.sqrt(pair.distance_sq)
    stretch = e1 / distance * weight_norm * weight_norm
    core = mat55d()
    core[0, 0] = e2 * weight_norm * weight_norm
    if pair.free_count == 0:
        core[1, 1] = stretch
    if pair.free_count < 2:
        core[2, 2] = stretch
    if pair.free_count > 0:
        slide = vec5d(along_1, zero, zero, norm_1, zero)
        tangent = vec5d(zero, weight_norm, zero, zero, zero)
        core -= e1 * (wp.outer(tangent, slide) + wp.outer(slide, tangent))
        core -= (e1 * distance) * wp.outer(slide, slide)
    if pair.free_count > 1:
        slide = vec5d(along_2, zero, zero, cross_2, wp.length(rest_2))
        tangent = vec5d(zero, zero, weight_norm, zero, zero)
        core -= e1 * (wp.outer(tangent, slide) + wp.outer(slide, tangent))
        core -= (e1 * distance) * wp.outer(slide, slide)
    if mode == HESSIAN_PSD:
        core = project_psd_5x5(core)
    h.core = core
    return h


@wp.func
def _node_basis(h: PairHessian, i: wp.int32) -> mat35d:
    """Rows n, t1, t2 of node i of the five basis vectors."""
    rows = mat35d()
    rows[0, 0] = h.basis_w[i]
    rows[1, 1] = h.basis_w[i]
    rows[2, 2] = h.basis_w[i]
    rows[0, 3] = h.basis_1[i]
    rows[0, 4] = h.basis_2[i]
    return rows


@wp.func
def pair_hessian_block(h: PairHessian, i: wp.int32, j: wp.int32) -> wp.mat33d:
    """Block d2E/dx_i dx_j [N/m]."""
    local = _node_basis(h, i) * h.core * wp.transpose(_node_basis(h, j))
    return h.axes * local * wp.transpose(h.axes)
