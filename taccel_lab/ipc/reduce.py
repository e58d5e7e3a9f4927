# SPDX-License-Identifier: Apache-2.0
"""Sums over the entries of an environment, in a fixed order."""

from __future__ import annotations

import math

import numpy as np
import warp as wp


def sum_rows(values: wp.array) -> np.ndarray:
    """Sum of each row, shape [env_count]."""
    return values.numpy().sum(axis=1)


def sum_lists(values: wp.array, counts: wp.array) -> np.ndarray:
    """Sum of the first ``counts[env]`` entries of each row, shape [env_count]."""
    rows = values.numpy()
    return np.array([row[:count].sum() for row, count in zip(rows, counts.numpy(), strict=True)])


def dot_rows(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar product of each row of [row, ...], shape [row], bitwise the same however many rows."""
    product = np.ascontiguousarray(a * b)
    return product.reshape(len(product), math.prod(product.shape[1:])).sum(axis=1)
