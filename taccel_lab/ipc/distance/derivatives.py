# SPDX-License-Identifier: Apache-2.0
"""First and second derivatives of the distance of any closest pair.

With r(x, beta) = sum_i w_i(beta) x_i, `d^2 = min_beta |r|^2`. The envelope theorem gives
`d(d^2)/dx_i = 2 w_i r`. Differentiating once more and eliminating beta (Schur complement of the
stationarity condition, B_a = dr/dbeta_a, G_ab = B_a . B_b, c_a = dw/dbeta_a) gives block (i, j)

    H_ij / 2 = w_i w_j I - sum_ab inv(G)_ab (w_i B_a + c_ai r) (w_j B_b + c_bj r)^T .

With B = T R (columns of T orthonormal, R upper triangular) and c~ = c inv(R) the sum loses inv(G),
which keeps the accuracy on slivers and nearly parallel edges. Own derivation.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.device.matrices import mat43d, tangent_basis
from taccel_lab.ipc.distance.closest_pairs import ClosestPair, combine

wp.set_module_options({"enable_backward": False})


@wp.struct
class PairFrame:
    """Orthonormal frame of a pair and the change of its weights along the two tangents.

    axes: columns n, t1, t2; n points from the second primitive to the first.
    slide_1, slide_2: change of the weights per metre that the closest points slide along t1 and
        t2 [1/m]; zero where the closest points cannot slide.
    """

    axes: wp.mat33d
    slide_1: wp.vec4d
    slide_2: wp.vec4d


@wp.func
def pair_normal(pair: ClosestPair) -> wp.vec3d:
    """Unit vector from the second primitive to the first; zero when they touch."""
    return wp.normalize(pair.offset)


@wp.func
def outer_rows(weights: wp.vec4d, v: wp.vec3d) -> mat43d:
    """Rows w_i v."""
    return wp.outer(weights, v)


@wp.func
def pair_frame(
    pair: ClosestPair, x0: wp.vec3d, x1: wp.vec3d, x2: wp.vec3d, x3: wp.vec3d
) -> PairFrame:
    """Frame of a pair at the node positions [m] it was computed from."""
    frame = PairFrame()
    n = pair_normal(pair)
    basis = tangent_basis(n)
    t1 = basis[0]
    t2 = basis[1]
    if pair.free_count > 0:
        along_a = combine(pair.dweights_a, x0, x1, x2, x3)
        length_a = wp.length(along_a)
        t1 = along_a / length_a
        t2 = wp.cross(n, t1)
        frame.slide_1 = pair.dweights_a / length_a
        if pair.free_count > 1:
            along_b = combine(pair.dweights_b, x0, x1, x2, x3)
            shear = wp.dot(along_b, t1)
            across = along_b - shear * t1
            # The remainder of a nearly parallel pair still leans on t1 by rounding.
            across -= wp.dot(across, t1) * t1
            height = wp.length(across)
            t2 = across / height
            frame.slide_2 = (pair.dweights_b - shear * frame.slide_1) / height
            # The plane of the two features gives the normal to full precision, also at
            # distances where the offset itself is mostly rounding.
            face = wp.normalize(wp.cross(t1, t2))
            n = wp.where(wp.dot(face, pair.offset) < wp.float64(0.0), -face, face)
    frame.axes = wp.matrix_from_cols(n, t1, t2)
    return frame
