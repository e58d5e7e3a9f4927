# SPDX-License-Identifier: Apache-2.0
r"""Nodal gradients of a nodal field on a scattered surface mesh: the least bent network of curves.

Every mesh edge carries the cubic with the end values f and the end slopes ``g . e``. The gradients
g are those of least total bending ``sum_edges int (d^2 f / ds^2)^2 ds``. With e the edge vector
(length L) and Df the rise along it, node a obeys

    sum_edges (e e^T / L^3) (2 g_a + g_b) = 3 sum_edges Df e / L^3

(G. M. Nielson, "A method for interpolating scattered data based upon a minimum norm network",
Math. Comp. 40 (1983) 253-271). Planes are exact. Unlike a patch fit the network bends where the
data bend, so the jump of curvature at a contact's edge does not spread. The matrix is block
diagonally dominant 2:1, so block Jacobi halves the error each sweep.
"""

# Warp compiles the kernels from their source; its type stubs describe neither vectors' operators
# nor FP64 overloads.
# pyright: reportArgumentType=false, reportAssignmentType=false, reportCallIssue=false
# pyright: reportGeneralTypeIssues=false, reportIndexIssue=false, reportOperatorIssue=false

from __future__ import annotations

from typing import Any

import warp as wp

wp.set_module_options({"enable_backward": False})

# 2^-30 = 1e-9 of the initial error, far below the interpolation error.
_SWEEPS = 30


@wp.kernel
def _relax_gradients_kernel(
    positions: wp.array2d(dtype=wp.vec3d),
    values: wp.array2d(dtype=wp.float64),
    ring_start: wp.array(dtype=wp.int32),
    ring_nodes: wp.array(dtype=wp.int32),
    gradients: wp.array2d(dtype=wp.vec2d),
    # Out
    gradients_out: wp.array2d(dtype=wp.vec2d),
):
    env, node = wp.tid()
    origin = positions[env, node]
    value = values[env, node]
    matrix = wp.mat22d()
    rhs = wp.vec2d()
    for entry in range(ring_start[node], ring_start[node + 1]):
        other = ring_nodes[entry]
        p = positions[env, other]
        edge = wp.vec2d(p[0] - origin[0], p[1] - origin[1])
        length = wp.length(edge)
        if length > wp.float64(0.0):
            along = edge / length
            weight = wp.float64(1.0) / length
            matrix = matrix + wp.float64(2.0) * weight * wp.outer(along, along)
            rise = wp.float64(3.0) * (values[env, other] - value) / length
            rhs = rhs + weight * (rise - wp.dot(along, gradients[env, other])) * along
    det = wp.determinant(matrix)
    trace = wp.trace(matrix)
    result = wp.vec2d()
    if det > wp.float64(1e-12) * trace * trace:
        result = wp.inverse(matrix) * rhs
    elif trace > wp.float64(0.0):
        # All edges in one line: the slope across it is open, take the least one.
        result = rhs / trace
    gradients_out[env, node] = result


def recover_gradients(positions: Any, values: Any, ring_start: Any, ring_nodes: Any) -> Any:
    """Gradient over xy of a nodal field.

    Args:
        positions: Nodes [m], Warp array of vec3d, shape [env, node]; only xy is used.
        values: Field, Warp float64 array, shape [env, node].
        ring_start: Offsets of each node's edge neighbours, Warp int32 array, shape [node + 1].
        ring_nodes: Those neighbours, Warp int32 array.

    Returns:
        Warp array of vec2d, shape [env, node], unit of ``values`` per metre.
    """
    current = wp.zeros(values.shape, dtype=wp.vec2d, device=values.device)
    following = wp.empty_like(current)
    for _ in range(_SWEEPS):
        wp.launch(
            _relax_gradients_kernel,
            dim=values.shape,
            inputs=[positions, values, ring_start, ring_nodes, current],
            outputs=[following],
            device=values.device,
        )
        current, following = following, current
    return current
