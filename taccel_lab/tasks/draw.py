# SPDX-License-Identifier: Apache-2.0
"""What a seed draws."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np


def draws(seed: int, half_ranges: dict[str, float]) -> Iterator[dict[str, float]]:
    """Offsets of a seed, each evenly from minus to plus its half range, in the order given, again
    and again: the same whatever other seeds run beside it."""
    generator = np.random.default_rng(seed)
    while True:
        yield {name: float(generator.uniform(-half, half)) for name, half in half_ranges.items()}


def draw(seed: int, half_ranges: dict[str, float]) -> dict[str, float]:
    """The first offsets of a seed."""
    return next(draws(seed, half_ranges))
