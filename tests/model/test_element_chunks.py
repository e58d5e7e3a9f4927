# SPDX-License-Identifier: Apache-2.0
"""Chunks of elements: which elements, and that their sums are those of the elements."""

from __future__ import annotations

import itertools

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.geometry.block import block_mesh
from taccel_lab.model.element_chunks import (
    CHUNK,
    EntryUses,
    chunk_lanes,
    chunk_sums,
    edge_block_uses,
    stage_stride,
)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(0, 150), min_size=1, max_size=4), st.integers(0, 2**31))
def test_every_element_has_one_lane_of_its_body(sizes: list[int], seed: int) -> None:
    ends = np.cumsum([0, *sizes])
    parts = list(zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True))
    places = np.random.default_rng(seed).normal(size=(ends[-1], 3))
    lanes = chunk_lanes(places, parts)
    np.testing.assert_array_equal(np.sort(lanes[lanes >= 0]), np.arange(ends[-1]))
    body = np.searchsorted(ends[1:], lanes, side="right").reshape(-1, CHUNK)
    for row, chunk in zip(body, lanes.reshape(-1, CHUNK), strict=True):
        assert len(np.unique(row[chunk >= 0])) <= 1
    # No more chunks than half as many again as full ones would be, and one a body.
    assert len(lanes) // CHUNK <= sum(1.5 * size / CHUNK + 1 for size in sizes)


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 100), st.integers(2, 40), st.integers(0, 2**31))
def test_sums_of_chunks_add_up_to_those_of_elements(count: int, key_count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    entries, use_count = 3, 5
    keys = rng.integers(-1, key_count, size=(count, use_count))
    uses = EntryUses(
        keys=keys,
        entries=np.array([0, 1, 2, 2, 0]),
        transposed=rng.random(keys.shape) < 0.5,
        negated=rng.random(use_count) < 0.5,
    )
    blocks = rng.normal(size=(count, entries, 3, 3))
    lanes = chunk_lanes(rng.normal(size=(count, 3)), [(0, count)])
    sums = chunk_sums(lanes, uses, size=9)
    found, expected = np.zeros((2, key_count, 3, 3))
    for element, use in np.ndindex(keys.shape):
        if keys[element, use] >= 0:
            block = blocks[element, uses.entries[use]]
            block = block.T if uses.transposed[element, use] else block
            expected[keys[element, use]] += -block if uses.negated[use] else block
    for chunk, (first, end) in enumerate(zip(sums.starts[:-1], sums.starts[1:], strict=True)):
        stage = np.full(CHUNK * stage_stride(9, entries), np.nan)
        for lane, element in enumerate(lanes[CHUNK * chunk : CHUNK * (chunk + 1)]):
            if element >= 0:
                at = lane * stage_stride(9, entries)
                stage[at : at + 9 * entries] = blocks[element].ravel()
        assert len(np.unique(sums.keys[first:end])) == end - first, "one sum a key"
        widths = np.diff(sums.source_starts[first : end + 1])
        assert (widths >= 1).all() and (np.diff(widths) <= 0).all()
        for number in range(first, end):
            for code in sums.sources[slice(*sums.source_starts[number : number + 2])]:
                block = stage[code // 4 : code // 4 + 9].reshape(3, 3)
                block = block.T if code & 1 else block
                found[sums.keys[number]] += -block if code & 2 else block
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_blocks_of_edges_hold_the_matrix_of_a_tet() -> None:
    """Corner blocks come from translations that cost nothing."""
    rng = np.random.default_rng(0)
    tet = np.array([[7, 2, 5, 4]])
    free = np.ones(8, dtype=bool)
    free[5] = False
    root = rng.normal(size=(4, 3, 12))
    root -= root.mean(axis=0)
    matrix = np.einsum("iak,jbk->iajb", root, root)
    uses = edge_block_uses(tet, free, free)
    found = np.zeros((8, 3, 8, 3))
    edges = [matrix[i, :, j] for i, j in zip(*np.triu_indices(4, 1), strict=True)]
    for use, key in enumerate(uses.keys[0]):
        if key >= 0:
            block = edges[uses.entries[use]]
            block = block.T if uses.transposed[0, use] else block
            found[key // 8, :, key % 8] += -block if uses.negated[use] else block
    nodes = tet[0]
    for i, j in itertools.product(range(4), repeat=2):
        expected = matrix[i, :, j] if nodes[i] <= nodes[j] and free[nodes[[i, j]]].all() else 0
        np.testing.assert_allclose(found[nodes[i], :, nodes[j]], expected, atol=1e-12)


def test_chunks_of_a_mesh_write_a_third_of_its_blocks() -> None:
    mesh = block_mesh((8, 8, 4), (8e-3, 8e-3, 4e-3))
    tets = np.asarray(mesh.tets, dtype=np.int64)
    lanes = chunk_lanes(mesh.nodes_m[tets].mean(axis=1), [(0, len(tets))])
    free = np.ones(mesh.node_count, dtype=bool)
    sums = chunk_sums(lanes, edge_block_uses(tets, free, free), size=9)
    assert len(sums.keys) < 0.36 * 10 * len(tets)
