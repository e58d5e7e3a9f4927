# SPDX-License-Identifier: Apache-2.0
"""Moving between nodal arrays and the rows of the Newton system."""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.ipc.linear.scatter import NewtonSystem
from taccel_lab.model import Model

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _collect_kernel(
    active: wp.array(dtype=wp.int32),
    moving: wp.array(dtype=wp.int32),
    free_index: wp.array(dtype=wp.int32),
    gradient_a: wp.array2d(dtype=wp.vec3d),
    gradient_b: wp.array2d(dtype=wp.vec3d),
    gradient_c: wp.array2d(dtype=wp.vec3d),
    positions: wp.array2d(dtype=wp.vec3d),
    targets: wp.array2d(dtype=wp.vec3d),
    rhs: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
):
    env, node = wp.tid()
    displacements[env, node] = wp.vec3d()
    row = free_index[node]
    if row >= 0:
        rhs[env, row] = wp.vec3d()
    if active[env] == 0:
        return
    if row >= 0:
        rhs[env, row] = -(gradient_a[env, node] + gradient_b[env, node] + gradient_c[env, node])
    elif moving[env] != 0:
        displacements[env, node] = targets[env, node] - positions[env, node]


@wp.kernel
def _spread_kernel(
    active: wp.array(dtype=wp.int32),
    free_nodes: wp.array(dtype=wp.int32),
    solution: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
):
    env, row = wp.tid()
    if active[env] != 0:
        displacements[env, free_nodes[row]] = solution[env, row]


@wp.kernel
def _advance_kernel(
    positions: wp.array2d(dtype=wp.vec3d),
    displacements: wp.array2d(dtype=wp.vec3d),
    fractions: wp.array(dtype=wp.float64),
    result: wp.array2d(dtype=wp.vec3d),
):
    env, node = wp.tid()
    result[env, node] = positions[env, node] + fractions[env] * displacements[env, node]


def adapted_stride(stride: np.ndarray, fraction: np.ndarray) -> np.ndarray:
    """Part of the remaining motion to ask for next, after ``fraction`` of the last was accepted.

    The gel's answer is linear in the motion asked for. Cutting the direction again and again
    instead uses up a tenth of the gap each time, until the barrier is too stiff to recover.
    """
    shorter = np.maximum(0.25 * stride, 1e-9)
    longer = np.minimum(2.0 * stride, 1.0)
    return np.where(fraction < 0.1, shorter, np.where(fraction >= 0.5, longer, stride))


def newton_system(
    model: Model, values: wp.array, rhs: wp.array, displacements: wp.array
) -> NewtonSystem:
    """What contacts add to: matrix blocks, right-hand sides, motion of prescribed nodes."""
    system = NewtonSystem()
    system.free_index = model.free_index
    system.row_starts = model.row_starts
    system.columns = model.columns
    system.values = values
    system.rhs = rhs
    system.displacements = displacements
    return system


def collect_rhs(
    model: Model,
    active: wp.array,
    moving: wp.array,
    gradients: list[wp.array],
    positions: wp.array,
    targets: wp.array,
    rhs: wp.array,
    displacements: wp.array,
) -> None:
    """rhs = -(sum of three gradients) [N]; prescribed nodes get their remaining motion [m].

    ``moving`` flags the environments whose prescribed nodes are still on their way to ``targets``.
    """
    wp.launch(
        _collect_kernel,
        dim=positions.shape,
        inputs=[active, moving, model.free_index, *gradients, positions, targets],
        outputs=[rhs, displacements],
        device=model.device,
    )


def spread_solution(
    model: Model, active: wp.array, solution: wp.array, displacements: wp.array
) -> None:
    """Write the rows of ``solution`` [m] to their nodes in ``displacements``."""
    wp.launch(
        _spread_kernel,
        dim=solution.shape,
        inputs=[active, model.free_nodes, solution],
        outputs=[displacements],
        device=model.device,
    )


def advance_positions(
    positions: wp.array, displacements: wp.array, fractions: wp.array, result: wp.array
) -> None:
    """result = positions + fraction[env] * displacements [m]."""
    wp.launch(
        _advance_kernel,
        dim=positions.shape,
        inputs=[positions, displacements, fractions],
        outputs=[result],
        device=positions.device,
    )
