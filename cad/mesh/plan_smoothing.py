# SPDX-License-Identifier: Apache-2.0
"""Shape smoothing of a planar quadrilateral mesh whose fixed nodes stay where they are.

Each quad corner with edge vectors a and b has the shape measure (|a|^2 + |b|^2) / (2 a x b), 1 for
a square and growing without bound as it flattens (P. Knupp, Int. J. Numer. Meth. Engng 48 (2000)
1165). The cross product J is replaced by (J + sqrt(J^2 + e^2)) / 2, so that folded cells are pulled
open instead of stopping the search (J. Escobar et al., Comput. Methods Appl. Mech. Engrg. 192
(2003) 2775).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from taccel_lab.processes.process_pool import one_blas_thread


def smooth_plan(
    xy: np.ndarray, quads: np.ndarray, free: np.ndarray, *, iterations: int = 60
) -> np.ndarray:
    """Move nodes to lower the sum of squared shape measures.

    xy [mm], shape [n, 2]; quads counter-clockwise, shape [m, 4]; ``free`` lists nodes, or says by
    coordinate what may move, bool, shape [n, 2]. Returns new positions.
    """
    if free.dtype != bool:
        nodes, free = free, np.zeros(xy.shape, dtype=bool)
        free[nodes] = True
    if not free.any():
        return xy.copy()
    moving = np.asarray(free.any(axis=1))
    touched = quads[moving[quads].any(axis=1)]
    corner = touched.ravel()
    ahead, behind = np.roll(touched, -1, axis=1).ravel(), np.roll(touched, 1, axis=1).ravel()
    area = np.abs(_cross(xy[ahead] - xy[corner], xy[behind] - xy[corner]))
    softness = 2e-3 * np.maximum(area, 0.05 * np.median(area))
    # Each node moves in units of its own shortest edge, so that fine and coarse parts converge
    # together.
    unit = np.full(len(xy), np.inf)
    length = np.linalg.norm(xy[ahead] - xy[corner], axis=1)
    np.minimum.at(unit, corner, length)
    np.minimum.at(unit, ahead, length)
    scale = np.broadcast_to(unit[:, None], xy.shape)[free]

    count = len(xy)

    def energy(steps: np.ndarray) -> tuple[float, np.ndarray]:
        moved = xy.copy()
        moved[free] += steps * scale
        # By coordinate: columns of two are slow.
        x, y = np.ascontiguousarray(moved.T)
        ax, ay = x[ahead] - x[corner], y[ahead] - y[corner]
        bx, by = x[behind] - x[corner], y[behind] - y[corner]
        cross = ax * by - ay * bx
        root = np.sqrt(cross**2 + softness**2)
        # The second form is the same number without cancellation in folded corners.
        soft = np.where(cross > 0, 0.5 * (cross + root), 0.5 * softness**2 / (root + np.abs(cross)))
        shape = (ax**2 + ay**2 + (bx**2 + by**2)) / (2 * soft)
        by_square = 2 * shape / (2 * soft) * 2
        by_cross = -2 * shape**2 / soft * 0.5 * (1 + cross / root)
        gradient = np.empty((count, 2))
        for k, a, b, a_turned, b_turned in ((0, ax, bx, -ay, by), (1, ay, by, ax, -bx)):
            to_a = by_square * a + by_cross * b_turned
            to_b = by_square * b + by_cross * a_turned
            gradient[:, k] = (
                np.bincount(ahead, to_a, count)
                + np.bincount(behind, to_b, count)
                - np.bincount(corner, to_a + to_b, count)
            )
        return float((shape**2).sum()), gradient[free] * scale

    result = xy.copy()
    result[free] += descend(energy, len(scale), iterations) * scale
    return result


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def descend(
    energy: Callable[[np.ndarray], tuple[float, np.ndarray]], count: int, iterations: int
) -> np.ndarray:
    """Steps [count] from zero that lower ``energy``, which returns value and gradient, by L-BFGS-B
    in at most ``iterations`` iterations; the same on any number of cores."""
    from scipy.optimize import minimize

    with one_blas_thread():
        found = minimize(
            energy, np.zeros(count), jac=True, method="L-BFGS-B",
            options={"maxiter": iterations, "maxcor": 12},
        )  # fmt: skip
    return found.x
