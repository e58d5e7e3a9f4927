# SPDX-License-Identifier: Apache-2.0
"""What a seed draws."""

from __future__ import annotations

import numpy as np


def draw(seed: int, half_ranges: dict[str, float]) -> dict[str, float]:
    """Offsets of a seed, each evenly from minus to plus its half range, in the order given: the
    same whatever other seeds run beside it."""
    generator = np.random.default_rng(seed)
    return {name: float(generator.uniform(-half, half)) for name, half in half_ranges.items()}
