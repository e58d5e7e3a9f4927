# SPDX-License-Identifier: Apache-2.0
"""Lattice indices under bending, missing points and strangers."""

from __future__ import annotations

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from taccel_lab.calibration.camera.dot_board import MIN_SHARE
from taccel_lab.calibration.dots.board_lattice import board_lattice
from tests.calibration.drawn.boards import lattice_points

COLUMNS, ROWS = 9, 7


def bent(index: np.ndarray, angle: float, bend: float) -> np.ndarray:
    """Lattice sites in the image: turned, and pincushion-distorted by ``bend`` at the corners."""
    xy = (index - [(COLUMNS - 1) / 2, (ROWS - 1) / 2]) * 40.0
    xy = xy * (1 + bend * np.sum(xy**2, axis=1, keepdims=True) / 200.0**2)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return xy @ turn.T + [320, 240]


@settings(max_examples=25, deadline=None)
@example(angle=0.0, bend=0.0, seed=739)  # The first seed steps to a knight's place.
@given(angle=st.floats(-3.1, 3.1), bend=st.floats(-0.15, 0.45), seed=st.integers(0, 1000))
def test_every_point_gets_its_neighbours_index(angle: float, bend: float, seed: int) -> None:
    """A third of the points is missing and a tenth is dirt; indices differ as the sites do."""
    rng = np.random.default_rng(seed)
    sites = lattice_points(COLUMNS, ROWS)
    kept = rng.permutation(len(sites))[: 2 * len(sites) // 3]
    uv = bent(sites[kept], angle, bend) + rng.normal(0, 0.3, (len(kept), 2))
    dirt = rng.uniform(60, 580, (6, 2))
    found = board_lattice(np.vstack([uv, dirt]), COLUMNS, ROWS)
    assert found is not None
    real = found.points < len(kept)
    assert real.sum() >= 0.85 * len(kept)
    truth, got = sites[kept][found.points[real]], found.index[real]
    # The same lattice up to turns and flips: an integer isometry plus a shift.
    design = np.column_stack([truth, np.ones(len(truth))])
    change, *_ = np.linalg.lstsq(design, got, rcond=None)
    np.testing.assert_allclose(change, np.rint(change), atol=1e-8)
    assert abs(round(np.linalg.det(change[:2]))) == 1


def test_a_line_beyond_the_board_is_told_from_dirt() -> None:
    sites = lattice_points(COLUMNS + 1, ROWS)
    found = board_lattice(bent(sites, 0.1, 0.0), COLUMNS, ROWS)
    assert found is not None and found.strangers == ROWS
    dirt = np.vstack([bent(lattice_points(COLUMNS, ROWS), 0.1, 0.0), [[322.0, 445.0]]])
    found = board_lattice(dirt, COLUMNS, ROWS)
    assert found is not None and found.strangers == 0 and len(found.points) >= COLUMNS * ROWS


def test_no_lattice_among_random_points() -> None:
    """What random points hold is too few of a board, or too crooked, for any detector."""
    for seed in range(20):
        points = np.random.default_rng(seed).uniform(0, 600, (40, 2))
        found = board_lattice(points, COLUMNS, ROWS)
        assert found is None or len(found.points) < MIN_SHARE * COLUMNS * ROWS
    assert board_lattice(np.zeros((3, 2)), 3, 3) is None
