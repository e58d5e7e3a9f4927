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
from scipy.spatial import KDTree

from taccel_lab.calibration.dots.lattice import lattice_index
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


def disagreement(
    chosen: np.ndarray, before: np.ndarray, found: np.ndarray, around: Neighbourhood
) -> float:
    """How badly an assignment moves neighbours alike, in markers: one for each marker without a
    blob, up to one for each that moves otherwise than its neighbours by half a pitch."""
    matched = chosen >= 0
    if matched.sum() < 3:
        return float(len(chosen))
    moved = np.where(matched[:, None], found[chosen] - before, 0.0)
    said, _, _ = around.extrapolate(moved, matched)
    miss = np.linalg.norm(moved - said, axis=1) / (0.5 * around.pitch_px)
    return float((~matched).sum() + np.minimum(np.nan_to_num(miss[matched], nan=1.0), 1.0).sum())


def by_lattice(
    expected: np.ndarray,
    row: np.ndarray,
    column: np.ndarray,
    found: np.ndarray,
    pitch_px: float,
) -> np.ndarray | None:
    """Where the frame's own lattice puts the markers, however far they moved since the last frame.

    The blobs are numbered among themselves; blobs that lie where a marker is expected vote for how
    the two numberings are shifted. Neighbours that moved half a pitch more or less than each other
    break a matching by distance, but not a numbering.

    Args:
        expected: Where each marker's own motion puts it, shape [marker, 2].
        row: Row of each marker, -1 for none, shape [marker].
        column: Column of each marker, shape [marker].
        found: Blobs of the frame, shape [blob, 2].
        pitch_px: Distance of neighbours.

    Returns:
        Places, shape [marker, 2], NaN for markers without a blob; None where the blobs form no
        lattice or nobody votes.
    """
    lattice = lattice_index(found)
    if lattice.kind != "rectangular":
        return None
    numbered = np.flatnonzero(lattice.numbered)
    distance, nearest = map(np.asarray, KDTree(expected).query(found[numbered]))
    votes = (distance < 0.3 * pitch_px) & (row[nearest] >= 0)
    if not votes.any():
        return None
    shifts = np.stack(
        [
            row[nearest[votes]] - lattice.row[numbered[votes]],
            column[nearest[votes]] - lattice.column[numbered[votes]],
        ],
        axis=1,
    )
    names, counts = np.unique(shifts, axis=0, return_counts=True)
    shift = names[np.argmax(counts)]
    blob_at = {
        (int(lattice.row[n] + shift[0]), int(lattice.column[n] + shift[1])): n for n in numbered
    }
    places = np.full(expected.shape, np.nan)
    for marker, place in enumerate(zip(row.tolist(), column.tolist(), strict=True)):
        if place in blob_at and place[0] >= 0:
            places[marker] = found[blob_at[place]]
    return places


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
