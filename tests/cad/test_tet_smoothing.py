# SPDX-License-Identifier: Apache-2.0
"""Moving the inner nodes of flat tets: the energy, what may move, what never gets worse."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.cad.mesh.quality_measures import dihedral_angles_deg, mean_ratios
from taccel_lab.cad.mesh.tet_smoothing import improve_worst_tets, shape_energy

CELLS = 4


def block(seed: int, noise: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes, tets (six a cube) and inner nodes of a cube whose inner nodes are shaken."""
    n = CELLS + 1
    grid = np.stack(np.meshgrid(*[np.arange(n)] * 3, indexing="ij"), axis=-1)
    nodes = grid.reshape(-1, 3).astype(np.float64)
    start = np.arange(n**3).reshape(n, n, n)[:-1, :-1, :-1].ravel()
    steps = {0: n * n, 1: n, 2: 1}
    tets = []
    for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (2, 1, 0), (1, 0, 2)):
        path = np.cumsum([0, steps[a], steps[b], steps[c]])
        even = (a, b, c) in ((0, 1, 2), (1, 2, 0), (2, 0, 1))
        path = path if even else path[[0, 2, 1, 3]]
        tets.append(start[:, None] + path)
    inner = np.flatnonzero(((nodes > 0) & (nodes < CELLS)).all(axis=1))
    nodes[inner] += np.random.default_rng(seed).uniform(-noise, noise, (len(inner), 3))
    return nodes, np.concatenate(tets), inner


def test_energy_is_the_power_of_the_inverse_mean_ratio() -> None:
    nodes, tets, _ = block(1, 0.15)
    value, gradient = shape_energy(nodes, tets, 4)
    assert value == pytest.approx((mean_ratios(nodes, tets) ** -4.0).sum())
    way = np.random.default_rng(2).normal(size=nodes.shape)
    ahead, behind = (shape_energy(nodes + h * way, tets, 4)[0] for h in (1e-6, -1e-6))
    assert (gradient * way).sum() == pytest.approx((ahead - behind) / 2e-6, rel=1e-6)
    assert np.abs(gradient).max() > 1


def test_a_tet_inside_out_has_no_finite_energy() -> None:
    nodes, tets, _ = block(1, 0.0)
    assert shape_energy(nodes, tets[:, [0, 2, 1, 3]], 4)[0] == np.inf


@given(st.integers(0, 1000))
@settings(max_examples=10, deadline=None)
def test_worst_tets_get_rounder_and_only_free_nodes_move(seed: int) -> None:
    nodes, tets, inner = block(seed, 0.33)
    p = nodes[tets]
    if (np.linalg.det(p[:, 1:] - p[:, :1]) <= 1e-3).any():
        return
    before = dihedral_angles_deg(nodes, tets).min()
    moved = improve_worst_tets(nodes, tets, inner, wanted_deg=30)
    after = dihedral_angles_deg(moved, tets).min()
    assert after > before + 1 or before >= 30
    fixed = np.setdiff1d(np.arange(len(nodes)), inner)
    assert np.array_equal(moved[fixed], nodes[fixed])
    p = moved[tets]
    assert (np.linalg.det(p[:, 1:] - p[:, :1]) > 0).all()


def test_good_meshes_and_bound_nodes_stay() -> None:
    nodes, tets, inner = block(3, 0.1)
    angle = float(dihedral_angles_deg(nodes, tets).min())
    kept = improve_worst_tets(nodes, tets, inner, wanted_deg=angle - 1)
    assert np.array_equal(kept, nodes)
    bound = improve_worst_tets(nodes, tets, inner[:0], wanted_deg=60)
    assert np.array_equal(bound, nodes)
