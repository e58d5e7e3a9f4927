# SPDX-License-Identifier: Apache-2.0
"""Which blob is which marker: the gate follows the neighbours' scatter, in any unit of length."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.calibration.markers.association import associate
from taccel_lab.calibration.markers.neighbourhood import Neighbourhood

REST = np.stack(np.meshgrid(np.arange(9.0), np.arange(9.0)), axis=-1).reshape(-1, 2)
"""A square grid of pitch 1."""
MIDDLE = 40


def assigned(offset: float, scatter: float, pitch_px: float) -> np.ndarray:
    """Blobs of markers that moved by 1.3 pitches and, in turns, a little more or less than their
    neighbours (``scatter`` [pitches], along an axis); the middle one by ``offset`` pitches more."""
    turns = 1 - 2 * (REST % 2)
    moved = np.array([1.3, 0.4]) + scatter * turns
    moved[MIDDLE] = (1.3 + offset, 0.4)
    found = pitch_px * (REST + moved)
    expected = pitch_px * (REST + (1.3, 0.4))
    odd = np.zeros(len(found), dtype=bool)
    return associate(expected, pitch_px * REST, found, odd, Neighbourhood.of(pitch_px * REST))


def test_the_gate_widens_where_neighbours_scatter() -> None:
    # Where neighbours move alike, a blob 0.42 pitches off what they say is no dot of this marker;
    # where they scatter by half as much themselves, it is.
    assert assigned(0.42, 0.01, 30.0)[MIDDLE] == -1
    assert assigned(0.42, 0.18, 30.0)[MIDDLE] == MIDDLE
    # However much they scatter, a blob beyond 0.55 pitches is nearer to another marker.
    assert assigned(0.6, 0.18, 30.0)[MIDDLE] == -1


@pytest.mark.parametrize("scatter", [0.01, 0.1, 0.18])
def test_the_unit_of_length_has_no_effect(scatter: float) -> None:
    for offset in (0.3, 0.42, 0.5):
        fine, coarse = assigned(offset, scatter, 30.0), assigned(offset, scatter, 0.5)
        assert (fine == coarse).all()
