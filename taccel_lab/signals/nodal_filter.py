# SPDX-License-Identifier: Apache-2.0
"""Takes node-to-node ripple out of a nodal field on the contact surface.

Linear tets of a nearly incompressible gel alternate: on a structured mesh neighbouring surface
nodes sit a few micrometres above and below the mean surface (4 um at 0.25 mm elements and Poisson's
ratio 0.46), which tilts the interpolated surface by degrees. The filter replaces each value by the
quadratic least-squares fit over the patch around it (A. Savitzky, M. Golay, Anal. Chem. 36 (1964)
1627, on scattered nodes): quadratics pass unchanged, an alternating field shrinks five-fold a pass.
"""

# Warp compiles the kernels from their source; its type stubs describe neither vectors' operators
# nor FP64 overloads.
# pyright: reportArgumentType=false, reportAssignmentType=false, reportCallIssue=false
# pyright: reportGeneralTypeIssues=false, reportIndexIssue=false, reportOperatorIssue=false

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.signals.contact_surface import ContactSurface

wp.set_module_options({"enable_backward": False})

vec6d = wp.types.vector(length=6, dtype=wp.float64)
mat66d = wp.types.matrix(shape=(6, 6), dtype=wp.float64)

# Ridge on slope and curvature, relative to the weights: decides only where a patch leaves them
# open (nodes in a line), far below the fit elsewhere.
_RIDGE = wp.constant(wp.float64(1e-12))


@wp.func
def solve_spd6(matrix: mat66d, rhs: vec6d) -> vec6d:
    """Solve a symmetric positive definite 6x6 system by Cholesky factorisation."""
    lower = matrix
    x = rhs
    for j in range(6):
        pivot = lower[j, j]
        for k in range(j):
            pivot = pivot - lower[j, k] * lower[j, k]
        pivot = wp.sqrt(wp.max(pivot, wp.float64(1e-30)))
        lower[j, j] = pivot
        for i in range(j + 1, 6):
            value = lower[i, j]
            for k in range(j):
                value = value - lower[i, k] * lower[j, k]
            lower[i, j] = value / pivot
    for i in range(6):
        value = x[i]
        for k in range(i):
            value = value - lower[i, k] * x[k]
        x[i] = value / lower[i, i]
    for back in range(6):
        i = 5 - back
        value = x[i]
        for k in range(i + 1, 6):
            value = value - lower[k, i] * x[k]
        x[i] = value / lower[i, i]
    return x


@wp.kernel
def _filter_nodes_kernel(
    xy: wp.array(dtype=wp.vec2d),
    values: wp.array(dtype=wp.float64),
    usable: wp.array(dtype=wp.int32),
    patch_start: wp.array(dtype=wp.int32),
    patch_nodes: wp.array(dtype=wp.int32),
    # Out
    filtered: wp.array(dtype=wp.float64),
):
    node = wp.tid()
    filtered[node] = values[node]
    if usable[node] == 0:
        return
    reach = wp.float64(0.0)
    count = wp.int32(1)
    for entry in range(patch_start[node], patch_start[node + 1]):
        if usable[patch_nodes[entry]] != 0:
            reach = wp.max(reach, wp.length(xy[patch_nodes[entry]] - xy[node]))
            count += 1
    # A quadratic has six coefficients: fewer values than eight would hardly be averaged.
    if count < 8:
        return
    matrix = mat66d()
    rhs = vec6d()
    matrix[0, 0] = wp.float64(1.0)
    rhs[0] = values[node]
    for entry in range(patch_start[node], patch_start[node + 1]):
        other = patch_nodes[entry]
        if usable[other] != 0:
            d = (xy[other] - xy[node]) / reach
            row = vec6d(wp.float64(1.0), d[0], d[1], d[0] * d[0], d[0] * d[1], d[1] * d[1])
            # Falls to a quarter at the rim, so that nodes enter and leave patches gently.
            weight = wp.float64(1.0) - wp.float64(0.75) * wp.dot(d, d)
            matrix = matrix + weight * wp.outer(row, row)
            rhs = rhs + weight * values[other] * row
    for i in range(1, 6):
        matrix[i, i] = matrix[i, i] + _RIDGE * matrix[0, 0]
    filtered[node] = solve_spd6(matrix, rhs)[0]


def filter_nodes(
    surface: ContactSurface,
    xy: np.ndarray,
    values: np.ndarray,
    usable: np.ndarray,
    *,
    passes: int = 1,
) -> np.ndarray:
    """Filter a nodal field of one environment.

    Args:
        surface: Contact triangulation.
        xy: Node positions [m], shape [node, 2].
        values: Field, shape [node].
        usable: Nodes to filter, and to filter with; the others keep their value, shape [node].
        passes: How often; each pass takes more of the ripple and of details below two elements.

    Returns:
        Filtered field, shape [node]. Nodes with fewer than seven usable neighbours keep theirs.
    """
    device = "cpu"
    points = wp.array(xy, dtype=wp.vec2d, device=device)
    mask = wp.array(usable.astype(np.int32), dtype=wp.int32, device=device)
    start = wp.array(surface.patch_start, dtype=wp.int32, device=device)
    nodes = wp.array(surface.patch_nodes, dtype=wp.int32, device=device)
    # Unusable values may be NaN and are never read, but must not poison the arithmetic.
    current = wp.array(np.where(usable, values, 0.0), dtype=wp.float64, device=device)
    following = wp.empty_like(current)
    for _ in range(passes):
        wp.launch(
            _filter_nodes_kernel,
            dim=len(values),
            inputs=[points, current, mask, start, nodes],
            outputs=[following],
            device=device,
        )
        current, following = following, current
    return np.where(usable, current.numpy(), values)
