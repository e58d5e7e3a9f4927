# SPDX-License-Identifier: Apache-2.0
"""Random rotations, and nodes that are turned, stretched and shaken."""

from __future__ import annotations

import numpy as np


def random_turns(seed: int | np.random.Generator, count: int) -> np.ndarray:
    """Rotation matrices, [count, 3, 3]."""
    turns = np.linalg.qr(np.random.default_rng(seed).normal(size=(count, 3, 3)))[0]
    return turns * np.sign(np.linalg.det(turns))[:, None, None]


def strained(
    rest: np.ndarray, seed: int, amount: float, stretch: tuple[float, ...] = (1.1, 0.95, 0.9)
) -> np.ndarray:
    """Nodes [n, 3] stretched along the axes, turned, and moved by up to ``amount`` each."""
    rng = np.random.default_rng(seed)
    turn = random_turns(rng, 1)[0]
    return (rest * stretch) @ turn.T + rng.uniform(-amount, amount, rest.shape)
