# SPDX-License-Identifier: Apache-2.0
"""Matrix blocks of bonded nodes that an affine body carries: of elements, and of inertia.

Sums in a fixed order, as all that elements gather; see ``model.carried`` for the formula.
"""

from __future__ import annotations

import warp as wp

from taccel_lab.ipc.device.sums import block_total
from taccel_lab.ipc.potentials.stencil_rows import triangle_row
from taccel_lab.model import Model
from taccel_lab.model.carried import CarriedBlocks
from taccel_lab.model.env_lists import EnvMask, Envs, env_at
from taccel_lab.model.launches import WARP_THREADS, launch, launch_blocks

wp.set_module_options({"enable_backward": False, "block_dim": WARP_THREADS})

_PAIRS = 10
"""Blocks of the lower triangle of the four control nodes of a body."""
_THREADS = 32
"""Threads that add up one of them."""


@wp.kernel
def _couple_kernel(
    active: Envs,
    targets: wp.array(dtype=wp.vec4i),
    starts: wp.array(dtype=wp.int32),
    sources: wp.array(dtype=wp.int32),
    nodes: wp.array(dtype=wp.int32),
    weights: wp.array(dtype=wp.vec4d),
    parts: wp.array2d(dtype=wp.mat33d),
    values: wp.array2d(dtype=wp.mat33d),
):
    """Control node k of a body with a free node: sum of w_k(b) d^2E / dx_b dx_free."""
    place, i, k = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    block = targets[i][k]
    total = values[env, block]
    for s in range(starts[i], starts[i + 1]):
        part = parts[env, sources[s] / 2]
        if sources[s] % 2 == 1:
            part = wp.transpose(part)
        total += weights[nodes[s]][k] * part
    values[env, block] = total


@wp.func
def _block_of(item: int) -> wp.vec3i:
    """Body and block (i, j) of the lower triangle of its control nodes."""
    k = item % _PAIRS
    i = triangle_row(k)
    return wp.vec3i(item / _PAIRS, i, k - i * (i + 1) / 2)


@wp.kernel
def _own_kernel(
    active: Envs,
    corners: wp.array(dtype=wp.vec4i),
    starts: wp.array(dtype=wp.int32),
    sources: wp.array(dtype=wp.int32),
    nodes: wp.array(dtype=wp.vec2i),
    weights: wp.array(dtype=wp.vec4d),
    parts: wp.array2d(dtype=wp.mat33d),
    values: wp.array2d(dtype=wp.mat33d),
):
    """Two control nodes of a body; a thread block for each of the ten blocks."""
    place, item, lane = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    which = _block_of(item)
    body = which[0]
    i = which[1]
    j = which[2]
    total = wp.mat33d()
    for s in range(starts[body] + lane, starts[body + 1], wp.block_dim()):
        part = parts[env, sources[s]]
        b = nodes[s][0]
        c = nodes[s][1]
        total += weights[b][i] * weights[c][j] * part
        if b != c:
            total += weights[c][i] * weights[b][j] * wp.transpose(part)
    block = wp.mat33d()
    for row in range(3):
        for column in range(3):
            block[row, column] = block_total(total[row, column])
    if lane == 0:
        values[env, corners[body][i] - (i - j)] += block


@wp.kernel
def _inertia_kernel(
    active: Envs,
    first_row: int,
    diagonal: wp.array(dtype=wp.int32),
    starts: wp.array(dtype=wp.int32),
    carried: wp.array(dtype=wp.int32),
    weights: wp.array(dtype=wp.vec4d),
    masses: wp.array2d(dtype=wp.float64),
    spans: wp.array(dtype=wp.float64),
    values: wp.array2d(dtype=wp.mat33d),
):
    """The same of sum m w_i w_j / s^2."""
    place, item, lane = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    which = _block_of(item)
    body = which[0]
    i = which[1]
    j = which[2]
    mine = wp.float64(0.0)
    for s in range(starts[body] + lane, starts[body + 1], wp.block_dim()):
        node = carried[s]
        w = weights[node]
        mine += masses[env % masses.shape[0], node] * w[i] * w[j]
    total = block_total(mine) / (spans[env] * spans[env])
    if lane == 0:
        block = diagonal[first_row + 4 * body + i] - (i - j)
        values[env, block] += total * wp.identity(n=3, dtype=wp.float64)


def gather_carried(
    model: Model, active: EnvMask, blocks: CarriedBlocks, parts: wp.array, values: wp.array
) -> None:
    """Add parts [N/m], mat33d, [env_count, part_count], of elements that hold carried nodes to the
    blocks of the matrix, [env_count, block_count]."""
    inputs = [active, blocks.targets, blocks.starts, blocks.sources, blocks.nodes, model.weights]
    launch(_couple_kernel, (model.env_count, len(blocks.targets), 4), *inputs, parts, values)
    inputs = [active, blocks.corners, blocks.own_starts, blocks.own_parts, blocks.own_nodes]
    inputs += [model.weights, parts, values]
    launch_blocks(_own_kernel, (model.env_count, _PAIRS * len(blocks.corners)), *inputs)


def add_carried_inertia(model: Model, active: EnvMask, spans: wp.array, values: wp.array) -> None:
    """Add the inertia of carried nodes [N/m] to the blocks of the control nodes; ``spans``: see
    ``InertiaPotential``."""
    affine = model.affine
    inputs = [active, model.free_count - 4 * affine.count, model.diagonal, affine.carried_starts]
    inputs += [affine.carried, model.weights, model.masses, spans, values]
    launch_blocks(_inertia_kernel, (model.env_count, _PAIRS * affine.count), *inputs)
