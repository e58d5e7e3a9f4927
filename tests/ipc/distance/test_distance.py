# SPDX-License-Identifier: Apache-2.0
"""Distances and regions against ipctk and exact arithmetic."""

from __future__ import annotations

import ipctk
import numpy as np
import pytest
from hypothesis import given, settings

from taccel_lab.ipc.distance.closest_pairs import EdgeEdgeRegion, PointTriangleRegion
from tests.ipc.batch import (
    EDGE_EDGE,
    NODE_COUNTS,
    POINT_TRIANGLE,
    Array,
    degenerate_stencils,
    nearly_parallel_edges,
    query_pairs,
    random_stencils,
)
from tests.ipc.exact import exact_edge_edge_sq, exact_point_triangle_sq


@pytest.mark.parametrize(("kind", "regions"), [(0, 7), (1, 9), (2, 3), (3, 1)], ids=NODE_COUNTS)
def test_distances_and_regions_equal_ipctk(kind: int, regions: int) -> None:
    name = [*NODE_COUNTS][kind]
    x = random_stencils(1, 3000)
    pairs = query_pairs(kind, x)
    assert np.all(np.bincount(pairs.region, minlength=regions) > 20), "a region is not covered"
    expected = [getattr(ipctk, f"{name}_distance")(*nodes[: NODE_COUNTS[name]]) for nodes in x]
    np.testing.assert_allclose(pairs.distance_sq, expected, rtol=1e-10, atol=1e-15)
    np.testing.assert_array_equal(pairs.distance_sq, pairs.distance_sq_only)
    if kind in (POINT_TRIANGLE, EDGE_EDGE):
        ours = {POINT_TRIANGLE: PointTriangleRegion, EDGE_EDGE: EdgeEdgeRegion}[kind]
        theirs = [getattr(ipctk, f"{name}_distance_type")(*nodes).name for nodes in x]
        renamed = {"P_T0": "V0", "P_T1": "V1", "P_T2": "V2"}
        expected = [renamed.get(region, region.removeprefix("P_")) for region in theirs]
        assert [ours(int(region)).name for region in pairs.region] == expected


def test_nearly_parallel_edges_keep_their_digits() -> None:
    x = nearly_parallel_edges(4, 500)
    pairs = query_pairs(EDGE_EDGE, x)
    exact = np.array([exact_edge_edge_sq(nodes) for nodes in x])
    np.testing.assert_allclose(pairs.distance_sq, exact, rtol=1e-10, atol=1e-30)
    assert np.sum(pairs.region == EdgeEdgeRegion.EA_EB) > 100


@pytest.mark.thorough
@pytest.mark.parametrize("kind", [POINT_TRIANGLE, EDGE_EDGE])
@settings(max_examples=300, deadline=None)
@given(nodes=degenerate_stencils())
def test_degenerate_stencils(kind: int, nodes: Array) -> None:
    exact = (exact_point_triangle_sq, exact_edge_edge_sq)[kind]
    pairs = query_pairs(kind, np.stack([nodes, nodes]))
    assert all(np.all(np.isfinite(field)) for field in pairs)
    weights, distance = pairs.weights[0], np.sqrt(pairs.distance_sq[0])
    first = 1 if kind == POINT_TRIANGLE else 2
    assert weights[:first].sum() == pytest.approx(1.0) and (weights[:first] >= 0).all()
    assert weights[first:].sum() == pytest.approx(-1.0) and (weights[first:] <= 0).all()
    # Rounding of the closest point is relative to the extent, and adds to d, not to d^2.
    off = 1e-14 * np.abs(nodes - nodes[0]).max()
    assert distance == pytest.approx(np.sqrt(exact(nodes)), rel=1e-12, abs=off)
    between = np.linalg.norm(weights @ (nodes - nodes[0]))
    np.testing.assert_allclose(between, distance, rtol=1e-9, atol=off)
