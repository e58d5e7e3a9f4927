# SPDX-License-Identifier: Apache-2.0
"""Diagonal blocks whose negative pivots are turned."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from taccel_lab.ipc.linear.problem.turned import turning


@wp.kernel
def _turning_kernel(blocks: wp.array(dtype=wp.mat33d), found: wp.array(dtype=wp.vec3d)):
    i = wp.tid()
    found[i] = turning(blocks[i])


def turned(block: np.ndarray) -> np.ndarray:
    """The block with what turns it, [3, 3]."""
    found = wp.zeros(1, dtype=wp.vec3d, device="cpu")
    blocks = wp.array(block[None], dtype=wp.mat33d, device="cpu")
    wp.launch(_turning_kernel, 1, [blocks, found], device="cpu")
    return block + np.diag(found.numpy()[0])


@pytest.mark.parametrize("block", [np.zeros((3, 3)), np.eye(3), np.diag([0.0, -1.0, 1.0])])
def test_what_has_nothing_to_turn_or_a_pivot_of_zero_stays(block: np.ndarray) -> None:
    np.testing.assert_array_equal(turned(block), block)


@pytest.mark.parametrize("seed", range(5))
def test_an_indefinite_block_becomes_positive_definite(seed: int) -> None:
    draw = np.random.default_rng(seed).normal(size=(3, 3))
    block = draw + draw.T - 2.0 * np.eye(3)
    assert np.linalg.eigvalsh(block)[0] < 0 < np.linalg.eigvalsh(turned(block))[0]
