# SPDX-License-Identifier: Apache-2.0
"""Distances and regions against ipctk and exact arithmetic."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import ipctk
import numpy as np
import pytest
from hypothesis import given, settings

from taccel_lab.ipc.distance.closest_pairs import EdgeEdgeRegion, PointTriangleRegion
from tests.ipc import batch
from tests.ipc.batch import Array
from tests.ipc.stencils import (
    degenerate_stencils,
    exact_edge_edge_sq,
    exact_point_triangle_sq,
    nearly_parallel_edges,
    random_stencils,
)

KINDS = {
    "point_triangle": (batch.POINT_TRIANGLE, 4, 7),
    "edge_edge": (batch.EDGE_EDGE, 4, 9),
    "point_edge": (batch.POINT_EDGE, 3, 3),
    "point_point": (batch.POINT_POINT, 2, 1),
}


@pytest.mark.parametrize("name", KINDS)
def test_distances_equal_ipctk(name: str) -> None:
    kind, node_count, region_count = KINDS[name]
    x = random_stencils(1, 3000)
    pairs = batch.query_pairs(kind, x)
    assert np.all(np.bincount(pairs.region, minlength=region_count) > 20), "a region is not covered"
    function: Callable[..., Any] = getattr(ipctk, f"{name}_distance")
    expected = [function(*nodes[:node_count]) for nodes in x]
    np.testing.assert_allclose(pairs.distance_sq, expected, rtol=1e-10, atol=1e-15)
    np.testing.assert_array_equal(pairs.distance_sq, pairs.distance_sq_only)


def test_regions_equal_ipctk() -> None:
    x = random_stencils(2, 3000)
    point_triangle = batch.query_pairs(batch.POINT_TRIANGLE, x)
    renamed = {"P_T0": "V0", "P_T1": "V1", "P_T2": "V2"}
    names = [ipctk.point_triangle_distance_type(*nodes).name for nodes in x]
    ours = [PointTriangleRegion(int(region)).name for region in point_triangle.region]
    assert ours == [renamed.get(name, name.removeprefix("P_")) for name in names]
    edge_edge = batch.query_pairs(batch.EDGE_EDGE, x)
    names = [ipctk.edge_edge_distance_type(*nodes).name for nodes in x]
    assert [EdgeEdgeRegion(int(region)).name for region in edge_edge.region] == names


def test_nearly_parallel_edges_keep_their_digits() -> None:
    x = nearly_parallel_edges(4, 500)
    pairs = batch.query_pairs(batch.EDGE_EDGE, x)
    exact = np.array([exact_edge_edge_sq(nodes) for nodes in x])
    np.testing.assert_allclose(pairs.distance_sq, exact, rtol=1e-10, atol=1e-30)
    assert np.sum(pairs.region == EdgeEdgeRegion.EA_EB) > 100


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("kind", "exact"),
    [(batch.POINT_TRIANGLE, exact_point_triangle_sq), (batch.EDGE_EDGE, exact_edge_edge_sq)],
)
def test_degenerate_stencils(kind: int, exact: Callable[[Array], float]) -> None:
    @settings(max_examples=300, deadline=None)
    @given(degenerate_stencils())
    def check(nodes: Array) -> None:
        pairs = batch.query_pairs(kind, nodes[None])
        assert all(np.all(np.isfinite(field)) for field in pairs)
        weights = pairs.weights[0]
        first = 1 if kind == batch.POINT_TRIANGLE else 2
        assert weights[:first].sum() == pytest.approx(1.0)
        assert weights[first:].sum() == pytest.approx(-1.0)
        assert np.all(weights[:first] >= 0.0)
        assert np.all(weights[first:] <= 0.0)
        assert np.count_nonzero(weights) >= 2
        extent = np.abs(nodes - nodes[0]).max()
        # Rounding of the closest point is relative to the extent, and adds to d, not to d^2.
        assert np.sqrt(pairs.distance_sq[0]) == pytest.approx(
            np.sqrt(exact(nodes)), rel=1e-12, abs=1e-14 * extent
        )
        np.testing.assert_allclose(
            np.linalg.norm(weights @ (nodes - nodes[0])),
            np.sqrt(pairs.distance_sq[0]),
            rtol=1e-9,
            atol=1e-14 * extent,
        )

    check()
