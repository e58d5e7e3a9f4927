# SPDX-License-Identifier: Apache-2.0
"""The unknowns that a contact moves: its soft nodes, and the control nodes of its affine bodies.

The Hessian of a pair is bilinear in coefficients of its nodes (the 4-vectors of ``PairHessian``,
the weights of friction). A vertex of an affine body is a weighted sum of four control nodes, so
their coefficients are the same weighted sums over the vertices of the pair, and the blocks can be
formed by unknown: 15 for a gel node on a face of an affine body; by vertex there would be 157. A
bonded node that an affine body carries counts as a vertex of it: two bodies and two free nodes, as
where the rim of a gel meets another gel's, have ten unknowns, and nothing has more.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.contact.pair_energy import (
    MollifierTerms,
    PairHessian,
    local_block,
    mollifier_block,
    mollifier_coefficients,
    mollifier_pull,
)
from taccel_lab.ipc.device.matrices import mat43d
from taccel_lab.ipc.device.native import native
from taccel_lab.ipc.linear.problem.scatter import NewtonSystem, add_entry, take_from_rhs

wp.set_module_options({"enable_backward": False})

MOST_PARTS = 8
"""Parts that the 15 to 55 blocks of a stencil are shared out in, on an idle GPU."""
_FEW_LANES = 1 << 13
"""Lanes up to which a GPU is idle enough for several threads a stencil."""


STENCIL_THREADS = 128
"""Threads of a block, as modules with kernels that add stencils state it: 35 KiB of shared memory,
of which 256 threads would need more than every GPU has. Registers allow two or three blocks a
multiprocessor, which have room for it on A100 and later."""

_PLACES = native("stencil_rows", "places")


@wp.func_native(native("stencil_rows", "stencil_stage"))
def stencil_stage() -> wp.uint64:
    """Where a thread keeps the rows of its stencil."""
    ...


@wp.func_native(native("stencil_rows", "open_row", PLACES=_PLACES))
def open_row(stage: wp.uint64, at: int, value: int) -> None:
    """Unknown ``at`` is this row of the Newton system; its coefficients are zero so far."""
    ...


@wp.func_native(native("stencil_rows", "add_coefficients", PLACES=_PLACES))
def add_coefficients(stage: wp.uint64, at: int, value: wp.vec3d) -> None:
    """Add to the coefficients of unknown ``at``."""
    ...


@wp.func_native(_PLACES + "    return *row;")
def row_at(stage: wp.uint64, at: int) -> int:
    """Row of unknown ``at`` in the Newton system."""
    ...


@wp.func_native(native("stencil_rows", "coefficients_at", PLACES=_PLACES))
def coefficients_at(stage: wp.uint64, at: int) -> wp.vec3d:
    """Coefficients of unknown ``at``, columns as those of the nodes."""
    ...


@wp.struct
class StencilRows:
    """Unknowns of a stencil.

    stage: where their rows and coefficients are. count: of them. prescribed: sum over the
    prescribed nodes of coefficient k times their motion [m], row k.
    """

    stage: wp.uint64
    count: wp.int32
    prescribed: wp.mat33d


@wp.func
def stencil_rows(env: int, nodes: wp.vec4i, of_nodes: mat43d, system: NewtonSystem) -> StencilRows:
    """Unknowns of a stencil whose unused entries repeat the last one; row i for node i.

    Control nodes come first: so the blocks among them, which most contacts of an environment share,
    have the same numbers in all of them.
    """
    s = StencilRows()
    s.stage = stencil_stage()
    first_parent = int(-1)
    first_start = int(0)
    second_parent = int(-1)
    second_start = int(0)
    control_count = int(4)
    turns = int(2)
    for turn in range(turns):
        for i in range(4):
            node = nodes[i]
            is_new = True
            if i > 0:
                is_new = node != nodes[(i + 3) % 4]
            parent = system.parents[node]
            if is_new and (parent >= 0) == (turn == 0):
                row = system.free_index[node]
                own = wp.vec3d(of_nodes[i, 0], of_nodes[i, 1], of_nodes[i, 2])
                if parent >= 0:
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
                            open_row(s.stage, start + k, system.free_index[parent + k])
                        s.count += control_count
                    for k in range(control_count):
                        add_coefficients(s.stage, start + k, system.weights[node][k] * own)
                elif row >= 0:
                    open_row(s.stage, s.count, row)
                    add_coefficients(s.stage, s.count, own)
                    s.count += 1
                else:
                    s.prescribed += wp.outer(own, system.displacements[env, node])
    return s


@wp.func
def triangle_row(k: int) -> int:
    """Row of the k-th entry of a lower triangle, counted row by row."""
    return int((wp.sqrt(wp.float32(8 * k + 1)) - wp.float32(1.0)) * wp.float32(0.5) + 1.0e-3)


@wp.func
def add_lower(env: int, row: int, column: int, block: wp.mat33d, system: NewtonSystem):
    """Add a block, or its transpose where it belongs to the upper triangle."""
    if column > row:
        add_entry(env, column, row, wp.transpose(block), system)
    else:
        add_entry(env, row, column, block, system)


# The functions below go through the blocks of the lower triangle one after the other, whatever the
# rows are: threads of a GPU whose stencils differ stay side by side.


@wp.func
def add_pair_hessian(
    env: int, nodes: wp.vec4i, h: PairHessian, part: int, parts: int, system: NewtonSystem
):
    """Add the Hessian of a pair [N/m] to the Newton system; what prescribed nodes that move
    contribute goes to its right-hand side [N].

    ``part``: adds the blocks part, part + parts, ... only.
    """
    of_nodes = mat43d()
    for i in range(4):
        of_nodes[i, 0] = h.weights[i]
        of_nodes[i, 1] = h.slide_1[i]
        of_nodes[i, 2] = h.slide_2[i]
    s = stencil_rows(env, nodes, of_nodes, system)
    to_axes = wp.transpose(h.axes)
    one = h.tangent_1
    two = h.tangent_2
    # Of the prescribed nodes, in the axes: their ways by weights, and along n by slides.
    by_weights = to_axes * s.prescribed[0]
    slid_1 = wp.dot(wp.vec3d(h.axes[0, 0], h.axes[1, 0], h.axes[2, 0]), s.prescribed[1])
    slid_2 = wp.dot(wp.vec3d(h.axes[0, 0], h.axes[1, 0], h.axes[2, 0]), s.prescribed[2])
    pull = wp.vec3d(
        h.normal * by_weights[0],
        one[0] * by_weights[1] + one[1] * slid_1,
        two[0] * by_weights[2] + two[1] * slid_2,
    )
    pull_1 = one[1] * by_weights[1] + one[2] * slid_1
    pull_2 = two[1] * by_weights[2] + two[2] * slid_2
    pulled = wp.length_sq(pull) > wp.float64(0.0) or pull_1 != wp.float64(0.0)
    pulled = pulled or pull_2 != wp.float64(0.0)
    for k in range(part, s.count * (s.count + 1) / 2, parts):
        i = triangle_row(k)
        j = k - i * (i + 1) / 2
        a = coefficients_at(s.stage, i)
        b = coefficients_at(s.stage, j)
        row = row_at(s.stage, i)
        if pulled and i == j:
            along = a[0] * pull[0] + a[1] * pull_1 + a[2] * pull_2
            force = wp.vec3d(along, a[0] * pull[1], a[0] * pull[2])
            take_from_rhs(env, row, h.axes * force, system)
        local = local_block(h, a[0], b[0], a[1], b[1], a[2], b[2])
        add_lower(env, row, row_at(s.stage, j), h.axes * local * to_axes, system)


@wp.func
def add_mollifier(
    env: int,
    nodes: wp.vec4i,
    weights: wp.vec4d,
    h: MollifierTerms,
    part: int,
    parts: int,
    system: NewtonSystem,
):
    """Add what the mollifier of a pair adds to its Hessian [N/m]; ``part`` as in
    ``add_pair_hessian``."""
    of_nodes = mat43d()
    for i in range(4):
        own = mollifier_coefficients(weights, i)
        of_nodes[i, 0] = own[0]
        of_nodes[i, 1] = own[1]
        of_nodes[i, 2] = own[2]
    s = stencil_rows(env, nodes, of_nodes, system)
    pulled = wp.ddot(s.prescribed, s.prescribed) > wp.float64(0.0)
    for k in range(part, s.count * (s.count + 1) / 2, parts):
        i = triangle_row(k)
        j = k - i * (i + 1) / 2
        a = coefficients_at(s.stage, i)
        row = row_at(s.stage, i)
        if pulled and i == j:
            take_from_rhs(env, row, mollifier_pull(h, a, s.prescribed), system)
        block = mollifier_block(h, a, coefficients_at(s.stage, j))
        add_lower(env, row, row_at(s.stage, j), block, system)


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
    for i in range(4):
        of_nodes[i, 0] = weights[i]
    s = stencil_rows(env, nodes, of_nodes, system)
    pull = core * s.prescribed[0]
    pulled = wp.length_sq(pull) > wp.float64(0.0)
    for k in range(part, s.count * (s.count + 1) / 2, parts):
        i = triangle_row(k)
        j = k - i * (i + 1) / 2
        weight = coefficients_at(s.stage, i)[0]
        row = row_at(s.stage, i)
        if pulled and i == j:
            take_from_rhs(env, row, weight * pull, system)
        share = weight * coefficients_at(s.stage, j)[0]
        if share != wp.float64(0.0):
            add_lower(env, row, row_at(s.stage, j), share * core, system)


def row_parts(device: wp.Device, env_count: int, lanes: int) -> int:
    """Parts that stencils are shared out in, each of which evaluates the stencil anew."""
    return 1 if device.is_cpu or env_count * lanes > _FEW_LANES else MOST_PARTS
