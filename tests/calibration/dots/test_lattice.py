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
from taccel_lab.calibration.dots.lattice import fit_layout, lattice_index, renumbered
from taccel_lab.errors import InputError
from taccel_lab.profile.optical_design import MarkerGrid
from tests.calibration.drawn.boards import lattice_points
from tests.calibration.drawn.dot_grids import grid_points


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


def one_shift(found: np.ndarray, true: np.ndarray) -> bool:
    return len(np.unique(found - true)) == 1


@settings(max_examples=15, deadline=None)
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
    seed=st.integers(0, 10_000),
)
def test_rectangular_lattices_are_numbered(
    rows: int,
    columns: int,
    ratio: float,
    barrel: float,
    tilt: float,
    skew: float,
    turn: float,
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    reach = 0.5 * max(columns - 1, (rows - 1) * ratio) * min(ratio, 1 / ratio**2)
    straight = grid_points(rows, columns, (30.0, 30.0 * ratio))
    points = bent(straight, barrel * reach, tilt * reach, skew, turn)
    points += rng.normal(0, 0.5, points.shape)
    keep = np.ones(len(points), dtype=bool)
    keep[rng.permutation(len(points))[: int(0.12 * len(points))]] = False
    astray = rng.uniform(points.min(axis=0), points.max(axis=0), (3, 2))
    # What lies on a place of the lattice is no stray.
    astray = astray[KDTree(points).query(astray)[0] > 0.35 * 30.0 * min(1.0, ratio)]
    order = rng.permutation(keep.sum() + len(astray))
    lattice = lattice_index(np.concatenate([points[keep], astray])[order])
    back = np.argsort(order)[: keep.sum()]
    row, column = lattice.row[back], lattice.column[back]
    true_row, true_column = (n.ravel()[keep] for n in np.mgrid[:rows, :columns])
    numbered = row >= 0
    assert lattice.kind == "rectangular"
    assert numbered.mean() > 0.9
    assert one_shift(row[numbered], true_row[numbered])
    assert one_shift(column[numbered], true_column[numbered])


@settings(max_examples=15, deadline=None)
@given(
    turn=st.floats(-0.4, 0.4),
    barrel=st.floats(-0.05, 0.08),
    stagger=st.sampled_from([0.5, -0.5]),
    seed=st.integers(0, 10_000),
)
def test_hexagonal_lattices_are_numbered(
    turn: float, barrel: float, stagger: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    straight = grid_points(8, 10, (30.0, 30.0 * np.sqrt(0.75)), stagger=stagger)
    points = bent(straight, barrel, 0.05, 0.0, turn) + rng.normal(0, 0.4, straight.shape)
    keep = rng.random(len(points)) > 0.08
    order = rng.permutation(keep.sum())
    lattice = lattice_index(points[keep][order])
    assert lattice.kind == "hexagonal"
    assert lattice.numbered.mean() > 0.9
    numbered = np.flatnonzero(lattice.numbered)
    # Numbers are right when steps and straight points are one affine map of each other.
    steps = np.column_stack([lattice.steps()[numbered], np.ones(len(numbered))])
    target = straight[keep][order][numbered]
    miss = target - steps @ np.linalg.lstsq(steps, target, rcond=None)[0]
    assert np.abs(miss).max() < 1e-6


@pytest.mark.thorough
def test_scattered_points_are_no_lattice() -> None:
    """Chance lines up half of a few points now and then: in 15 of 4,000 sets, so 2 of 25 are
    already many."""
    taken = 0
    for seed in range(25):
        rng = np.random.default_rng(seed)
        points = rng.uniform(0, 300, (int(rng.integers(0, 150)), 2))
        lattice = lattice_index(points)
        taken += lattice.kind != "none"
        assert lattice.kind != "none" or not lattice.numbered.any()
        assert ((lattice.row == -1) == (lattice.column == -1)).all()
    assert taken <= 1


def test_rows_run_right_and_down_from_zero() -> None:
    points = grid_points(3, 4)
    lattice = lattice_index(points[::-1])
    np.testing.assert_array_equal(lattice.row[::-1].reshape(3, 4)[:, 0], [0, 1, 2])
    np.testing.assert_array_equal(lattice.column[::-1].reshape(3, 4)[0], [0, 1, 2, 3])
    assert fit_layout(points[::-1], lattice).pitch == pytest.approx((30, 29), abs=1e-9)


@pytest.mark.parametrize("where", [(0.5, 0.5), (1.5, 0.5), (-0.5, 1.5)])
def test_a_stray_point_amid_four_makes_no_finer_lattice(where: tuple[float, float]) -> None:
    """Once in ten draws the lattice through the cells' centres explained more points."""
    stray = grid_points(1, 1) + 30.0 * np.array(where)
    for seed in range(15):
        rng = np.random.default_rng(seed)
        points = grid_points(5, 5, (30.0, 30.0))
        points += rng.normal(0, 0.5, points.shape)
        points = np.delete(points, rng.permutation(len(points))[:3], axis=0)
        points = np.concatenate([points, stray])
        lattice = lattice_index(points)
        assert lattice.kind == "rectangular"
        assert lattice.row[-1] == -1
        assert lattice.numbered.sum() == len(points) - 1
        assert min(fit_layout(points, lattice).pitch) > 28


def test_a_whole_missing_column_leaves_a_gap() -> None:
    keep = np.tile(np.arange(9) != 4, 7)
    lattice = lattice_index(grid_points()[keep])
    assert lattice.columns == 9
    assert 4 not in lattice.column


def test_part_of_a_lattice_is_counted_from_its_own_corner() -> None:
    points = grid_points(6, 5, (30.0, 26.0), stagger=0.5)
    lattice = lattice_index(points)
    part, first = renumbered(lattice, lattice.row >= 1)
    assert first == (1, 0)
    assert part.rows == 5
    steps = np.column_stack([part.steps(), np.ones(len(points))])[part.numbered]
    target = points[part.numbered]
    assert np.abs(target - steps @ np.linalg.lstsq(steps, target, rcond=None)[0]).max() < 1e-9


def test_bad_points_are_refused() -> None:
    with pytest.raises(InputError, match=r"shape \[point, 2\]"):
        lattice_index(np.zeros((4, 3)))
    with pytest.raises(InputError, match="finite"):
        lattice_index(np.full((9, 2), np.nan))


@settings(max_examples=15, deadline=None)
@given(
    turn=st.floats(-0.7, 0.7),
    stagger=st.sampled_from([0.0, 0.5]),
    ratio=st.floats(0.75, 0.95),
    seed=st.integers(0, 10_000),
)
def test_a_layout_gives_back_the_marker_grid(
    turn: float, stagger: float, ratio: float, seed: int
) -> None:
    """From the profile's own points, without noise, to the last digit."""
    rng = np.random.default_rng(seed)
    ratio = np.sqrt(0.75) if stagger else ratio
    places = [(r, c) for r in range(1, 6) for c in range(1, 7)]
    missing = tuple(sorted(places[n] for n in rng.choice(len(places), 3, replace=False)))
    if stagger:
        turn = 0.4 * turn  # six directions look alike beyond 30 degrees
    grid = MarkerGrid(
        7, 8, 2.0, 2.0 * ratio, 0.3, (0.4, -0.7), float(np.degrees(turn)), stagger, missing
    )
    points = grid.points_mm()
    lattice = lattice_index(points)
    layout = fit_layout(points, lattice)
    np.testing.assert_allclose(layout.pitch, (2.0, 2.0 * ratio), rtol=1e-9)
    np.testing.assert_allclose(layout.rotation_deg, np.degrees(turn), atol=1e-7)
    np.testing.assert_allclose(layout.centre, (0.4, -0.7), atol=1e-9)
    assert layout.missing == missing
    assert layout.stagger == stagger
    assert layout.residual_rms < 1e-9
    back = layout.place(lattice.row, lattice.column)
    np.testing.assert_allclose(back, points, atol=1e-9)


@pytest.mark.thorough
def test_layout_sigmas_hold() -> None:
    rng = np.random.default_rng(3)
    true = grid_points(8, 9, (30.0, 28.0), turn_rad=0.1)
    lattice = lattice_index(true)
    z = []
    for _ in range(120):
        fit = fit_layout(true + rng.normal(0, 0.1, true.shape), lattice)
        truth = np.array([30.0, 28.0, 0.1, 159.3, 119.8])
        z.append((fit.parameters - truth) / np.sqrt(np.diag(fit.covariance)))
    rms = np.sqrt((np.array(z) ** 2).mean(axis=0))
    # The larger of two covariances: somewhat wide, never narrow.
    assert (rms < 1.1).all()
    assert (rms > 0.6).all()


@pytest.mark.filterwarnings("error")
def test_dots_that_fit_exactly_leave_no_doubt() -> None:
    points = np.stack(np.meshgrid(20.0 * np.arange(5), 20.0 * np.arange(4)), -1).reshape(-1, 2)
    fit = fit_layout(points, lattice_index(points))
    assert fit.parameters == pytest.approx([20, 20, 0, 40, 30], abs=1e-9)
    assert np.isfinite(fit.covariance).all()
    assert [fit.sigma(k) for k in range(5)] == pytest.approx([0.0] * 5, abs=1e-9)


def test_a_few_points_far_off_bend_no_layout() -> None:
    true = grid_points()
    moved = true.copy()
    moved[[5, 33]] += (4.0, -3.0)
    lattice = lattice_index(true)
    fit = fit_layout(moved, lattice)
    assert fit.pitch == pytest.approx((30.0, 29.0), abs=0.02)
    assert not fit.inlier[[5, 33]].any()
    assert fit.inlier.sum() == len(true) - 2


def test_too_few_points_have_no_layout() -> None:
    line = lattice_index(np.zeros((0, 2)))
    with pytest.raises(InputError, match="at least 4 numbered dots"):
        fit_layout(np.zeros((0, 2)), line)


COLUMNS, ROWS = 9, 7


def bent_board(index: np.ndarray, angle: float, bend: float) -> np.ndarray:
    """Lattice sites in the image: turned, and pincushion-distorted by ``bend`` at the corners."""
    xy = (index - [(COLUMNS - 1) / 2, (ROWS - 1) / 2]) * 40.0
    xy = xy * (1 + bend * np.sum(xy**2, axis=1, keepdims=True) / 200.0**2)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return xy @ turn.T + [320, 240]


@pytest.mark.thorough
@settings(max_examples=8, deadline=None)
@example(angle=0.0, bend=0.0, seed=739)  # The first seed steps to a knight's place.
@given(angle=st.floats(-3.1, 3.1), bend=st.floats(-0.15, 0.45), seed=st.integers(0, 1000))
def test_every_point_gets_its_neighbours_index(angle: float, bend: float, seed: int) -> None:
    """A third of the points is missing and a tenth is dirt; indices differ as the sites do."""
    rng = np.random.default_rng(seed)
    sites = lattice_points(COLUMNS, ROWS)
    kept = rng.permutation(len(sites))[: 2 * len(sites) // 3]
    uv = bent_board(sites[kept], angle, bend) + rng.normal(0, 0.3, (len(kept), 2))
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
    found = board_lattice(bent_board(sites, 0.1, 0.0), COLUMNS, ROWS)
    assert found is not None and found.strangers == ROWS
    dirt = np.vstack([bent_board(lattice_points(COLUMNS, ROWS), 0.1, 0.0), [[322.0, 445.0]]])
    found = board_lattice(dirt, COLUMNS, ROWS)
    assert found is not None and found.strangers == 0 and len(found.points) >= COLUMNS * ROWS


@pytest.mark.thorough
def test_no_lattice_among_random_points() -> None:
    """What random points hold is too few of a board, or too crooked, for any detector."""
    for seed in range(20):
        points = np.random.default_rng(seed).uniform(0, 600, (40, 2))
        found = board_lattice(points, COLUMNS, ROWS)
        assert found is None or len(found.points) < MIN_SHARE * COLUMNS * ROWS
    assert board_lattice(np.zeros((3, 2)), 3, 3) is None
