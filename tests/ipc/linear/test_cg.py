# SPDX-License-Identifier: Apache-2.0
"""CG by thread blocks, and its parts; with blocks of many lanes, so that a race would show.

On a GPU: teams of thread blocks that cannot all be resident, more than it holds or two at a time.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import warp as wp
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.ipc.linear.cg.block_cg import BlockCG
from taccel_lab.ipc.linear.cg.pipelined_cg import PATIENCE, PipelinedCG
from taccel_lab.ipc.linear.cg.preconditioner import DiagonalInverses
from taccel_lab.ipc.linear.problem.packed_rows import PackedRows
from taccel_lab.ipc.linear.problem.row_plan import plan_rows, scalars
from taccel_lab.ipc.linear.system import METHODS, LinearSystem, Solver
from tests.ipc.linear.systems import contact_system, mask, residuals, solve

LANES = 32
SOLVERS = [
    lambda system: BlockCG(system, system.clusters, LANES),
    lambda system: PipelinedCG(system, system.clusters, LANES),
]


@pytest.mark.parametrize("make", [*SOLVERS, METHODS["ssor"]])
def test_gel_and_stiff_body_against_a_dense_solve(
    many_lanes: None, make: Callable[[LinearSystem], Solver]
) -> None:
    system, dense = contact_system(3)
    system._solver = make(system)
    tolerances = np.array([1e-10, 1e-6, 1e-3])
    report = solve(system, tolerances)
    found = residuals(system, dense)
    assert (found <= tolerances).all() and not report.breakdown.any()
    np.testing.assert_allclose(report.relative_residual, found, rtol=1e-2, atol=1e-11)
    first = system.solution.numpy()
    expected = np.linalg.solve(dense[0], system.rhs.numpy()[0].ravel())
    np.testing.assert_allclose(first[0].ravel(), expected, rtol=0, atol=1e-8)
    # Summing extra blocks in place leaves the matrix as it was.
    solve(system, tolerances)
    np.testing.assert_allclose(system.solution.numpy(), first, rtol=1e-6, atol=1e-9)


def test_the_cluster_of_a_stiff_body_saves_most_iterations() -> None:
    system, _ = contact_system(1)
    counts = []
    for clusters in ([], system.clusters):
        system._solver = BlockCG(system, clusters)
        counts.append(solve(system, 1e-6).iterations[0])
    assert counts[1] < 0.6 * counts[0]


@pytest.mark.parametrize("make", SOLVERS)
def test_neighbours_do_not_matter(many_lanes: None, make: Callable[[LinearSystem], Solver]) -> None:
    system, _ = contact_system(4)
    system._solver = make(system)
    iterations = solve(system, 1e-8).iterations
    together = system.solution.numpy()
    for env in (0, 3):
        active = np.arange(4) == env
        report, alone = solve(system, 1e-8, active), system.solution.numpy()
        # Extra blocks are listed in the order of arrival, the same here as lanes take turns.
        np.testing.assert_array_equal(alone, np.where(active[:, None, None], together, 0))
        assert (report.iterations == np.where(active, iterations, 0)).all()


def test_lists_of_extra_blocks_that_are_too_short(many_lanes: None) -> None:
    """Blocks beyond the capacity of the list are lost, and nothing beyond it is read; without room
    in slices they are taken all the same."""
    system, _ = contact_system(1)
    solver = BlockCG(system, system.clusters, LANES)
    system._solver = solver
    counts = system.extra.counts.numpy()
    values = system.extra.values.numpy()
    values[counts[0] :] = 0.0
    system.extra.values.assign(values)
    iterations = solve(system, 1e-9).iterations
    expected = system.solution.numpy()
    system.extra.counts.fill_(10 * system.extra.capacity)
    solve(system, 1e-9)
    np.testing.assert_allclose(system.solution.numpy(), expected, rtol=1e-6, atol=1e-9)
    system.extra.counts.assign(counts)
    rows = solver._extra.rows
    solve(system, 1e-9)
    needed = rows.totals.numpy()[0, 2]
    for room in (64, needed - 1):
        rows.starts.assign(np.array([[0, 0, 0], [*rows.starts.numpy()[1, :2], room]]))
        report = solve(system, 1e-9)
        assert (rows.slices.numpy()[:, 0] == -1).any()
        np.testing.assert_allclose(system.solution.numpy(), expected, rtol=1e-6, atol=1e-9)
        assert abs(report.iterations - iterations) <= 2


def test_inverses_of_blocks_and_clusters(many_lanes: None) -> None:
    system, _ = contact_system(2)
    n = system.pattern.free_count
    groups = [np.arange(n - 4, n), np.array([0, 3, 4, 9, 11]), np.array([7])]
    plan = plan_rows(n, groups)
    inverses = DiagonalInverses(system, plan, LANES)
    inverses.update(mask(1, 1), scalars(system.values))
    dense = system.pattern.dense(system.values.numpy())
    single = np.setdiff1d(np.arange(n), np.concatenate(groups))
    store = inverses.stores.numpy()
    for env in range(2):
        blocks = inverses.blocks.numpy()[env, plan.places]
        for row in single:
            block = dense[env, 3 * row : 3 * row + 3, 3 * row : 3 * row + 3]
            np.testing.assert_allclose(blocks[row] @ block, np.eye(3), atol=1e-9)
        assert (blocks[np.concatenate(groups)] == 0).all()
        start = 0
        for rows in groups:
            dofs = (3 * rows[:, None] + np.arange(3)).ravel()
            width = len(dofs)
            found = store[env, start : start + width**2].reshape(width, width)
            block = dense[env][np.ix_(dofs, dofs)]
            np.testing.assert_allclose(found @ block, np.eye(width), atol=1e-7)
            start += width**2


def test_clusters_that_are_too_large_are_refused() -> None:
    system, _ = contact_system(1)
    plan = plan_rows(system.pattern.free_count, [np.arange(49)])
    with pytest.raises(ValueError, match="at most 144 rows are inverted, got 147"):
        DiagonalInverses(system, plan)


@given(st.integers(0, 2**32 - 1), st.integers(2, 40), st.integers(0, 20), st.integers(1, 6))
def test_blocks_own_whole_clusters(seed: int, rows: int, clustered: int, blocks: int) -> None:
    rng = np.random.default_rng(seed)
    inside = rng.permutation(rows)[:clustered]
    groups = [g for g in np.split(inside, np.sort(rng.integers(0, len(inside) + 1, 3))) if len(g)]
    plan = plan_rows(rows, groups, blocks)
    np.testing.assert_array_equal(np.sort(plan.order), np.arange(rows))
    np.testing.assert_array_equal(plan.places[plan.order], np.arange(rows))
    assert plan.block_starts[0] == 0 and plan.block_starts[-1] == rows
    assert len(plan.block_starts) == blocks + 1 and (np.diff(plan.block_starts) >= 0).all()
    owner = np.searchsorted(plan.block_starts[1:-1], plan.places, side="right")
    for group, found in zip(groups, plan.groups(), strict=True):
        np.testing.assert_array_equal(found, group)
        assert len(set(owner[group])) == 1
    assert np.diff(plan.block_starts).max() <= rows / blocks + max([1, *map(len, groups)])


@pytest.mark.parametrize("blocks", [1, 4])
def test_slices_hold_both_triangles(many_lanes: None, blocks: int) -> None:
    system, _ = contact_system(2)
    n = system.pattern.free_count
    plan = plan_rows(n, [np.array([3, 9, 4]), np.array([20, 21])], blocks)
    rows = PackedRows(system, plan, LANES)
    rows.update(mask(0, 1), scalars(system.values))
    assert (rows.values.numpy()[0] == 0).all()
    found = np.zeros((3 * n, n, 3))
    layout = rows.layout
    segments, slices = layout.segments.numpy(), layout.slices.numpy()
    columns, packed = layout.columns.numpy(), rows.values.numpy()[1]
    parts: dict[int, list[int]] = {}
    owners = np.searchsorted(plan.block_starts[1:-1], segments[:, 0], side="right")
    starts = layout.task_starts.numpy()
    assert (starts % 96 == 0).all() and starts[-1] == 3 * len(segments)
    for index, (place, number) in enumerate(segments):
        if place < 0:
            continue
        parts.setdefault(place, []).append(number)
        assert starts[owners[index]] <= 3 * index < starts[owners[index] + 1]
        for task in range(3 * index, 3 * index + 3):
            first, length = slices[task // 32]
            for k in range(length):
                at = first + 32 * k
                entry = packed[3 * at + task % 32 + 32 * np.arange(3)]
                found[3 * place + task % 3, columns[at + task % 32]] += entry
    row_segments = layout.row_segments.numpy()
    for place in range(n):
        expected = np.arange(row_segments[place], row_segments[place + 1])
        np.testing.assert_array_equal(np.sort(parts[place]), expected)
    dense = system.pattern.dense(system.values.numpy())[1]
    order = (3 * plan.order[:, None] + np.arange(3)).ravel()
    expected = dense[np.ix_(order, order)].astype(np.float32)
    np.testing.assert_array_equal(found.reshape(3 * n, 3 * n), expected)
    # Filling up is no large part of it.
    assert packed.size < 1.5 * (dense != 0).sum() and layout.segment_count == row_segments[-1]


GPU = "cuda:0"
NEEDS_GPU = pytest.mark.skipif(not wp.is_cuda_available(), reason="needs a CUDA device")


def assert_solved(system: LinearSystem, dense: np.ndarray) -> None:
    assert not system.report().breakdown.any() and (residuals(system, dense) <= 1.01e-8).all()


@pytest.mark.gpu
@NEEDS_GPU
@pytest.mark.parametrize("patience", [0, PATIENCE])
@pytest.mark.parametrize(("envs", "lanes", "blocks"), [(1, 32, 8), (12, 512, 64)])
def test_whoever_is_there_does_the_work(envs: int, lanes: int, blocks: int, patience: int) -> None:
    """Twelve teams of 64 blocks of 512 lanes are more than any GPU holds; without patience teams
    are of every size."""
    system, dense = contact_system(envs, on=GPU)
    system._solver = PipelinedCG(system, system.clusters, lanes, blocks, 8, patience)
    for _ in range(20):
        solve(system, 1e-8)
        assert_solved(system, dense)


@pytest.mark.gpu
@NEEDS_GPU
def test_solvers_in_streams_of_their_own_end() -> None:
    streams = [wp.Stream(GPU) for _ in range(3)]
    cases = []
    for stream in streams:
        with wp.ScopedStream(stream):
            system, dense = contact_system(2, on=GPU)
            system._solver = PipelinedCG(system, system.clusters, 512, 64, 8)
            system.tolerances.fill_(1e-8)
            cases.append((system, dense, mask(1, 1, on=GPU)))
    for _ in range(50):
        for stream, (system, _, active) in zip(streams, cases, strict=True):
            with wp.ScopedStream(stream):
                system.solve(active, 1000)
    wp.synchronize_device(GPU)
    for system, dense, _ in cases:
        assert_solved(system, dense)
