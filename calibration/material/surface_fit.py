# SPDX-License-Identifier: Apache-2.0
"""Polynomials through values and slopes at the nodes of a grid of two parameters.

Where only values are known at m x n nodes, the space is P_m x P_n (polynomials of degree below m
and n). A slope at each node along one axis doubles the degrees there: P_m x P_2n + P_2m x P_n holds
exactly as many polynomials as there are values and slopes along both axes, and one that is zero in
all of them is zero (Hermite along one axis, Lagrange along the other).
"""

from __future__ import annotations

import math

import numpy as np


def chebyshev_nodes(count: int) -> np.ndarray:
    """Chebyshev nodes in 0..1, falling."""
    return 0.5 * (1 + np.cos(math.pi * (np.arange(count) + 0.5) / count))


def chebyshev_basis(z: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """T_0 .. T_{count-1} at z and their derivatives."""
    # T_k = cos(k a) and T_k' = k sin(k a) / sin(a), by their recurrences: quicker than numpy's.
    value, slope = [1.0, z], [0.0, 1.0]
    for _ in range(2, count):
        value.append(2 * z * value[-1] - value[-2])
        slope.append(2 * value[-2] + 2 * z * slope[-1] - slope[-2])
    return np.array(value[:count]), np.array(slope[:count])


def fit_surface(
    first: np.ndarray,
    second: np.ndarray,
    values: np.ndarray,
    first_slopes: np.ndarray | None = None,
    second_slopes: np.ndarray | None = None,
) -> np.ndarray:
    """Chebyshev coefficients of the polynomial through values, and slopes where they are given.

    Args:
        first: Nodes of the first parameter in -1..1, shape [m].
        second: Of the second one, shape [n].
        values: Shape [m, n, item].
        first_slopes: Derivatives by the first parameter, shape [m, n, item].
        second_slopes: By the second one.

    Returns:
        Shape [m or 2 m, n or 2 n, item]; zero where the polynomial has no term.
    """
    m, n = len(first), len(second)
    rows = m if first_slopes is None else 2 * m
    columns = n if second_slopes is None else 2 * n
    terms = [(j, i) for j in range(rows) for i in range(columns) if j < m or i < n]
    equations, right = [], []
    for a, x in enumerate(first):
        for b, y in enumerate(second):
            at_x, by_x = chebyshev_basis(float(x), rows)
            at_y, by_y = chebyshev_basis(float(y), columns)
            equations.append([at_x[j] * at_y[i] for j, i in terms])
            right.append(values[a, b])
            if first_slopes is not None:
                equations.append([by_x[j] * at_y[i] for j, i in terms])
                right.append(first_slopes[a, b])
            if second_slopes is not None:
                equations.append([at_x[j] * by_y[i] for j, i in terms])
                right.append(second_slopes[a, b])
    found = np.linalg.solve(np.array(equations), np.array(right))
    result = np.zeros((rows, columns, values.shape[2]))
    for term, row in zip(terms, found, strict=True):
        result[term] = row
    return result
