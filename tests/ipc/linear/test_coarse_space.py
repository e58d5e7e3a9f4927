# SPDX-License-Identifier: Apache-2.0
"""The coarse space of CG; with blocks of many lanes, so that a race would show."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import warp as wp
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from taccel_lab.ipc.elasticity.principal import PSD_NONE
from taccel_lab.ipc.linear.cg.block_cg import BlockCG
from taccel_lab.ipc.linear.cg.pipelined_cg import PipelinedCG
from taccel_lab.ipc.linear.coarse.matrix import CoarseCorrection, coarse_parts
from taccel_lab.ipc.linear.coarse.space import MODES
from taccel_lab.ipc.linear.problem.row_plan import connected_rows, neighbour_clusters, plan_rows
from taccel_lab.ipc.linear.system import LinearSystem
from taccel_lab.model.matrix_pattern import block_pattern
from taccel_lab.scene import Material, Scene
from tests.ipc.linear.systems import (
    contact_system,
    delaunay_pattern,
    mask,
    residuals,
    solve,
    touch_elsewhere,
)
from tests.support.blocks import soft_block
from tests.verification.elements import ElementForces

CPU = wp.get_device("cpu")
LANES = 64
every_method = pytest.mark.parametrize("method", [BlockCG, PipelinedCG])


def bar(length: int, envs: int = 1) -> tuple[LinearSystem, np.ndarray]:
    """A bar that stands on its bonded end, 4 by 4 nodes thick, and its dense matrix."""
    size = (3e-3, 3e-3, 1e-3 * (length - 1))
    gel = soft_block((3, 3, length - 1), size, Material(1.5e5, 0.46))
    forces = ElementForces(Scene(gel).finalize())
    rest, pattern = forces.model.rest_positions.numpy(), forces.model.pattern
    values = forces.system(rest, PSD_NONE)[0][0]
    values[pattern.diagonal] += 1e-2 * np.eye(3)  # Inertia of a cubic millimetre in 0.01 s.
    system = LinearSystem(pattern, envs, CPU, method="cg", positions_m=rest[0, forces.free])
    system.values.assign(np.broadcast_to(values, (envs, *values.shape)))
    system.rhs.assign(1e-3 * np.random.default_rng(1).normal(size=(envs, pattern.free_count, 3)))
    return system, pattern.dense(values[None])[0]


def rigid_motions(parts: list[np.ndarray], x: np.ndarray) -> np.ndarray:
    """P of the parts as the docstring has it, [3 row_count, 6 part_count]."""
    p = np.zeros((len(x), 3, len(parts), MODES))
    for part, rows in enumerate(parts):
        arm = x[rows] - x[rows].mean(axis=0)
        arm /= np.abs(arm).max()
        for k in range(3):
            p[rows, k, part, k] = 1
            p[rows, :, part, 3 + k] = np.cross(np.eye(3)[k], arm)
    return p.reshape(3 * len(x), -1)


@pytest.mark.parametrize("part_rows", [40, 70])
def test_the_matrix_of_the_parts_is_inverted(many_lanes: None, part_rows: int) -> None:
    system, dense = bar(14, envs=2)
    assert system.positions_m is not None
    parts = coarse_parts(system, [], part_rows)
    assert sorted(np.concatenate(parts)) == list(range(system.pattern.free_count))
    plan = plan_rows(system.pattern.free_count, [], 3, parts)
    correction = CoarseCorrection(system, plan, parts, LANES)
    correction.update(mask(1, 0))
    p = rigid_motions(parts, system.positions_m)
    assert correction.space.width == p.shape[1]
    found = correction.space.inverses.numpy()
    coarse = p.T @ dense @ p
    np.testing.assert_allclose(
        found[0].reshape(coarse.shape) @ coarse, np.eye(len(coarse)), atol=1e-9
    )
    assert (found[1] == 0).all(), "not an active one"


@pytest.mark.thorough
@every_method
def test_a_long_bar_takes_few_iterations(many_lanes: None, method: type) -> None:
    counts = {}
    for part_rows in (1000, 64):
        system, dense = bar(40, envs=2)
        system._solver = method(system, [], LANES, part_rows=part_rows)
        report = solve(system, 1e-6, most=2000)
        assert not report.breakdown.any()
        assert (residuals(system, np.stack([dense, dense])) <= 1.001e-6).all()
        counts[part_rows] = int(report.iterations.max())
        assert ("rigid motions of 10 parts" in system.describe()) == (part_rows == 64)
    assert counts[64] < 0.4 * counts[1000]


@every_method
def test_bodies_and_extra_blocks_stand_beside_it(many_lanes: None, method: type) -> None:
    system, dense = contact_system(1)
    touch_elsewhere(system, dense, 1)
    system.positions_m = np.random.default_rng(0).random((system.pattern.free_count, 3))
    system._solver = method(system, system.clusters, LANES, part_rows=20)
    assert "1 of bodies" in system.describe() and "parts" in system.describe()
    solve(system, 1e-9)
    assert residuals(system, dense) <= 1.01e-9


def test_an_indefinite_matrix_is_left_out(many_lanes: None) -> None:
    system, _ = bar(14)
    system.values.assign(-system.values.numpy())
    parts = coarse_parts(system, [])
    assert parts
    plan = plan_rows(system.pattern.free_count, [], parts=parts)
    correction = CoarseCorrection(system, plan, parts, LANES)
    correction.space.inverses.fill_(np.nan)
    correction.update(mask(1))
    assert (correction.space.inverses.numpy() == 0).all()


@pytest.mark.parametrize(("rows", "parts"), [(64, 0), (129, 3), (1000, 16), (5000, 24)])
def test_parts_are_few(rows: int, parts: int) -> None:
    """A chain: none where one would be all there is, no more than fit otherwise."""
    links = np.stack([np.arange(rows - 1), np.arange(1, rows)], axis=1)
    pattern = block_pattern([links], np.arange(rows))
    positions = np.outer(np.arange(rows), [1.0, 0.0, 0.0])
    system = LinearSystem(pattern, 1, CPU, method="cg", positions_m=positions)
    found = coarse_parts(system, [])
    assert len(found) <= 24
    if parts < 24:
        assert len(found) == parts
    system.positions_m = None
    assert not coarse_parts(system, [])


def test_parts_are_of_one_gel_and_only_of_large_ones() -> None:
    starts = np.cumsum([0, 90, 300, 200, 120])
    links = [np.stack([np.arange(a, b - 1), np.arange(a + 1, b)], 1) for a, b in pairwise(starts)]
    rows = int(starts[-1])
    pattern = block_pattern([np.concatenate(links)], np.arange(rows))
    system = LinearSystem(pattern, 1, CPU, method="cg", positions_m=np.zeros((rows, 3)))
    found = coarse_parts(system, [])
    for part in found:
        assert len(set(np.searchsorted(starts, part, side="right"))) == 1
    assert sorted(np.concatenate(found)) == list(range(90, 590))


def test_clusters_are_halves_in_breadth_first_order() -> None:
    """Against scipy's graphs, on the pieces that a fifth of the rows of an irregular mesh makes."""
    rng = np.random.default_rng(0)
    pattern = delaunay_pattern(rng, 300, 20)
    coupled = csr_array(pattern.dense(np.ones((1, pattern.block_count, 3, 3)))[0][::3, ::3])
    rows = np.flatnonzero(rng.random(pattern.free_count) < 0.2)
    count, label = connected_components(coupled[rows][:, rows])
    found = connected_rows(pattern, rows)
    assert count == len(found) == 6 and max(map(len, found)) == 48
    for k, part in enumerate(found):
        np.testing.assert_array_equal(part, rows[label == k])
        near, cut = coupled[part][:, part], len(part) // 2
        order = part[breadth_first_order(near, breadth_first_order(near, 0)[0][-1])[0]]
        halves = [order[:cut], order[cut:]] if cut else [part]
        clusters = neighbour_clusters(pattern, part, max(1, -(-len(part) // 2)))
        for cluster, half in zip(clusters, halves, strict=True):
            np.testing.assert_array_equal(cluster, np.sort(half))
