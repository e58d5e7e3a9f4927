# SPDX-License-Identifier: Apache-2.0
"""The filter passes quadratics and takes out what alternates from node to node."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.signals import ContactSurface
from taccel_lab.signals.nodal_filter import filter_nodes
from tests.signals.pressed_surface import extrude, flat_pad


def _flat(mesh):
    surface = ContactSurface.from_mesh(mesh)
    return surface, mesh.nodes_m[surface.node_idx, :2]


@settings(max_examples=20)
@given(st.lists(st.floats(-1, 1), min_size=6, max_size=6), st.integers(0, 100))
def test_quadratics_pass_unchanged(coefficients, seed):
    surface, xy = _flat(flat_pad(0.5, (2.5, 2.0), seed))
    x, y = (xy * 1e3).T
    values = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1) @ coefficients
    usable = np.random.default_rng(seed).random(len(x)) < 0.8
    filtered = filter_nodes(surface, xy, values, usable, passes=2)
    assert np.abs(filtered - values).max() < 1e-5


def test_a_checkerboard_shrinks_fivefold_a_pass():
    """A grid of squares with alternating diagonals: the mesh on which linear tets ripple."""
    count = 13
    i, j = np.meshgrid(np.arange(count), np.arange(count), indexing="ij")
    node = i * count + j
    squares = [node[:-1, :-1], node[1:, :-1], node[1:, 1:], node[:-1, 1:]]
    a, b, c, d = (q.ravel() for q in squares)
    flip = ((i + j)[:-1, :-1] % 2 == 1).ravel()
    first = np.where(flip[:, None], np.stack([a, b, d], 1), np.stack([a, b, c], 1))
    second = np.where(flip[:, None], np.stack([b, c, d], 1), np.stack([a, c, d], 1))
    xy = np.stack([i.ravel(), j.ravel()], axis=1) * 0.2e-3
    surface, xy = _flat(extrude(xy, np.concatenate([first, second])))
    board = 1.0 - 2.0 * ((i + j).ravel() % 2)
    everywhere = np.ones(len(board), dtype=bool)
    inner = (np.minimum(i, j) > 3).ravel() & (np.maximum(i, j) < count - 4).ravel()
    for passes, limit in ((1, 0.3), (2, 0.09)):
        filtered = filter_nodes(surface, xy, board, everywhere, passes=passes)
        assert np.abs(filtered[inner]).max() < limit
    assert len(surface.node_idx) == count**2


def test_unusable_nodes_neither_change_nor_matter():
    surface, xy = _flat(flat_pad(0.4, (2.0, 2.0)))
    values = np.random.default_rng(0).normal(size=len(xy))
    usable = xy[:, 0] > 0
    poisoned = np.where(usable, values, np.nan)
    filtered = filter_nodes(surface, xy, poisoned, usable)
    assert np.isnan(filtered[~usable]).all()
    other = filter_nodes(surface, xy, np.where(usable, values, 1e6), usable)
    assert np.array_equal(filtered[usable], other[usable])
    assert np.abs(filtered - values)[usable].max() > 0.1
