# SPDX-License-Identifier: Apache-2.0
"""Moving between nodal arrays and the rows of the Newton system."""

from __future__ import annotations

from collections.abc import Iterator

import warp as wp

from taccel_lab.ipc.device.sums import BLOCK_THREADS, block_total
from taccel_lab.ipc.linear.problem.scatter import NewtonSystem
from taccel_lab.ipc.linear.system import LinearSystem
from taccel_lab.ipc.motion.pull_back import nodal_sum, pull_back
from taccel_lab.model import Model
from taccel_lab.model.embedding import listed_node, vertex_range
from taccel_lab.model.env_lists import EnvMask, Envs, env_at
from taccel_lab.model.launches import launch, launch_blocks, side_by_side

wp.set_module_options({"enable_backward": False, "block_dim": BLOCK_THREADS})


@wp.kernel
def _reduce_kernel(
    active: Envs,
    free_nodes: wp.array(dtype=wp.int32),
    gradient_a: wp.array2d(dtype=wp.vec3d),
    gradient_b: wp.array2d(dtype=wp.vec3d),
    gradient_c: wp.array2d(dtype=wp.vec3d),
    reduced: wp.array2d(dtype=wp.vec3d),
):
    place, row = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    reduced[env, row] = nodal_sum(env, free_nodes[row], gradient_a, gradient_b, gradient_c)


@wp.kernel
def _steady_kernel(
    frame_nodes: wp.array(dtype=wp.int32),
    dts: wp.array(dtype=wp.float64),
    velocities: wp.array2d(dtype=wp.vec3d),
    largest_change: wp.float64,
    displacements: wp.array2d(dtype=wp.vec3d),
    mask: wp.array(dtype=wp.int32),
):
    env, lane = wp.tid()
    if mask[env] == 0:
        return
    change = wp.float64(0.0)
    travel = wp.float64(0.0)
    for i in range(lane, frame_nodes.shape[0], wp.block_dim()):
        node = frame_nodes[i]
        goes = displacements[env, node]
        went = dts[env] * velocities[env, node]
        change += wp.length_sq(goes - went)
        travel += wp.length_sq(goes)
    changes = block_total(change)
    travels = block_total(travel)
    if changes > largest_change * largest_change * travels:
        for i in range(lane, frame_nodes.shape[0], wp.block_dim()):
            displacements[env, frame_nodes[i]] = wp.vec3d()
        if lane == 0:
            mask[env] = 0


@wp.kernel
def _coast_kernel(
    mask: wp.array(dtype=wp.int32),
    free_nodes: wp.array(dtype=wp.int32),
    dts: wp.array(dtype=wp.float64),
    velocities: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
):
    env, row = wp.tid()
    if mask[env] != 0:
        displacements[env, free_nodes[row]] = dts[env] * velocities[env, free_nodes[row]]


@wp.kernel
def _velocity_kernel(
    mask: wp.array(dtype=wp.int32),
    start: wp.array2d(dtype=wp.vec3d),
    end: wp.array2d(dtype=wp.vec3d),
    dts: wp.array(dtype=wp.float64),
    velocities: wp.array2d(dtype=wp.vec3d),
):
    env, node = wp.tid()
    if mask[env] != 0:
        velocities[env, node] = (end[env, node] - start[env, node]) / dts[env]


@wp.kernel
def _begin_rhs_kernel(
    active: Envs,
    reduced: wp.array2d(dtype=wp.vec3d),
    keep: int,
    rhs: wp.array2d(dtype=wp.vec3d),
):
    place, row = wp.tid()
    env = env_at(place, active)
    if env < 0:
        return
    load = -reduced[env, row]
    if keep != 0:
        load += rhs[env, row]
    rhs[env, row] = load


@wp.kernel
def _spread_kernel(
    mask: Envs,
    free_nodes: wp.array(dtype=wp.int32),
    first_vertex: int,
    vertex_count: int,
    carried: wp.array(dtype=wp.int32),
    parents: wp.array(dtype=wp.int32),
    weights: wp.array(dtype=wp.vec4d),
    free_index: wp.array(dtype=wp.int32),
    solution: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
):
    place, i = wp.tid()
    env = env_at(place, mask)
    if env < 0:
        return
    if i < solution.shape[1]:
        displacements[env, free_nodes[i]] = solution[env, i]
        return
    node = listed_node(i - solution.shape[1], first_vertex, vertex_count, carried)
    y = parents[node]
    w = weights[node]
    displacements[env, node] = (
        w[0] * solution[env, free_index[y]]
        + w[1] * solution[env, free_index[y + 1]]
        + w[2] * solution[env, free_index[y + 2]]
        + w[3] * solution[env, free_index[y + 3]]
    )


