# SPDX-License-Identifier: Apache-2.0
"""Projection to positive semidefinite against numpy's eigenvalues."""

from __future__ import annotations

import numpy as np
import pytest

from tests.ipc import batch
from tests.ipc.batch import Array

SIZE = 5


def symmetric(kind: str, count: int) -> Array:
    size = SIZE
    rng = np.random.default_rng(size)
    q = np.linalg.qr(rng.normal(size=(count, size, size)))[0]
    values = {
        "random": rng.normal(size=(count, size)),
        "repeated": rng.choice([-1.0, 1.0], size=(count, size)),
        "graded": 10.0 ** rng.uniform(-12, 12, (count, size)) * rng.choice([-1, 1], (count, size)),
        "positive": rng.uniform(0.1, 1.0, size=(count, size)),
        "negative": -rng.uniform(0.1, 1.0, size=(count, size)),
        "low rank": np.where(np.arange(size) < 1, rng.normal(size=(count, 1)), 0.0),
        "zero": np.zeros((count, size)),
    }[kind]
    matrix = (q * values[:, None, :]) @ q.transpose(0, 2, 1)
    return (matrix + matrix.transpose(0, 2, 1)) / 2


@pytest.mark.parametrize(
    "kind", ["random", "repeated", "graded", "positive", "negative", "low rank", "zero"]
)
def test_projection(kind: str) -> None:
    matrix = symmetric(kind, 200)
    ours = batch.project(matrix)
    values, vectors = np.linalg.eigh(matrix)
    expected = (vectors * np.maximum(values, 0.0)[:, None, :]) @ vectors.transpose(0, 2, 1)
    scale = np.abs(matrix).max(axis=(1, 2), keepdims=True) + 1e-300
    assert np.abs((ours - expected) / scale).max() < 1e-13
    np.testing.assert_array_equal(ours, ours.transpose(0, 2, 1))
    if kind == "positive":
        np.testing.assert_array_equal(ours, matrix)
    if kind == "random":
        assert np.abs(ours - matrix).max() > 0.1


def test_diagonal_matrices_are_exact() -> None:
    matrix = np.diag([3.0, -2.0, 0.0, 1e-300, -1e300])[None]
    np.testing.assert_array_equal(batch.project(matrix), np.maximum(matrix, 0.0))
