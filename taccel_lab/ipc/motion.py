# SPDX-License-Identifier: Apache-2.0
"""Moving between nodal arrays and the rows of the Newton system."""

from __future__ import annotations

import warp as wp

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