@wp.kernel
def _subtract_rows_kernel(
    mask: wp.array(dtype=wp.int32),
    end: wp.array2d(dtype=wp.vec3d),
    start: wp.array2d(dtype=wp.vec3d),
    result: wp.array2d(dtype=wp.vec3d),
):
    env, node = wp.tid()
    if mask[env] != 0:
        result[env, node] = end[env, node] - start[env, node]


def subtract_rows(mask: EnvMask, end: wp.array, start: wp.array, result: wp.array) -> None:
    """result = end - start in the environments of ``mask``."""
    launch(_subtract_rows_kernel, result.shape, mask, end, start, result)


def newton_system(model: Model, linear: LinearSystem, displacements: wp.array) -> NewtonSystem:
    """What potentials add to: matrix blocks, right-hand sides, motion of prescribed nodes."""
    system = NewtonSystem()
    system.free_index = model.free_index
    system.parents = model.parents
    system.weights = model.weights
    system.row_starts = model.row_starts
    system.columns = model.columns
    system.values = linear.values
    system.extra_room = linear.extra.room
    system.extra_places = linear.extra.places
    system.extra_values = linear.extra.values
    system.rhs = linear.rhs
    system.displacements = displacements
    return system


def newton_systems(
    model: Model, linear: LinearSystem, displacements: wp.array
) -> Iterator[NewtonSystem]:
    """``newton_system`` for what adds in any order, which is launched with all of these in turn:
    the one that there is, or where bits count one that measures and one that adds. Matrix and
    right-hand side are zero before then."""
    blocks, rhs = linear.block_sums.stages(), linear.rhs_sums.stages()
    for block_sums, rhs_sums in zip(blocks, rhs, strict=True):
        system = newton_system(model, linear, displacements)
        system.block_sums, system.rhs_sums = block_sums, rhs_sums
        yield system


def reduce_gradient(
    model: Model, active: EnvMask, gradients: list[wp.array | None], reduced: wp.array
) -> None:
    """Sum of up to three nodal gradients by the unknowns [N], shape [env_count, free_count].

    What acts on a node that an affine body carries along counts with its weights on the control
    nodes.
    """
    gradients = gradients + [None] * (3 - len(gradients))
    soft_rows = model.free_count - 4 * model.affine.count

    def of_soft_bodies() -> None:
        if soft_rows:
            inputs = [active, model.free_nodes, *gradients, reduced]
            launch(_reduce_kernel, (model.env_count, soft_rows), *inputs)

    def of_affine_bodies() -> None:
        pull_back(model, active, gradients, reduced)

    side_by_side(model.device, [of_soft_bodies, of_affine_bodies])


def keep_steady(
    model: Model,
    mask: EnvMask,
    dts: wp.array,
    velocities: wp.array,
    displacements: wp.array,
    largest_change: float,
) -> None:
    """Clear ``mask`` and ``displacements`` [m] where frames go by another way than at their last
    velocities [m/s]: by more than ``largest_change`` of the way, as a root mean square over what
    they carry."""
    inputs = [model.frame_nodes, dts, velocities, largest_change, displacements, mask]
    launch_blocks(_steady_kernel, model.env_count, *inputs)


def coast(
    model: Model, mask: EnvMask, dts: wp.array, velocities: wp.array, displacements: wp.array
) -> None:
    """Set ``displacements`` [m] of free nodes to dt times velocity, in ``mask``."""
    inputs = [mask, model.free_nodes, dts, velocities, displacements]
    launch(_coast_kernel, (model.env_count, model.free_count), *inputs)


def measure_velocities(
    mask: EnvMask, start: wp.array, end: wp.array, dts: wp.array, velocities: wp.array
) -> None:
    """Mean velocities [m/s] over a step, in the environments of ``mask``."""
    launch(_velocity_kernel, end.shape, mask, start, end, dts, velocities)


def begin_rhs(
    model: Model, active: EnvMask, reduced: wp.array, rhs: wp.array, keep: bool = False
) -> None:
    """rhs = -reduced [N], zero in environments that are not active; or with ``keep`` rhs -= reduced
    in the active ones."""
    launch(_begin_rhs_kernel, rhs.shape, active, reduced, int(keep), rhs)


def spread_solution(
    model: Model, mask: EnvMask, solution: wp.array, displacements: wp.array
) -> None:
    """Write the rows of ``solution`` [m] to their nodes, and to what is embedded in them, in the
    environments of ``mask``."""
    first, end = vertex_range(model)
    carried = model.affine.carried
    inputs = [mask, model.free_nodes, first, end - first, carried, model.parents, model.weights]
    inputs += [model.free_index, solution, displacements]
    launch(
        _spread_kernel, (model.env_count, solution.shape[1] + end - first + len(carried)), *inputs
    )
