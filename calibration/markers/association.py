# SPDX-License-Identifier: Apache-2.0
"""Which dot of a frame is which marker: the assignment that moves neighbours alike.

Each marker is expected where its own motion and its neighbours' put it; expected and found places
are matched at least total squared distance, leaving markers and blobs over where nothing fits.
Neighbours' matches then correct the expectations, and all is matched again, until nothing changes:
a dot that jumped to the place of another one disagrees with the dots around it.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from taccel_lab.calibration.markers.neighbourhood import Neighbourhood

_WIDE, _NARROW = 0.55, 0.35
"""Gates in pitches: for a marker's own guess, and the narrowest for what its neighbours say."""
_GATE_SIGMAS = 3.0
"""Neighbours that scatter are believed within so many times their scatter, between these gates."""
_ROUNDS = 6
_SUPPORT = 1.2
"""Weight of matched neighbours from which on they are believed."""
_ODD = 0.3
"""What an odd blob costs, in squared gates."""


def associate(
    expected: np.ndarray,
    before: np.ndarray,
    found: np.ndarray,
    odd: np.ndarray,
    around: Neighbourhood,
) -> np.ndarray:
    """Blob of each marker.

    Args:
        expected: Where each marker's own motion puts it, shape [marker, 2].
        before: Where it was, shape [marker, 2].
        found: Blobs of the frame, shape [blob, 2].
        odd: Blobs that are perhaps no dots, bool, shape [blob].
        around: Who is next to whom.

    Returns:
        Index into ``found``, -1 for none, int, shape [marker].
    """
    gate = np.full(len(expected), _WIDE * around.pitch_px)
    chosen = _assign(expected, found, odd, gate)
    for _ in range(_ROUNDS):
        matched = chosen >= 0
        if matched.sum() < 3:
            break
        moved = np.where(matched[:, None], found[chosen] - before, 0.0)
        said, scatter, support = around.extrapolate(moved, matched)
        trusted = (support >= _SUPPORT) & np.isfinite(said).all(axis=1)
        guess = np.where(trusted[:, None], before + said, expected)
        narrow, wide = _NARROW * around.pitch_px, _WIDE * around.pitch_px
        gate = np.where(trusted, np.clip(_GATE_SIGMAS * scatter, narrow, wide), wide)
        again = _assign(guess, found, odd, gate)
        if (again == chosen).all():
            break
        chosen = again
    return chosen


def _assign(
    expected: np.ndarray, found: np.ndarray, odd: np.ndarray, gate: np.ndarray
) -> np.ndarray:
    """Least-cost assignment; staying alone costs a gate's square."""
    chosen = np.full(len(expected), -1)
    if len(found) == 0:
        return chosen
    distance2 = ((expected[:, None] - found[None]) ** 2).sum(axis=2)
    cost = distance2 / gate[:, None] ** 2 + _ODD * odd[None]
    cost = np.where(np.isfinite(cost), np.minimum(cost, 1e3), 1e3)
    alone = np.full((len(expected), len(expected)), 1e3)
    np.fill_diagonal(alone, 1.0)
    rows, columns = linear_sum_assignment(np.concatenate([cost, alone], axis=1))
    real = (columns < len(found)) & (cost[rows, np.minimum(columns, len(found) - 1)] < 1.0)
    chosen[rows[real]] = columns[real]
    return chosen
