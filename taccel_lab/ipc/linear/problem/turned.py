# SPDX-License-Identifier: Apache-2.0
"""Solutions of matrices that are not positive definite: modes of negative curvature are turned.

A factor changes the sign of its negative pivots. CG makes A-conjugate directions p, along which the
solution is the sum of (p, b) / (p, A p) p; with |p, A p| in its place the sum descends along each
[Moré and Sorensen 1979, On the use of directions of negative curvature in a modified Newton
method]. A solution leads no further than the matrix says something.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import warp as wp

from taccel_lab.ipc.linear.problem.arrays import LinearProblem

wp.set_module_options({"enable_backward": False})

LEAST_TURNED = 0.01
"""Part of a diagonal block's trace, negative pivots turned, that a turned pivot is at least."""


def reach_m(problem: LinearProblem, clusters: Sequence[tuple[int, int]]) -> float:
    """Longest way that a turned solution may lead, as a norm over all rows [m]: the mean distance
    of coupled gel nodes at rest, infinite without any. ``clusters``: ranges (first, end) of rows of
    affine bodies."""
    if problem.positions_m is None:
        return np.inf
    rows, columns = problem.pattern.rows, problem.pattern.columns
    gel = np.ones(problem.pattern.free_count, dtype=bool)
    for first, end in clusters:
        gel[first:end] = False
    coupled = (rows != columns) & gel[rows] & gel[columns]
    ways = problem.positions_m[rows[coupled]] - problem.positions_m[columns[coupled]]
    return float(np.linalg.norm(ways, axis=1).mean()) if len(ways) else np.inf


@wp.func
def turned_pivot(pivot: wp.float64, least: wp.float64) -> wp.float64:
    """A pivot that was negative with the other sign, at least ``least``; others as they are."""
    if pivot < wp.float64(0.0):
        return wp.max(-pivot, least)
    return pivot


@wp.func
def turning(block: wp.mat33d) -> wp.vec3d:
    """What turns the negative pivots of a symmetric block, added to its diagonal; zero for one that
    is positive definite, or has a pivot of zero."""
    trace = wp.abs(block[0, 0]) + wp.abs(block[1, 1]) + wp.abs(block[2, 2])
    least = wp.float64(LEAST_TURNED) * trace
    d0 = turned_pivot(block[0, 0], least)
    l1 = block[1, 0] / d0
    l2 = block[2, 0] / d0
    rest1 = block[1, 1] - l1 * block[1, 0]
    d1 = turned_pivot(rest1, least)
    below = block[2, 1] - l2 * block[1, 0]
    rest2 = block[2, 2] - l2 * block[2, 0] - below * below / d1
    d2 = turned_pivot(rest2, least)
    more = wp.vec3d(d0 - block[0, 0], d1 - rest1, d2 - rest2)
    if not wp.isfinite(more):
        # What it is divided by was zero: such a block keeps the inverse that it has, or has not.
        return wp.vec3d()
    return more


@wp.func
def turned_curvature(curvature: wp.float64, length_sq: wp.float64) -> wp.float64:
    """The curvature of a direction, as of a pivot; ``length_sq``: its own by the preconditioner."""
    return turned_pivot(curvature, wp.float64(LEAST_TURNED) * length_sq)


@wp.func
def shortened(length_sq: wp.float64, descent: wp.float64, reach: wp.float64) -> wp.float64:
    """Part of a turned solution x to take, of its square and of (x, rhs): within ``reach``, and
    nothing where rounding has left no descent."""
    if not (descent > wp.float64(0.0) and descent < wp.float64(wp.inf)):
        return wp.float64(0.0)
    return wp.min(reach / wp.sqrt(length_sq), wp.float64(1.0))
