# SPDX-License-Identifier: Apache-2.0
"""The closest points of two primitives on a stencil of four nodes, whatever the primitives are.

Every distance of the contact model is `d = |r|` with `r = sum_i w_i x_i`, where the signed weights
`w` (sum zero) are affine in zero, one or two free closest-point parameters `beta`. All derivatives
of `d` follow from `w`, `dw/dbeta` and the positions (`derivatives.py`), so one structure serves
point-point, point-edge, point-triangle and edge-edge pairs and no formula is written per region.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

# sin^2 of the angle below which two directions count as parallel: rounding leaves a cross product
# of unit vectors about 1e-16 off, so at an angle of 1e-12 it still has four digits.
PARALLEL_SIN_SQ = wp.constant(wp.float64(1.0e-24))


@wp.struct
class ClosestPair:
    """Closest points of two primitives of a stencil x0..x3.

    region: code of the region enum of the query (which vertex, edge or face is closest).
    free_count: closest-point parameters inside their range: 0 point-point, 1 point-edge, 2 both.
    weights: signed weights [-], sum 0; `offset = sum_i weights[i] x_i`.
    dweights_a, dweights_b: derivative of the weights by the free parameters (zero if not free).
    offset: vector between the closest points, from the second primitive to the first [m].
    distance_sq: |offset|^2 [m^2].
    """

    region: wp.int32
    free_count: wp.int32
    weights: wp.vec4d
    dweights_a: wp.vec4d
    dweights_b: wp.vec4d
    offset: wp.vec3d
    distance_sq: wp.float64


@wp.func
def combine(weights: wp.vec4d, x0: wp.vec3d, x1: wp.vec3d, x2: wp.vec3d, x3: wp.vec3d) -> wp.vec3d:
    """Weighted sum of the nodes for weights that sum to zero; exact cancellation of a common shift.

    Differences come first so that a pair far from the origin keeps its digits.
    """
    return weights[1] * (x1 - x0) + weights[2] * (x2 - x0) + weights[3] * (x3 - x0)


@wp.func
def edge_parameter(offset: wp.vec3d, edge: wp.vec3d) -> wp.float64:
    """Parameter in [0, 1] of the point of a segment that is closest to a point.

    offset: the point relative to the start of the segment [m]; edge: end relative to start [m]. A
    segment of no length has parameter 0.
    """
    length_sq = wp.dot(edge, edge)
    if length_sq <= wp.float64(0.0):
        return wp.float64(0.0)
    return wp.clamp(wp.dot(offset, edge) / length_sq, wp.float64(0.0), wp.float64(1.0))


@wp.func
def plane_parameters(u: wp.vec3d, v: wp.vec3d, r: wp.vec3d) -> wp.vec2d:
    """Least-squares (a, b) of a u + b v = r; (-1, -1) when u and v are parallel.

    Cross products instead of the 2x2 normal equations: those square the condition number. A second
    pass on the residual removes what rounding left.
    """
    n = wp.cross(u, v)
    n_sq = wp.dot(n, n)
    if n_sq <= PARALLEL_SIN_SQ * wp.dot(u, u) * wp.dot(v, v):
        return wp.vec2d(wp.float64(-1.0), wp.float64(-1.0))
    a = wp.dot(wp.cross(r, v), n) / n_sq
    b = wp.dot(wp.cross(u, r), n) / n_sq
    rest = r - a * u - b * v
    a += wp.dot(wp.cross(rest, v), n) / n_sq
    b += wp.dot(wp.cross(u, rest), n) / n_sq
    return wp.vec2d(a, b)
