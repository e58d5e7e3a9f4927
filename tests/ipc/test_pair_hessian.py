# SPDX-License-Identifier: Apache-2.0
"""Hessian of an energy of the distance: chain rule, projection, low-rank form."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.ipc.elasticity.principal import PSD_CLAMP, PSD_NONE
from taccel_lab.ipc.pair_hessian import GAUSS_NEWTON
from tests.ipc import batch
from tests.ipc.batch import Array
from tests.ipc.stencils import nearly_parallel_edges, random_stencils

KINDS = [batch.POINT_TRIANGLE, batch.EDGE_EDGE, batch.POINT_EDGE, batch.POINT_POINT]


def chain_rule(kind: int, x: Array, e1: Array, e2: Array) -> Array:
    """12x12 Hessian from the squared distance, which `test_distance` holds against ipctk."""
    pairs = batch.query_pairs(kind, x)
    g = pairs.gradient.reshape(-1, 12)
    normal = g[:, :, None] * g[:, None, :]
    d = np.sqrt(pairs.distance_sq)[:, None, None]
    return e2[:, None, None] * normal + e1[:, None, None] * (pairs.hessian_sq / 2 - normal) / d


def projected(hessian: Array) -> Array:
    values, vectors = np.linalg.eigh(hessian)
    return (vectors * np.maximum(values, 0.0)[:, None, :]) @ vectors.transpose(0, 2, 1)


def relative_error(ours: Array, expected: Array, scale: Array) -> Array:
    return np.abs(ours - expected).max(axis=(1, 2)) / np.abs(scale).max(axis=(1, 2))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("signs", [(-1, 1), (1, -1), (1, 1), (-1, -1)])
def test_exact_and_projected(kind: int, signs: tuple[int, int]) -> None:
    x = random_stencils(10 + kind, 1000)
    rng = np.random.default_rng(0)
    e1 = signs[0] * 10.0 ** rng.uniform(-2, 2, len(x))
    e2 = signs[1] * 10.0 ** rng.uniform(-2, 2, len(x))
    expected = chain_rule(kind, x, e1, e2)
    gradient, exact = batch.pair_energy(kind, PSD_NONE, x, e1, e2)
    assert relative_error(exact, expected, expected).max() < 1e-10
    unit = batch.query_pairs(kind, x).gradient
    np.testing.assert_allclose(gradient, e1[:, None, None] * unit, rtol=1e-13, atol=1e-15)
    if kind != batch.POINT_POINT or min(signs) < 0:
        assert np.linalg.eigvalsh(expected).min() < -1e-3, "nothing to project"

    _, psd = batch.pair_energy(kind, PSD_CLAMP, x, e1, e2)
    np.testing.assert_allclose(psd, psd.transpose(0, 2, 1), atol=1e-12 * np.abs(psd).max())
    scale = np.abs(expected).max(axis=(1, 2))
    assert (np.linalg.eigvalsh(psd)[:, 0] > -1e-12 * scale).all()
    assert (np.linalg.eigvalsh(psd - expected)[:, 0] > -1e-9 * scale).all(), "not above the whole"


@pytest.mark.parametrize("kind", [batch.POINT_EDGE, batch.POINT_POINT])
@pytest.mark.parametrize("e1", [-3.0, 2.0])
def test_terms_that_are_orthogonal_are_projected_as_the_whole(kind: int, e1: float) -> None:
    """Along an edge and across it; only what a third term shares with them is counted twice."""
    x = random_stencils(50 + kind, 500)
    slopes, none = np.full(len(x), e1), np.zeros(len(x))
    expected = chain_rule(kind, x, slopes, none)
    _, psd = batch.pair_energy(kind, PSD_CLAMP, x, slopes, none)
    assert relative_error(psd, projected(expected), expected).max() < 1e-10
    if kind == batch.POINT_EDGE or e1 > 0:
        assert np.median(np.linalg.eigvalsh(psd)[:, -1]) > 1e-3, "nothing is left"


@pytest.mark.parametrize("kind", KINDS)
def test_near_contact_the_sum_of_projections_is_that_of_the_whole(kind: int) -> None:
    """A barrier at a hundredth of the features' size: off by a few parts in a thousand."""
    x = random_stencils(60 + kind, 1000)
    pairs = batch.query_pairs(kind, x)
    d = np.sqrt(pairs.distance_sq)
    first = 2 if kind == batch.EDGE_EDGE else 1
    normal = (pairs.gradient[:, :first]).sum(axis=1)
    x[:, :first] -= (0.99 * d)[:, None, None] * normal[:, None]
    d = np.sqrt(batch.query_pairs(kind, x).distance_sq)
    assert d.max() < 0.1
    _, psd = batch.pair_energy(kind, PSD_CLAMP, x, -1 / d, 1 / d**2)
    best = projected(chain_rule(kind, x, -1 / d, 1 / d**2))
    off = np.linalg.norm(psd - best, axis=(1, 2)) / np.linalg.norm(best, axis=(1, 2))
    assert np.percentile(off, 90) < 5e-3


@pytest.mark.parametrize("kind", KINDS)
def test_gauss_newton_is_the_normal_term(kind: int) -> None:
    x = random_stencils(20 + kind, 300)
    _, hessian = batch.pair_energy(kind, GAUSS_NEWTON, x, -3.0, 5.0)
    g = batch.query_pairs(kind, x).gradient.reshape(-1, 12)
    np.testing.assert_allclose(hessian, 5.0 * g[:, :, None] * g[:, None, :], atol=1e-12)
    _, hessian = batch.pair_energy(kind, GAUSS_NEWTON, x, -3.0, -5.0)
    assert np.all(hessian == 0.0)


def test_nearly_parallel_edges_stay_finite_and_semidefinite() -> None:
    x = nearly_parallel_edges(30, 1000)
    _, hessian = batch.pair_energy(batch.EDGE_EDGE, PSD_CLAMP, x, -1.0, 1.0)
    assert np.all(np.isfinite(hessian))
    values = np.linalg.eigvalsh(hessian)
    assert np.all(values[:, 0] >= -1e-12 * values[:, -1])


def test_touching_nodes_give_no_nan() -> None:
    x = np.zeros((1, 4, 3))
    for kind in KINDS:
        gradient, hessian = batch.pair_energy(kind, GAUSS_NEWTON, x, -1.0, 1.0)
        assert np.all(np.isfinite(gradient))
        assert np.all(np.isfinite(hessian))


def test_hessian_equals_finite_differences_of_the_gradient() -> None:
    """Through a barrier-like energy -log d, whose derivatives depend on d."""
    step = 1e-6
    for kind in KINDS:
        x = random_stencils(40 + kind, 200)
        moved = x[:, None, None] + step * np.stack([np.eye(12), -np.eye(12)]).reshape(2, 12, 4, 3)
        moved = moved.reshape(-1, 4, 3)
        near = batch.query_pairs(kind, moved)
        here = batch.query_pairs(kind, x)
        steady = np.all(near.region.reshape(-1, 24) == here.region[:, None], axis=1)
        steady &= here.distance_sq > 1e-2
        assert steady.sum() > 150
        d = np.sqrt(here.distance_sq)
        _, hessian = batch.pair_energy(kind, PSD_NONE, x, -1 / d, 1 / d**2)
        slope, _ = batch.pair_energy(kind, PSD_NONE, moved, -1 / np.sqrt(near.distance_sq), 0.0)
        slope = slope.reshape(-1, 2, 12, 12)
        numeric = (slope[:, 0] - slope[:, 1]) / (2 * step)
        assert relative_error(hessian, numeric, numeric)[steady].max() < 1e-5
