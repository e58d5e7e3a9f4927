# SPDX-License-Identifier: Apache-2.0
"""All linear methods against dense solves, alone and in batches, and the pattern of the matrix.

What elements add up to is compared with differences in ``potentials``.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.errors import InputError
from taccel_lab.ipc.linear.arrow.elimination import least_degree_order
from taccel_lab.ipc.linear.cpu import RELAXATION
from taccel_lab.ipc.linear.problem.packed_rows import VERIFY_BELOW
from taccel_lab.ipc.linear.problem.scatter import find_block
from taccel_lab.ipc.linear.problem.turned import LEAST_TURNED
from taccel_lab.ipc.linear.system import METHODS
from taccel_lab.model.matrix_pattern import block_pattern, node_gather
from tests.ipc.linear.systems import (
    BACKENDS,
    delaunay_pattern,
    random_spd,
    residuals,
    solve,
    system_of,
    turned,
)

ROUNDED = ("cg", "pipelined")
"""Methods whose products round the matrix, and that know its own residual where they verify it."""
every_backend = pytest.mark.parametrize("backend", BACKENDS)


def test_the_solver_of_the_cpu_is_refused_on_a_gpu() -> None:
    gpu = SimpleNamespace(is_cpu=False, is_cuda=True)
    problem: Any = SimpleNamespace(pattern=None, device=gpu, clusters=[])
    with pytest.raises(InputError, match="ssor is for the CPU; a GPU has arrow, cg and pipelined"):
        METHODS["ssor"](problem)


@every_backend
@given(
    seed=st.integers(0, 2**32 - 1),
    nodes=st.integers(5, 60),
    stiffness=st.floats(1.0, 1e5),
    tolerance=st.floats(1e-8, 1e-2),
)
@settings(max_examples=15)
def test_reaches_the_tolerance_as_true_residual(
    backend: str, seed: int, nodes: int, stiffness: float, tolerance: float
) -> None:
    rng = np.random.default_rng(seed)
    pattern = delaunay_pattern(rng, nodes, bonded=nodes // 5)
    values = random_spd(rng, pattern, stiffness)[None]
    rhs = rng.normal(size=(1, pattern.free_count, 3)) * 10.0 ** rng.uniform(-12, 3)
    system, dense = system_of(pattern, values, rhs, backend), pattern.dense(values)
    report = solve(system, tolerance, most=2000)
    (residual,) = residuals(system, dense)
    rounding = 1e-15 * stiffness
    if backend in ROUNDED and tolerance >= VERIFY_BELOW:
        moved = np.abs(dense[0]) @ np.abs(system.solution.numpy().ravel())
        rounding += 2.0**-24 * np.linalg.norm(moved) / np.linalg.norm(rhs)
    assert residual <= tolerance * (1 + 1e-3) + rounding
    off = 1e-3 * tolerance + rounding
    np.testing.assert_allclose(report.relative_residual, residual, rtol=1e-3, atol=off)
    assert not report.breakdown[0] and report.iterations[0] >= 1


def test_an_environment_never_sees_the_others() -> None:
    rng = np.random.default_rng(3)
    pattern = delaunay_pattern(rng, 60, bonded=10)
    values = np.stack([random_spd(rng, pattern, 10.0**k) for k in range(5)])
    rhs = rng.normal(size=(5, pattern.free_count, 3))
    # One at rest with an indefinite matrix, one that breaks down: neither may leak.
    values[3:] *= -1
    tolerances = np.array([1e-3, 1e-6, 1e-9, 1e-9, 1e-6])
    together = system_of(pattern, values, rhs)
    report = solve(together, tolerances, [1, 1, 1, 0, 1], 2000)
    for env in (0, 1, 2):
        alone = system_of(pattern, values[env : env + 1], rhs[env : env + 1])
        single = solve(alone, tolerances[env], most=2000)
        np.testing.assert_array_equal(alone.solution.numpy()[0], together.solution.numpy()[env])
        assert single.iterations[0] == report.iterations[env]
        assert single.relative_residual[0] == report.relative_residual[env]
    assert len(set(report.iterations[:3])) == 3


@every_backend
def test_resting_environments_and_empty_loads_give_zero(backend: str) -> None:
    rng = np.random.default_rng(4)
    pattern = delaunay_pattern(rng, 30, bonded=5)
    values = np.repeat(random_spd(rng, pattern, 10.0)[None], 3, axis=0)
    dense = pattern.dense(values)
    values[0] = np.nan
    rhs = rng.normal(size=(3, pattern.free_count, 3))
    rhs[1] = 0.0
    system = system_of(pattern, values, rhs, backend)
    report = solve(system, 1e-8, [0, 1, 1], 2000)
    assert (system.solution.numpy()[:2] == 0).all() and (report.relative_residual[:2] == 0).all()
    assert not report.breakdown.any() and report.iterations[0] == 0
    with np.errstate(invalid="ignore"):
        assert residuals(system, dense)[2] <= 1e-8


@every_backend
@pytest.mark.parametrize("trouble", ["indefinite", "nan matrix", "nan load", "infinite load"])
def test_breakdown_is_flagged_where_it_happens(backend: str, trouble: str) -> None:
    rng = np.random.default_rng(5)
    pattern = delaunay_pattern(rng, 30, bonded=5)
    values = np.repeat(random_spd(rng, pattern, 10.0)[None], 2, axis=0)
    rhs = rng.normal(size=(2, pattern.free_count, 3))
    if trouble == "indefinite":
        # Blocks on the diagonal stay positive definite, the matrix does not.
        values[0, np.setdiff1d(np.arange(pattern.block_count), pattern.diagonal)] *= 20.0
    elif trouble == "nan matrix":
        values[0, 7] = np.nan
    else:
        rhs[0, 3] = np.nan if trouble == "nan load" else np.inf
    system = system_of(pattern, values, rhs, backend)
    report = solve(system, 1e-8, most=2000)
    assert report.breakdown.tolist() == [True, False] and np.isfinite(system.solution.numpy()).all()
    assert report.relative_residual[1] <= 1e-8


def turned_in_krylov_space(dense: np.ndarray, inverse: np.ndarray, load: np.ndarray, steps: int):
    """V (L |D| L^T)^-1 V^T b, V^T A V = L D L^T; ``inverse`` preconditions, V spans the space.
    Pivots that were negative are no smaller than a part of that of the preconditioner."""
    space = np.zeros((len(load), 0))
    following = inverse @ load
    for _ in range(steps):
        for _ in range(2):
            following = following - space @ (space.T @ following)
        space = np.column_stack([space, following / np.linalg.norm(following)])
        following = inverse @ dense @ space[:, -1]
    small = space.T @ dense @ space
    lower, pivots = np.eye(steps), np.zeros(steps)
    for k in range(steps):
        pivots[k] = small[k, k]
        lower[k + 1 :, k] = small[k + 1 :, k] / pivots[k]
        small = small - np.outer(lower[:, k], lower[:, k]) * pivots[k]
    assert (pivots < 0).any() and (pivots > 0).any()
    along = space @ np.linalg.inv(lower).T
    least = LEAST_TURNED * np.einsum("ik,ik->k", along, np.linalg.solve(inverse, along))
    return along @ (along.T @ load / np.where(pivots < 0, np.maximum(-pivots, least), pivots))


@pytest.mark.parametrize("place", ["block", "coupling"])
@pytest.mark.parametrize("backend", ["ssor", "cg", "pipelined"])
def test_negative_curvature_is_turned_and_the_solution_descends(backend: str, place: str) -> None:
    """Where a diagonal block is not positive definite, or the matrix alone."""
    rng = np.random.default_rng(8)
    pattern = delaunay_pattern(rng, 20, bonded=5)
    values = random_spd(rng, pattern, 1.0)[None]
    blocks = pattern.diagonal if place == "coupling" else pattern.diagonal[[3]]
    values[0, blocks] -= (0.3 if place == "coupling" else 2.0) * values[0, blocks] * np.eye(3)
    (dense,), load = pattern.dense(values), rng.normal(size=(1, pattern.free_count, 3))
    assert np.linalg.eigvalsh(dense)[0] < 0
    assert (np.linalg.eigvalsh(values[0, pattern.diagonal])[:, 0] < 0).any() == (place == "block")
    system = system_of(pattern, values, load, backend)
    report, b = solve(system, 1e-2), load.ravel()
    assert report.breakdown.all()
    np.testing.assert_array_equal(system.values.numpy(), values)
    # The preconditioner has turned blocks.
    own = np.zeros_like(dense)
    for row, block in enumerate(values[0, pattern.diagonal]):
        at = slice(3 * row, 3 * row + 3)
        own[at, at] = turned(block, np.zeros(1, dtype=int), 1)
    inverse = np.linalg.inv(own)
    if backend == "ssor":
        apart = np.kron(np.tri(pattern.free_count, k=-1), np.ones((3, 3)))
        half = own / RELAXATION + dense * apart
        inverse = np.linalg.inv(half @ inverse @ half.T)
    found = system.solution.numpy().ravel()
    wanted = turned_in_krylov_space(dense, inverse, b, report.iterations[0])
    assert found @ b > 0
    assert np.linalg.norm(found - wanted) < 1e-3 * np.linalg.norm(wanted)
    # No further than coupled nodes lie apart at rest.
    system = system_of(pattern, values, load, backend, 1e-4 * np.eye(pattern.free_count, 3))
    solve(system, 1e-2)
    short = system.solution.numpy().ravel()
    assert 0 < np.linalg.norm(short) <= 1.5e-4 < np.linalg.norm(found)
    np.testing.assert_allclose(
        short / np.linalg.norm(short), found / np.linalg.norm(found), atol=1e-9
    )


@pytest.mark.parametrize("backend", sorted({*BACKENDS} - {"arrow"}))
def test_stops_at_the_iteration_limit_and_says_so(backend: str) -> None:
    rng = np.random.default_rng(6)
    pattern = delaunay_pattern(rng, 60, bonded=10)
    values = random_spd(rng, pattern, 1e6)[None]
    system = system_of(pattern, values, rng.normal(size=(1, pattern.free_count, 3)), backend)
    report = solve(system, 1e-12, most=8)
    assert report.iterations[0] == 8 and report.relative_residual[0] > 1e-12
    found, known = residuals(system, pattern.dense(values)), 1e-5 if backend in ROUNDED else 1e-9
    np.testing.assert_allclose(report.relative_residual, found, rtol=known)


def test_nodes_in_no_element_or_twice_in_one() -> None:
    """A node in none has its diagonal; a body without partner is listed as a pair with itself: its
    couplings, no others."""
    for element in ([0, 1], [0, 1, 0, 1]):
        pattern = block_pattern([np.array([element])], np.arange(3))
        np.testing.assert_array_equal(pattern.rows, [0, 1, 1, 2])
        np.testing.assert_array_equal(pattern.columns, [0, 0, 1, 2])


def test_nodes_gather_all_their_elements() -> None:
    elements = np.array([[7, 3, 5], [3, 9, 7]])
    nodes, starts, entries = node_gather(elements)
    np.testing.assert_array_equal(nodes, [3, 5, 7, 9])
    for node, first, end in zip(nodes, starts[:-1], starts[1:], strict=True):
        np.testing.assert_array_equal(
            np.sort(entries[first:end]), np.flatnonzero(elements.ravel() == node)
        )


def test_least_degree_takes_leaves_first() -> None:
    # A star and a chain: no order of a forest from its leaves fills anything in.
    edges = [(0, 1), (0, 2), (0, 3), (0, 4), (5, 6), (6, 7)]
    neighbours: list[set[int]] = [set() for _ in range(8)]
    for i, j in edges:
        neighbours[i].add(j)
        neighbours[j].add(i)
    order, left = least_degree_order(neighbours)
    assert sorted(order) == list(range(8)) and sum(len(rows) for rows in left) == len(edges)


@wp.kernel(enable_backward=False)
def _find_kernel(
    row_starts: wp.array(dtype=wp.int32),
    columns: wp.array(dtype=wp.int32),
    found: wp.array2d(dtype=wp.int32),
):
    row, column = wp.tid()
    if column <= row:
        found[row, column] = find_block(row, column, row_starts, columns)


@given(seed=st.integers(0, 10_000), size=st.integers(1, 12), density=st.floats(0, 1))
def test_every_block_is_found_and_no_other(seed: int, size: int, density: float) -> None:
    """Rows of any pattern end with their diagonal block."""
    held = np.tril(np.random.default_rng(seed).random((size, size)) < density)
    held[np.diag_indices(size)] = True
    rows, columns = np.nonzero(held)
    starts = np.searchsorted(rows, np.arange(size + 1))
    found = wp.full((size, size), -7, dtype=wp.int32, device="cpu")
    inputs = [wp.array(a, dtype=wp.int32, device="cpu") for a in (starts, columns)]
    wp.launch(_find_kernel, found.shape, inputs=inputs, outputs=[found], device="cpu")
    expected = np.where(np.tril(np.ones_like(held)), -1, -7)
    expected[rows, columns] = np.arange(len(rows))
    np.testing.assert_array_equal(found.numpy(), expected)
