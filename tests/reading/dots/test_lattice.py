# SPDX-License-Identifier: Apache-2.0
"""Numbers of lattices and boards: any order, turn and distortion, points missing and astray."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree

from taccel_lab.calibration.camera.board import board_lattice
from taccel_lab.calibration.camera.find_boards import MIN_SHARE
from taccel_lab.errors import InputError
from taccel_lab.profile.optical_design import MarkerGrid
from taccel_lab.reading.dots.lattice import fit_layout, lattice_index, renumbered
from tests.calibration.drawn.boards import lattice_points
from tests.calibration.drawn.dots import grid_points

COLUMNS, ROWS = 9, 7
SEEDS = st.integers(0, 10_000)


def bent(points: np.ndarray, barrel: float, tilt: float, skew: float, turn: float) -> np.ndarray:
    """Barrel (share of the corner's distance), perspective, skew and rotation about the middle."""
    middle = points.mean(axis=0)
    reach = np.abs(points - middle).max()
    x = (points - middle) / reach
    x = x * (1 - barrel * (x**2).sum(axis=1, keepdims=True))
    x = x / (1 + tilt * x[:, :1])
    x = x + np.stack([skew * x[:, 1], 0 * x[:, 1]], axis=1)
    c, s = np.cos(turn), np.sin(turn)
    return reach * x @ np.array([[c, s], [-s, c]]) + middle


def affine(of: np.ndarray, to: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The affine map between points that fits best [3, 2], and what it misses by."""
    design = np.column_stack([of, np.ones(len(of))])
    change = np.linalg.lstsq(design, to, rcond=None)[0]
    return change, np.abs(design @ change - to)


@settings(max_examples=15)
@given(
    rows=st.integers(5, 12),
    columns=st.integers(5, 14),
    ratio=st.floats(0.7, 1.4),
    # Per pitch: what numbering by neighbours feels is how much one step differs from the next,
    # and a lattice of few points would need a fisheye for the same share of its corner.
    barrel=st.floats(-0.011, 0.016),
    tilt=st.floats(-0.016, 0.016),
    skew=st.floats(-0.1, 0.1),
    turn=st.floats(-0.6, 0.6),
    seed=SEEDS,
)
def test_rectangular_lattices_are_numbered(
    rows, columns, ratio, barrel, tilt, skew, turn, seed
) -> None:
    rng = np.random.default_rng(seed)
    reach = 0.5 * max(columns - 1, (rows - 1) * ratio) * min(ratio, 1 / ratio**2)
    straight = grid_points(rows, columns, (30.0, 30.0 * ratio))
    points = bent(straight, barrel * reach, tilt * reach, skew, turn)
    points += rng.normal(0, 0.5, points.shape)
    kept = np.sort(rng.permutation(len(points))[int(0.12 * len(points)) :])
    astray = rng.uniform(points.min(axis=0), points.max(axis=0), (3, 2))
    # What lies on a place of the lattice is no stray.
    astray = astray[KDTree(points).query(astray)[0] > 0.35 * 30.0 * min(1.0, ratio)]
    order = rng.permutation(len(kept) + len(astray))
    lattice = lattice_index(np.concatenate([points[kept], astray])[order])
    back = np.argsort(order)[: len(kept)]
    numbered = lattice.row[back] >= 0
    assert lattice.kind == "rectangular" and numbered.mean() > 0.9
    places = np.divmod(kept[numbered], columns)
    for found, true in zip((lattice.row[back], lattice.column[back]), places, strict=True):
        assert np.ptp(found[numbered] - true) == 0


@settings(max_examples=15)
@given(
    turn=st.floats(-0.4, 0.4),
    barrel=st.floats(-0.05, 0.08),
    stagger=st.sampled_from([0.5, -0.5]),
    seed=SEEDS,
)
def test_hexagonal_lattices_are_numbered(turn, barrel, stagger: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    straight = grid_points(8, 10, (30.0, 30.0 * np.sqrt(0.75)), stagger=stagger)
    points = bent(straight, barrel, 0.05, 0.0, turn) + rng.normal(0, 0.4, straight.shape)
    order = rng.permutation(np.flatnonzero(rng.random(len(points)) > 0.08))
    lattice = lattice_index(points[order])
    assert lattice.kind == "hexagonal" and lattice.numbered.mean() > 0.9
    # Numbers are right when steps and straight points are one affine map of each other.
    numbered = lattice.numbered
    assert affine(lattice.steps()[numbered], straight[order][numbered])[1].max() < 1e-6


@pytest.mark.thorough
def test_scattered_points_are_no_lattice() -> None:
    """Chance lines up half of a few points in 15 of 4,000 sets, so 2 of 25 are already many."""
    taken = 0
    for seed in range(25):
        rng = np.random.default_rng(seed)
        lattice = lattice_index(rng.uniform(0, 300, (int(rng.integers(0, 150)), 2)))
        taken += lattice.kind != "none"
        assert lattice.kind != "none" or not lattice.numbered.any()
        assert ((lattice.row == -1) == (lattice.column == -1)).all()
    assert taken <= 1
    # What random points hold is too few of a board, or too crooked, for any detector.
    for seed in range(20):
        board = board_lattice(np.random.default_rng(seed).uniform(0, 600, (40, 2)), COLUMNS, ROWS)
        assert board is None or len(board.points) < MIN_SHARE * COLUMNS * ROWS
    assert board_lattice(np.zeros((3, 2)), 3, 3) is None


def test_rows_run_right_and_down_from_zero() -> None:
    points = grid_points(3, 4)[::-1]
    lattice = lattice_index(points)
    rows, columns = np.mgrid[:3, :4]
    np.testing.assert_array_equal(lattice.row[::-1], rows.ravel())
    np.testing.assert_array_equal(lattice.column[::-1], columns.ravel())
    assert fit_layout(points, lattice).pitch == pytest.approx((30, 29), abs=1e-9)
    # A column that is missing as a whole leaves a gap.
    gap = lattice_index(grid_points()[np.tile(np.arange(9) != 4, 7)])
    assert gap.columns == 9 and 4 not in gap.column
    # Part of a lattice is counted from its corner.
    points = grid_points(6, 5, (30.0, 26.0), stagger=0.5)
    lattice = lattice_index(points)
    part, first = renumbered(lattice, lattice.row >= 1)
    assert first == (1, 0) and part.rows == 5
    assert affine(part.steps()[part.numbered], points[part.numbered])[1].max() < 1e-9


@pytest.mark.parametrize("where", [(0.5, 0.5), (1.5, 0.5), (-0.5, 1.5)])
def test_a_stray_point_amid_four_makes_no_finer_lattice(where: tuple[float, float]) -> None:
    """Once in ten draws the lattice through the cells' centres explained more points."""
    stray = grid_points(1, 1) + 30.0 * np.array(where)
    for seed in range(15):
        rng = np.random.default_rng(seed)
        points = grid_points(5, 5, (30.0, 30.0))
        points += rng.normal(0, 0.5, points.shape)
        points = np.concatenate([np.delete(points, rng.permutation(25)[:3], axis=0), stray])
        lattice = lattice_index(points)
        assert lattice.kind == "rectangular" and lattice.row[-1] == -1
        assert lattice.numbered.sum() == len(points) - 1
        assert min(fit_layout(points, lattice).pitch) > 28


@pytest.mark.parametrize(
    ("points", "said"),
    [
        (np.zeros((4, 3)), r"shape \[point, 2\]"),
        (np.full((9, 2), np.nan), "finite"),
        (np.zeros((0, 2)), "at least 4 numbered dots"),
    ],
)
def test_bad_points_and_too_few_for_a_layout_are_refused(points: np.ndarray, said: str) -> None:
    with pytest.raises(InputError, match=said):
        fit_layout(points, lattice_index(points))


@settings(max_examples=15)
@given(
    turn=st.floats(-0.7, 0.7),
    stagger=st.sampled_from([0.0, 0.5]),
    ratio=st.floats(0.75, 0.95),
    seed=SEEDS,
)
def test_a_layout_gives_back_the_marker_grid(turn, stagger: float, ratio, seed: int) -> None:
    """From the profile's own points, without noise, to the last digit."""
    rng = np.random.default_rng(seed)
    places = [(r, c) for r in range(1, 6) for c in range(1, 7)]
    missing = tuple(sorted(places[n] for n in rng.choice(len(places), 3, replace=False)))
    if stagger:
        turn, ratio = 0.4 * turn, np.sqrt(0.75)  # six directions look alike beyond 30 degrees
    turn_deg = float(np.degrees(turn))
    points = MarkerGrid(
        7, 8, 2.0, 2.0 * ratio, 0.3, (0.4, -0.7), turn_deg, stagger, missing
    ).points_mm()
    lattice = lattice_index(points)
    layout = fit_layout(points, lattice)
    np.testing.assert_allclose(layout.pitch, (2.0, 2.0 * ratio), rtol=1e-9)
    np.testing.assert_allclose(layout.rotation_deg, turn_deg, atol=1e-7)
    np.testing.assert_allclose(layout.centre, (0.4, -0.7), atol=1e-9)
    assert (layout.missing, layout.stagger) == (missing, stagger)
    assert layout.residual_rms < 1e-9
    np.testing.assert_allclose(layout.place(lattice.row, lattice.column), points, atol=1e-9)


@pytest.mark.thorough
def test_layout_sigmas_hold() -> None:
    rng, z = np.random.default_rng(3), []
    true = grid_points(8, 9, (30.0, 28.0), turn_rad=0.1)
    lattice = lattice_index(true)
    for _ in range(120):
        fit = fit_layout(true + rng.normal(0, 0.1, true.shape), lattice)
        off = fit.parameters - [30.0, 28.0, 0.1, 159.3, 119.8]
        z.append(off / np.sqrt(np.diag(fit.covariance)))
    rms = np.sqrt((np.array(z) ** 2).mean(axis=0))
    # The larger of two covariances: somewhat wide, never narrow.
    assert (rms < 1.1).all() and (rms > 0.6).all()


@pytest.mark.filterwarnings("error")
def test_dots_that_fit_exactly_leave_no_doubt_and_a_few_far_off_bend_no_layout() -> None:
    points = grid_points(4, 5, (20.0, 20.0), centre=(40.0, 30.0))
    fit = fit_layout(points, lattice_index(points))
    assert fit.parameters == pytest.approx([20, 20, 0, 40, 30], abs=1e-9)
    assert np.isfinite(fit.covariance).all()
    assert [fit.sigma(k) for k in range(5)] == pytest.approx([0.0] * 5, abs=1e-9)
    true = grid_points()
    moved = true.copy()
    moved[[5, 33]] += (4.0, -3.0)
    fit = fit_layout(moved, lattice_index(true))
    assert fit.pitch == pytest.approx((30.0, 29.0), abs=0.02)
    assert np.flatnonzero(~fit.inlier).tolist() == [5, 33]


def bent_board(index: np.ndarray, angle: float, bend: float) -> np.ndarray:
    """Lattice sites in the image: turned, and pincushion-distorted by ``bend`` at the corners."""
    xy = (index - [(COLUMNS - 1) / 2, (ROWS - 1) / 2]) * 40.0
    xy = xy * (1 + bend * np.sum(xy**2, axis=1, keepdims=True) / 200.0**2)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return xy @ turn.T + [320, 240]


@pytest.mark.thorough
@settings(max_examples=8)
@example(angle=0.0, bend=0.0, seed=739)  # The first seed steps to a knight's place.
@given(angle=st.floats(-3.1, 3.1), bend=st.floats(-0.15, 0.45), seed=st.integers(0, 1000))
def test_every_point_gets_its_neighbours_index(angle: float, bend: float, seed: int) -> None:
    """A third of the points is missing and a tenth is dirt; indices differ as the sites do."""
    rng = np.random.default_rng(seed)
    sites = rng.permutation(lattice_points(COLUMNS, ROWS))[: 2 * COLUMNS * ROWS // 3]
    uv = bent_board(sites, angle, bend) + rng.normal(0, 0.3, (len(sites), 2))
    found = board_lattice(np.vstack([uv, rng.uniform(60, 580, (6, 2))]), COLUMNS, ROWS)
    assert found is not None
    real = found.points < len(sites)
    assert real.sum() >= 0.85 * len(sites)
    # The same lattice up to turns and flips: an integer isometry plus a shift.
    change, _ = affine(sites[found.points[real]], found.index[real])
    np.testing.assert_allclose(change, np.rint(change), atol=1e-8)
    assert abs(round(np.linalg.det(change[:2]))) == 1


def test_a_line_beyond_the_board_is_told_from_dirt() -> None:
    beyond = bent_board(lattice_points(COLUMNS + 1, ROWS), 0.1, 0.0)
    dirt = np.vstack([bent_board(lattice_points(COLUMNS, ROWS), 0.1, 0.0), [[322.0, 445.0]]])
    for points, strangers in ((beyond, ROWS), (dirt, 0)):
        found = board_lattice(points, COLUMNS, ROWS)
        assert found is not None and found.strangers == strangers
        assert len(found.points) >= COLUMNS * ROWS
