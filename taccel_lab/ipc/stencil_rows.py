# SPDX-License-Identifier: Apache-2.0
"""The unknowns that a contact moves: its soft nodes, and the control nodes of its affine bodies.

The Hessian of a pair is bilinear in coefficients of its nodes (the 4-vectors of ``PairHessian``,
the weights of friction). A vertex of an affine body is a weighted sum of four control nodes, so
their coefficients are the same weighted sums over the vertices of the pair, and the blocks can be
formed by unknown: 15 for a gel node on a face of an affine body; by vertex there would be 157.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.linear.scatter import NewtonSystem, add_entry
from taccel_lab.ipc.matrix_types import mat43d
from taccel_lab.ipc.pair_hessian import PairHessian, local_block

wp.set_module_options({"enable_backward": False})

MOST_ROWS = 8
"""Two affine bodies, or three soft nodes and one."""
_FEW_LANES = 1 << 13
"""Lanes up to which a GPU is idle enough for every row of a stencil to have its own."""
vec8i = wp.types.vector(length=8, dtype=wp.int32)
mat83d = wp.types.matrix(shape=(8, 3), dtype=wp.float64)


@wp.struct
class StencilRows:
    """Unknowns of a stencil.

    count: of them. rows: in the Newton system, -1 for a node without one. nodes: node of each row.
    coefficients: row i for unknown i, columns as those of the nodes.
    """

    count: wp.int32
    rows: vec8i
    nodes: vec8i
    coefficients: mat83d


@wp.func
def stencil_rows(nodes: wp.vec4i, of_nodes: mat43d, system: NewtonSystem) -> StencilRows:
    """Unknowns of a stencil whose unused entries repeat the last one; row i for node i."""
    s = StencilRows()
    first_parent = int(-1)
    first_start = int(0)
    second_parent = int(-1)
    second_start = int(0)
    node_count = int(4)
    control_count = int(4)
    for i in range(node_count):
        node = nodes[i]
        is_new = True
        if i > 0:
            is_new = node != nodes[i - 1]
        if is_new:
            parent = system.parents[node]
            if parent < 0:
                s.rows[s.count] = system.free_index[node]
                s.nodes[s.count] = node
                s.coefficients[s.count] = of_nodes[i]
                s.count += 1
            else:
                start = s.count
                if parent == first_parent:
                    start = first_start
                elif parent == second_parent:
                    start = second_start
                else:
                    if first_parent < 0:
                        first_parent = parent
                        first_start = start
                    else:
                        second_parent = parent
                        second_start = start
                    for k in range(control_count):
                        s.rows[start + k] = system.free_index[parent + k]
                        s.nodes[start + k] = parent + k
                    s.count += control_count
                for k in range(control_count):
                    s.coefficients[start + k] += system.weights[node][k] * of_nodes[i]
    return s


@wp.func
def add_pair_hessian(
    env: int, nodes: wp.vec4i, h: PairHessian, part: int, parts: int, system: NewtonSystem
):
    """Add the Hessian of a pair [N/m] to the Newton system; what prescribed nodes that move
    contribute goes to its right-hand side [N].

    ``part``: adds the rows part, part + parts, ... only.
    """
    of_nodes = mat43d()
    node_count = int(4)
    for i in range(node_count):
        of_nodes[i] = wp.vec3d(h.weights[i], h.slide_1[i], h.slide_2[i])
    s = stencil_rows(nodes, of_nodes, system)
    to_axes = wp.transpose(h.axes)
    one = h.tangent_1
    two = h.tangent_2
    # Sums over the prescribed nodes, in the axes: of their ways by weights, and along n by slides.
    by_weights = wp.vec3d()
    by_slides = wp.vec2d()
    for i in range(s.count):
        if s.rows[i] < 0:
            way = to_axes * system.displacements[env, s.nodes[i]]
            by_weights += s.coefficients[i, 0] * way
            by_slides += way[0] * wp.vec2d(s.coefficients[i, 1], s.coefficients[i, 2])
    pull = wp.vec3d(
        h.normal * by_weights[0],
        one[0] * by_weights[1] + one[1] * by_slides[0],
        two[0] * by_weights[2] + two[1] * by_slides[1],
    )
    pull_1 = one[1] * by_weights[1] + one[2] * by_slides[0]
    pull_2 = two[1] * by_weights[2] + two[2] * by_slides[1]
    pulled = wp.length_sq(pull) > wp.float64(0.0) or pull_1 != wp.float64(0.0)
    pulled = pulled or pull_2 != wp.float64(0.0)
    for i in range(part, s.count, parts):
        row = s.rows[i]
        if row >= 0:
            w = s.coefficients[i, 0]
            slide_1 = s.coefficients[i, 1]
            slide_2 = s.coefficients[i, 2]
            if pulled:
                force = w * pull
                force[0] = force[0] + slide_1 * pull_1 + slide_2 * pull_2
                wp.atomic_sub(system.rhs, env, row, h.axes * force)
            for j in range(s.count):
                column = s.rows[j]
                if column >= 0 and column <= row:
                    local = local_block(
                        h,
                        w,
                        s.coefficients[j, 0],
                        slide_1,
                        s.coefficients[j, 1],
                        slide_2,
                        s.coefficients[j, 2],
                    )
                    add_entry(env, row, column, h.axes * local * to_axes, system)


@wp.func
def add_weighted_block(
    env: int,
    nodes: wp.vec4i,
    weights: wp.vec4d,
    core: wp.mat33d,
    part: int,
    parts: int,
    system: NewtonSystem,
):
    """Add w_i w_j times ``core`` [N/m] for all pairs of nodes to the Newton system; ``part`` as in
    ``add_pair_hessian``."""
    of_nodes = mat43d()
    node_count = int(4)
    for i in range(node_count):
        of_nodes[i] = wp.vec3d(weights[i], wp.float64(0.0), wp.float64(0.0))
    s = stencil_rows(nodes, of_nodes, system)
    way = wp.vec3d()
    for i in range(s.count):
        if s.rows[i] < 0:
            way += s.coefficients[i, 0] * system.displacements[env, s.nodes[i]]
    pull = core * way
    for i in range(part, s.count, parts):
        row = s.rows[i]
        weight = s.coefficients[i, 0]
        if row >= 0 and weight != wp.float64(0.0):
            if wp.length_sq(pull) > wp.float64(0.0):
                wp.atomic_sub(system.rhs, env, row, weight * pull)
            for j in range(s.count):
                column = s.rows[j]
                if column >= 0 and column <= row:
                    add_entry(env, row, column, (weight * s.coefficients[j, 0]) * core, system)


def row_parts(device: wp.Device, env_count: int, lanes: int) -> int:
    """Parts that stencils are shared out in, each of which evaluates the stencil anew."""
    return 1 if device.is_cpu or env_count * lanes > _FEW_LANES else MOST_ROWS
