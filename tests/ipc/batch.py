# SPDX-License-Identifier: Apache-2.0
"""Warp functions of `taccel_lab.ipc` over batches of numpy arrays, one launch a batch."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import warp as wp

from taccel_lab.ipc.contact import barrier as barrier_module
from taccel_lab.ipc.contact import friction
from taccel_lab.ipc.contact.pair_energy import (
    PairHessian,
    mollified_gradient,
    mollifier_block,
    mollifier_terms,
    pair_gradient,
    pair_hessian,
    pair_hessian_block,
)
from taccel_lab.ipc.device.matrices import mat23d, mat43d, mat1212d, tangent_basis
from taccel_lab.ipc.distance import ccd
from taccel_lab.ipc.distance.closest_pairs import (
    ClosestPair,
    closest_edge_edge,
    closest_point_edge,
    closest_point_point,
    closest_point_triangle,
    edge_edge_distance_sq,
    point_edge_distance_sq,
    point_triangle_distance_sq,
)
from taccel_lab.ipc.distance.edge_edge_mollifier import (
    edge_edge_cross_sq,
    edge_edge_mollifier,
    edge_edge_mollifier_threshold,
)

wp.set_module_options({"enable_backward": False})

POINT_TRIANGLE, EDGE_EDGE, POINT_EDGE, POINT_POINT = range(4)
Array = np.ndarray[Any, np.dtype[Any]]


@wp.func
def _closest(kind: wp.int32, x0: wp.vec3d, x1: wp.vec3d, x2: wp.vec3d, x3: wp.vec3d) -> ClosestPair:
    if kind == 0:
        return closest_point_triangle(x0, x1, x2, x3)
    if kind == 1:
        return closest_edge_edge(x0, x1, x2, x3)
    if kind == 2:
        return closest_point_edge(x0, x1, x2)
    return closest_point_point(x0, x1)


@wp.func
def _distance_sq(
    kind: wp.int32, x0: wp.vec3d, x1: wp.vec3d, x2: wp.vec3d, x3: wp.vec3d
) -> wp.float64:
    if kind == 0:
        return point_triangle_distance_sq(x0, x1, x2, x3)
    if kind == 1:
        return edge_edge_distance_sq(x0, x1, x2, x3)
    if kind == 2:
        return point_edge_distance_sq(x0, x1, x2)
    return wp.length_sq(x0 - x1)


@wp.kernel
def _query_pairs_kernel(
    kind: wp.int32,
    x: wp.array2d(dtype=wp.vec3d),
    region: wp.array(dtype=wp.int32),
    free_count: wp.array(dtype=wp.int32),
    weights: wp.array(dtype=wp.vec4d),
    distance_sq: wp.array(dtype=wp.float64),
    distance_sq_only: wp.array(dtype=wp.float64),
):
    i = wp.tid()
    pair = _closest(kind, x[i, 0], x[i, 1], x[i, 2], x[i, 3])
    region[i] = pair.region
    free_count[i] = pair.free_count
    weights[i] = pair.weights
    distance_sq[i] = pair.distance_sq
    distance_sq_only[i] = _distance_sq(kind, x[i, 0], x[i, 1], x[i, 2], x[i, 3])


@wp.func
def hessian_matrix(h: PairHessian) -> mat1212d:
    """All 16 blocks [N/m], which the solver never forms as a whole."""
    matrix = mat1212d()
    block_count = int(16)  # a variable, so that Warp does not unroll the loop
    for k in range(block_count):
        block = pair_hessian_block(h, k // 4, k % 4)
        for a in range(3):
            for b in range(3):
                matrix[3 * (k // 4) + a, 3 * (k % 4) + b] = block[a, b]
    return matrix


@wp.kernel
def _pair_energy_kernel(
    kind: wp.int32,
    mode: wp.int32,
    x: wp.array2d(dtype=wp.vec3d),
    e1: wp.array(dtype=wp.float64),
    e2: wp.array(dtype=wp.float64),
    gradient: wp.array(dtype=mat43d),
    hessian: wp.array(dtype=mat1212d),
):
    i = wp.tid()
    pair = _closest(kind, x[i, 0], x[i, 1], x[i, 2], x[i, 3])
    gradient[i] = pair_gradient(pair, e1[i])
    h = pair_hessian(pair, x[i, 0], x[i, 1], x[i, 2], x[i, 3], e1[i], e2[i], mode)
    hessian[i] = hessian_matrix(h)


@wp.kernel
def _mollifier_kernel(
    x: wp.array2d(dtype=wp.vec3d),
    rest: wp.array2d(dtype=wp.vec3d),
    threshold: wp.array(dtype=wp.float64),
    value: wp.array(dtype=wp.float64),
):
    i = wp.tid()
    e = edge_edge_mollifier_threshold(rest[i, 0], rest[i, 1], rest[i, 2], rest[i, 3])
    threshold[i] = e
    value[i] = edge_edge_mollifier(edge_edge_cross_sq(x[i, 0], x[i, 1], x[i, 2], x[i, 3]), e)


@wp.kernel
def _mollified_energy_kernel(
    mode: wp.int32,
    dhat: wp.float64,
    stiffness: wp.float64,
    x: wp.array2d(dtype=wp.vec3d),
    threshold: wp.array(dtype=wp.float64),
    value: wp.array(dtype=wp.float64),
    gradient: wp.array(dtype=mat43d),
    hessian: wp.array(dtype=mat1212d),
):
    i = wp.tid()
    pair = closest_edge_edge(x[i, 0], x[i, 1], x[i, 2], x[i, 3])
    d = wp.sqrt(pair.distance_sq)
    e0 = barrier_module.contact_potential(d, dhat, stiffness)
    e1 = barrier_module.contact_potential_d1(d, dhat, stiffness)
    e2 = barrier_module.contact_potential_d2(d, dhat, stiffness)
    e = threshold[i]
    value[i] = e0 * edge_edge_mollifier(edge_edge_cross_sq(x[i, 0], x[i, 1], x[i, 2], x[i, 3]), e)
    gradient[i] = mollified_gradient(pair, x[i, 0], x[i, 1], x[i, 2], x[i, 3], e, e0, e1)
    m = edge_edge_mollifier(edge_edge_cross_sq(x[i, 0], x[i, 1], x[i, 2], x[i, 3]), e)
    h = pair_hessian(pair, x[i, 0], x[i, 1], x[i, 2], x[i, 3], m * e1, m * e2, mode)
    terms = mollifier_terms(pair, x[i, 0], x[i, 1], x[i, 2], x[i, 3], e, e0, e1, mode)
    matrix = hessian_matrix(h)
    block_count = int(16)
    for k in range(block_count):
        block = mollifier_block(terms, k // 4, k % 4)
        for a in range(3):
            for b in range(3):
                matrix[3 * (k // 4) + a, 3 * (k % 4) + b] += block[a, b]
    hessian[i] = matrix


@wp.kernel
def _barrier_kernel(
    d: wp.array(dtype=wp.float64),
    dhat: wp.array(dtype=wp.float64),
    stiffness: wp.float64,
    ipc_form: wp.array(dtype=wp.vec3d),
    potential: wp.array(dtype=wp.vec3d),
):
    i = wp.tid()
    ipc_form[i] = wp.vec3d(
        dhat[i] * dhat[i] * barrier_module.unit_barrier(d[i] / dhat[i]),
        dhat[i] * barrier_module.unit_barrier_d1(d[i] / dhat[i]),
        barrier_module.unit_barrier_d2(d[i] / dhat[i]),
    )
    potential[i] = wp.vec3d(
        barrier_module.contact_potential(d[i], dhat[i], stiffness),
        barrier_module.contact_potential_d1(d[i], dhat[i], stiffness),
        barrier_module.contact_potential_d2(d[i], dhat[i], stiffness),
    )


@wp.kernel
def _friction_kernel(
    weights: wp.array(dtype=wp.vec4d),
    n: wp.array(dtype=wp.vec3d),
    dx: wp.array2d(dtype=wp.vec3d),
    mu_lambda: wp.float64,
    eps_u: wp.float64,
    smoothing: wp.array(dtype=wp.vec3d),
    u_out: wp.array(dtype=wp.vec3d),
    value: wp.array(dtype=wp.float64),
    gradient: wp.array(dtype=wp.vec3d),
    hessian: wp.array(dtype=wp.mat33d),
):
    i = wp.tid()
    u = friction.tangential(
        n[i], friction.relative_displacement(weights[i], dx[i, 0], dx[i, 1], dx[i, 2], dx[i, 3])
    )
    size = wp.length(u)
    smoothing[i] = wp.vec3d(
        friction.friction_f0(size, eps_u),
        friction.friction_f1_over_u(size, eps_u),
        friction.friction_f2(size, eps_u),
    )
    u_out[i] = u
    value[i] = friction.friction_potential(u, mu_lambda, eps_u)
    gradient[i] = friction.friction_gradient(u, mu_lambda, eps_u)
    hessian[i] = friction.friction_hessian(n[i], u, mu_lambda, eps_u, wp.float64(1.0))


@wp.kernel
def _tangent_kernel(n: wp.array(dtype=wp.vec3d), basis: wp.array(dtype=mat23d)):
    i = wp.tid()
    basis[i] = tangent_basis(n[i])


@wp.kernel
def _ccd_kernel(
    kind: wp.int32,
    x: wp.array2d(dtype=wp.vec3d),
    dx: wp.array2d(dtype=wp.vec3d),
    thickness: wp.array(dtype=wp.float64),
    slackness: wp.float64,
    t_max: wp.float64,
    max_iterations: wp.int32,
    toi: wp.array(dtype=wp.float64),
    status: wp.array(dtype=wp.int32),
    iterations: wp.array(dtype=wp.int32),
):
    i = wp.tid()
    result = ccd.CCDResult()
    if kind == 0:
        result = ccd.point_triangle_ccd(
            x[i, 0], x[i, 1], x[i, 2], x[i, 3], dx[i, 0], dx[i, 1], dx[i, 2], dx[i, 3],
            thickness[i], slackness, t_max, max_iterations,
        )  # fmt: skip
    elif kind == 1:
        result = ccd.edge_edge_ccd(
            x[i, 0], x[i, 1], x[i, 2], x[i, 3], dx[i, 0], dx[i, 1], dx[i, 2], dx[i, 3],
            thickness[i], slackness, t_max, max_iterations,
        )  # fmt: skip
    else:
        # Point x0, plane through x1 with the normal in x2.
        result = ccd.point_plane_ccd(
            x[i, 0], x[i, 1], x[i, 2], dx[i, 0], dx[i, 1], thickness[i], slackness, t_max
        )
    toi[i] = result.toi
    status[i] = result.status
    iterations[i] = result.iterations


class Pairs(NamedTuple):
    region: Array
    free_count: Array
    weights: Array
    distance_sq: Array
    distance_sq_only: Array


def _device(values: Any, dtype: Any) -> wp.array:
    return wp.array(np.ascontiguousarray(values, dtype=np.float64), dtype=dtype, device="cpu")


def _launch(kernel: Any, count: int, inputs: list[Any], outputs: list[Any]) -> list[Array]:
    arrays = [wp.zeros(count, dtype=dtype, device="cpu") for dtype in outputs]
    wp.launch(kernel, count, inputs=inputs, outputs=arrays, device="cpu")
    return [array.numpy() for array in arrays]


def _filled(values: Any, count: int) -> wp.array:
    return _device(np.broadcast_to(np.asarray(values, dtype=np.float64), (count,)), wp.float64)


def query_pairs(kind: int, x: Array) -> Pairs:
    """Closest pairs of stencils x, shape [count, 4, 3]."""
    dtypes = [wp.int32, wp.int32, wp.vec4d, wp.float64, wp.float64]
    return Pairs(*_launch(_query_pairs_kernel, len(x), [kind, _device(x, wp.vec3d)], dtypes))


def pair_energy(kind: int, mode: int, x: Array, e1: Any, e2: Any) -> tuple[Array, Array]:
    """Gradient [count, 4, 3] and Hessian [count, 12, 12] of E(d)."""
    inputs = [kind, mode, _device(x, wp.vec3d), _filled(e1, len(x)), _filled(e2, len(x))]
    gradient, hessian = _launch(_pair_energy_kernel, len(x), inputs, [mat43d, mat1212d])
    return gradient, hessian


def mollifier(x: Array, rest: Array) -> list[Array]:
    """Threshold and value of the edge-edge mollifier."""
    inputs = [_device(x, wp.vec3d), _device(rest, wp.vec3d)]
    return _launch(_mollifier_kernel, len(x), inputs, [wp.float64, wp.float64])


def mollified_energy(
    mode: int, dhat: float, stiffness: float, x: Array, threshold: Any
) -> list[Array]:
    """Value, gradient and Hessian of the mollified edge-edge contact potential."""
    inputs = [mode, dhat, stiffness, _device(x, wp.vec3d), _filled(threshold, len(x))]
    return _launch(_mollified_energy_kernel, len(x), inputs, [wp.float64, mat43d, mat1212d])


def barrier(d: Array, dhat: Any, stiffness: float = 1.0) -> list[Array]:
    """Columns value, first and second derivative of the IPC form and of the contact potential."""
    inputs = [_device(d, wp.float64), _filled(dhat, len(d)), stiffness]
    return _launch(_barrier_kernel, len(d), inputs, [wp.vec3d, wp.vec3d])


def friction_terms(
    weights: Array, n: Array, dx: Array, mu_lambda: float, eps_u: float
) -> list[Array]:
    """(f0, f1/u, f2), u, potential, gradient and Hessian by the relative displacement."""
    inputs = [_device(weights, wp.vec4d), _device(n, wp.vec3d), _device(dx, wp.vec3d)]
    outputs = [wp.vec3d, wp.vec3d, wp.float64, wp.vec3d, wp.mat33d]
    return _launch(_friction_kernel, len(n), [*inputs, mu_lambda, eps_u], outputs)


def tangents(n: Array) -> Array:
    """Tangent rows [count, 2, 3] of unit normals."""
    return _launch(_tangent_kernel, len(n), [_device(n, wp.vec3d)], [mat23d])[0]


def collide(
    kind: int,
    x: Array,
    dx: Array,
    thickness: Any = 0.0,
    slackness: float = 0.1,
    t_max: float = 1.0,
    max_iterations: int = 1000,
) -> tuple[Array, Array, Array]:
    """Time of impact, status and iterations; kind 2 is the point-plane query."""
    inputs = [kind, _device(x, wp.vec3d), _device(dx, wp.vec3d), _filled(thickness, len(x))]
    inputs += [slackness, t_max, max_iterations]
    toi, status, iterations = _launch(_ccd_kernel, len(x), inputs, [wp.float64, wp.int32, wp.int32])
    return toi, status, iterations
