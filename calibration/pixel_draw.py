# SPDX-License-Identifier: Apache-2.0
"""Pixels of a press that a network is trained with: as many of each region around the contact."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from taccel_lab.errors import InputError


def draw_regions(
    name: str, regions: Sequence[tuple[np.ndarray, int]], rng: np.random.Generator
) -> list[np.ndarray]:
    """Indices of pixels drawn from each region, counted along its rows.

    Args:
        name: Of the press, for the refusal.
        regions: Where pixels may be drawn, bool, shape [height_px, width_px], and how many at most;
            the contact itself first.
        rng: Draws without replacement.

    Raises:
        InputError: No pixel of the contact may be drawn.
    """
    if not regions[0][0].any():
        raise InputError(f"{name}: every pixel of the contact is masked")
    return [rng.permutation(np.flatnonzero(region))[:count] for region, count in regions]
