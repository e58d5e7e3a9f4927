# SPDX-License-Identifier: Apache-2.0
"""Derivatives by all nodes of a pair as whole matrices, which the solver never forms."""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.distance.closest_pair import ClosestPair
from taccel_lab.ipc.distance.derivatives import outer_rows, pair_frame, pair_normal
from taccel_lab.ipc.distance.edge_edge_mollifier import (
    cross_sq_hessian_block,
    edge_edge_cross_sq,
    edge_edge_cross_sq_gradient,
    edge_edge_mollifier_d1,
    edge_edge_mollifier_d2,
)
from taccel_lab.ipc.matrix_types import mat43d, mat1212d
from taccel_lab.ipc.pair_hessian import PairHessian, pair_hessian_block

wp.set_module_options({"enable_backward": False})


@wp.func
def distance_gradient(pair: ClosestPair) -> mat43d:
    """Derivative of the distance by the nodes [-], row i = w_i n."""
    return outer_rows(pair.weights, pair_normal(pair))


@wp.func
def distance_sq_gradient(pair: ClosestPair) -> mat43d:
    """Derivative of the squared distance by the nodes [m], row i = 2 w_i r."""
    return outer_rows(pair.weights, wp.float64(2.0) * pair.offset)


@wp.func
def distance_sq_hessian(
    pair: ClosestPair, x0: wp.vec3d, x1: wp.vec3d, x2: wp.vec3d, x3: wp.vec3d
) -> mat1212d:
    """Second derivative of the squared distance by the nodes [-]."""
    frame = pair_frame(pair, x0, x1, x2, x3)
    t1 = wp.vec3d(frame.axes[0, 1], frame.axes[1, 1], frame.axes[2, 1])
    t2 = wp.vec3d(frame.axes[0, 2], frame.axes[1, 2], frame.axes[2, 2])
    two = wp.float64(2.0)
    hessian = mat1212d()
    block_count = int(16)  # a variable, so that Warp does not unroll the loop
    for k in range(block_count):
        i = k // 4
        j = k % 4
        wi = pair.weights[i]
        wj = pair.weights[j]
        block = wi * wj * wp.identity(n=3, dtype=wp.float64)
        if pair.free_count > 0:
            left = wi * t1 + frame.slide_1[i] * pair.offset
            right = wj * t1 + frame.slide_1[j] * pair.offset
            block -= wp.outer(left, right)
        if pair.free_count > 1:
            left = wi * t2 + frame.slide_2[i] * pair.offset
            right = wj * t2 + frame.slide_2[j] * pair.offset
            block -= wp.outer(left, right)
        for a in range(3):
            for b in range(3):
                hessian[3 * i + a, 3 * j + b] = two * block[a, b]
    return hessian


@wp.func
def edge_edge_mollifier_gradient(
    ea0: wp.vec3d, ea1: wp.vec3d, eb0: wp.vec3d, eb1: wp.vec3d, threshold: wp.float64
) -> mat43d:
    """Derivative of the mollifier by the nodes [1/m]."""
    slope = edge_edge_mollifier_d1(edge_edge_cross_sq(ea0, ea1, eb0, eb1), threshold)
    return slope * edge_edge_cross_sq_gradient(ea0, ea1, eb0, eb1)


@wp.func
def edge_edge_mollifier_hessian(
    ea0: wp.vec3d, ea1: wp.vec3d, eb0: wp.vec3d, eb1: wp.vec3d, threshold: wp.float64
) -> mat1212d:
    """Second derivative of the mollifier by the nodes [1/m^2], exact."""
    cross_sq = edge_edge_cross_sq(ea0, ea1, eb0, eb1)
    slope = edge_edge_mollifier_d1(cross_sq, threshold)
    bend = edge_edge_mollifier_d2(cross_sq, threshold)
    gradient = edge_edge_cross_sq_gradient(ea0, ea1, eb0, eb1)
    hessian = mat1212d()
    block_count = int(16)
    for k in range(block_count):
        i = k // 4
        j = k % 4
        block = slope * cross_sq_hessian_block(ea1 - ea0, eb1 - eb0, i, j, wp.float64(1.0))
        block += bend * wp.outer(gradient[i], gradient[j])
        for a in range(3):
            for b in range(3):
                hessian[3 * i + a, 3 * j + b] = block[a, b]
    return hessian


@wp.func
def hessian_matrix(h: PairHessian) -> mat1212d:
    """All 16 blocks [N/m]."""
    matrix = mat1212d()
    block_count = int(16)
    for k in range(block_count):
        block = pair_hessian_block(h, k // 4, k % 4)
        for a in range(3):
            for b in range(3):
                matrix[3 * (k // 4) + a, 3 * (k % 4) + b] = block[a, b]
    return matrix
