# SPDX-License-Identifier: Apache-2.0
"""The energy of a pair: barrier, derivatives by its nodes, projection, mollifier; against ipctk."""

from __future__ import annotations

import ipctk
import numpy as np
import pytest
import warp as wp

from taccel_lab.ipc.contact import barrier
from taccel_lab.ipc.contact import pair_energy as pairs
from taccel_lab.ipc.device.matrices import mat1212d
from taccel_lab.ipc.distance import edge_edge_mollifier as mollifiers
from taccel_lab.ipc.elasticity.principal import PSD_CLAMP, PSD_NONE
from tests.ipc.batch import (
    EDGE_EDGE,
    NODE_COUNTS,
    POINT_EDGE,
    POINT_POINT,
    Array,
    closest,
    filled,
    mapped,
    nearly_parallel_edges,
    query_pairs,
    random_stencils,
)

BARRIERS = (ipctk.barrier, ipctk.barrier_first_derivative, ipctk.barrier_second_derivative)
every_kind = pytest.mark.parametrize("kind", range(4), ids=NODE_COUNTS)


def test_the_barrier_equals_ipctk() -> None:
    rng, stiffness = np.random.default_rng(0), 3.7
    dhat = 10.0 ** rng.uniform(-6, 0, 2000)
    d = dhat * 10.0 ** rng.uniform(-8, 0.2, 2000)
    active = d < dhat
    assert 0 < active.sum() < len(d)
    for order, function in enumerate(BARRIERS):
        suffix, scale = ("", "_d1", "_d2")[order], dhat ** (2 - order)
        expected = np.array([function(*pair) for pair in zip(d, dhat, strict=True)]) / scale
        unit = mapped(getattr(barrier, f"unit_barrier{suffix}"), d / dhat)
        np.testing.assert_allclose(unit, expected, rtol=1e-11, atol=1e-14)
        assert not unit[~active].any() and ((-1) ** order * unit[active] > 0).all()
        potential = mapped(getattr(barrier, f"contact_potential{suffix}"), d, dhat, stiffness)
        np.testing.assert_allclose(potential, unit * scale * stiffness / dhat, rtol=1e-13)


def test_a_unit_gap_is_where_the_barrier_has_its_pressure() -> None:
    pressure = 10.0 ** np.random.default_rng(1).uniform(-3, 2, 500)
    gap = mapped(barrier.unit_gap, pressure)
    low, high = (-mapped(barrier.unit_barrier_d1, gap + d) for d in (1e-6, -2e-6))
    assert (low <= pressure * (1 + 1e-12)).all() and (high >= pressure * (1 - 1e-12)).all()
    np.testing.assert_allclose(mapped(barrier.unit_gap, np.array([0.0, -1.0])), 1.0)


# Derivatives of an energy of the distance ------------------------------------------------------


@wp.func
def hessian_matrix(h: pairs.PairHessian) -> mat1212d:
    """All 16 blocks [N/m], which the solver never forms as a whole."""
    matrix = mat1212d()
    block_count = int(16)  # a variable, so that Warp does not unroll the loop
    for k in range(block_count):
        block = pairs.pair_hessian_block(h, k // 4, k % 4)
        for a in range(3):
            for b in range(3):
                matrix[3 * (k // 4) + a, 3 * (k % 4) + b] = block[a, b]
    return matrix


@wp.func
def pair_terms(
    kind: wp.int32, mode: wp.int32, x0: wp.vec3d, x1: wp.vec3d, x2: wp.vec3d, x3: wp.vec3d,
    e1: wp.float64, e2: wp.float64,
):  # fmt: skip
    pair = closest(kind, x0, x1, x2, x3)
    h = pairs.pair_hessian(pair, x0, x1, x2, x3, e1, e2, mode)
    return pairs.pair_gradient(pair, e1), hessian_matrix(h)


def pair_energy(kind: int, mode: int, x: Array, e1: Array | float, e2: Array | float) -> list:
    slopes = (filled(e1, len(x)), filled(e2, len(x)))
    return mapped(pair_terms, kind, mode, *x.swapaxes(0, 1), *slopes)


def of_ipctk(kind: int, x: Array) -> tuple[Array, Array, Array]:
    """Distances, gradients [n, 12], and half the Hessians of the squares [n, 12, 12]."""
    name, count = [*NODE_COUNTS.items()][kind]
    square, gradient, hessian = (
        getattr(ipctk, f"{name}_distance{suffix}") for suffix in ("", "_gradient", "_hessian")
    )
    d, gradients, halves = np.zeros(len(x)), np.zeros((len(x), 12)), np.zeros((len(x), 12, 12))
    size = 3 * count
    for i, nodes in enumerate(x[:, :count]):
        d[i] = square(*nodes) ** 0.5
        gradients[i, :size] = gradient(*nodes) / (2 * d[i])
        halves[i, :size, :size] = hessian(*nodes) / 2
    return d, gradients, halves


def outer(a: Array, b: Array) -> Array:
    return a[:, :, None] * b[:, None, :]


def chain_rule(kind: int, x: Array, e1: Array, e2: Array) -> Array:
    d, g, half = of_ipctk(kind, x)
    normal = outer(g, g)
    return e2[:, None, None] * normal + (e1 / d)[:, None, None] * (half - normal)


def projected(hessian: Array) -> Array:
    values, vectors = np.linalg.eigh(hessian)
    return (vectors * np.maximum(values, 0.0)[:, None, :]) @ vectors.transpose(0, 2, 1)


def largest(rows: Array) -> Array:
    return np.abs(rows).reshape(len(rows), -1).max(axis=1)


@every_kind
@pytest.mark.parametrize("signs", [(-1, 1), (1, -1), (1, 1), (-1, -1)])
def test_exact_and_projected(kind: int, signs: tuple[int, int]) -> None:
    x = random_stencils(10 + kind, 500)
    e1, e2 = 10.0 ** np.random.default_rng(0).uniform(-2, 2, (2, len(x))) * np.array([signs]).T
    expected = chain_rule(kind, x, e1, e2)
    scale = largest(expected)
    gradient, exact = pair_energy(kind, PSD_NONE, x, e1, e2)
    assert (largest(exact - expected) / scale).max() < 1e-9
    unit = of_ipctk(kind, x)[1].reshape(-1, 4, 3)
    np.testing.assert_allclose(gradient / e1[:, None, None], unit, atol=1e-11)
    if kind != POINT_POINT or min(signs) < 0:
        assert np.linalg.eigvalsh(expected).min() < -1e-3, "nothing to project"
    _, psd = pair_energy(kind, PSD_CLAMP, x, e1, e2)
    np.testing.assert_allclose(psd, psd.transpose(0, 2, 1), atol=1e-12 * np.abs(psd).max())
    assert (np.linalg.eigvalsh(psd)[:, 0] > -1e-12 * scale).all()
    assert (np.linalg.eigvalsh(psd - expected)[:, 0] > -1e-9 * scale).all(), "not above the whole"


@pytest.mark.parametrize("kind", [POINT_EDGE, POINT_POINT])
@pytest.mark.parametrize("e1", [-3.0, 2.0])
def test_terms_that_are_orthogonal_are_projected_as_the_whole(kind: int, e1: float) -> None:
    """Along an edge and across it; only what a third term shares with them is counted twice."""
    x = random_stencils(50 + kind, 500)
    expected = chain_rule(kind, x, filled(e1, 500), np.zeros(500))
    _, psd = pair_energy(kind, PSD_CLAMP, x, e1, 0.0)
    assert (largest(psd - projected(expected)) / largest(expected)).max() < 1e-9
    if kind == POINT_EDGE or e1 > 0:
        assert np.median(np.linalg.eigvalsh(psd)[:, -1]) > 1e-3, "nothing is left"


@every_kind
def test_near_contact_the_sum_of_projections_is_that_of_the_whole(kind: int) -> None:
    """A barrier at a hundredth of the features' size: off by a few parts in a thousand."""
    x = random_stencils(60 + kind, 1000)
    d, unit, _ = of_ipctk(kind, x)
    first = 2 if kind == EDGE_EDGE else 1
    normal = unit.reshape(-1, 4, 3)[:, :first].sum(axis=1)
    x[:, :first] -= (0.99 * d)[:, None, None] * normal[:, None]
    d = np.sqrt(query_pairs(kind, x).distance_sq)
    assert d.max() < 0.1
    _, psd = pair_energy(kind, PSD_CLAMP, x, -1 / d, 1 / d**2)
    best = projected(chain_rule(kind, x, -1 / d, 1 / d**2))
    off = np.linalg.norm(psd - best, axis=(1, 2)) / np.linalg.norm(best, axis=(1, 2))
    assert np.percentile(off, 90) < 5e-3


@every_kind
def test_gauss_newton_is_the_normal_term(kind: int) -> None:
    x = random_stencils(20 + kind, 300)
    g = of_ipctk(kind, x)[1]
    _, hessian = pair_energy(kind, pairs.GAUSS_NEWTON, x, -3.0, 5.0)
    np.testing.assert_allclose(hessian, 5.0 * outer(g, g), atol=1e-10)
    assert not pair_energy(kind, pairs.GAUSS_NEWTON, x, -3.0, -5.0)[1].any()
    touching = pair_energy(kind, pairs.GAUSS_NEWTON, 0 * x, -1.0, 1.0)
    assert all(np.isfinite(part).all() for part in touching)


def test_nearly_parallel_edges_stay_finite_and_semidefinite() -> None:
    _, hessian = pair_energy(EDGE_EDGE, PSD_CLAMP, nearly_parallel_edges(30, 1000), -1.0, 1.0)
    values = np.linalg.eigvalsh(hessian)
    assert np.all(np.isfinite(hessian)) and np.all(values[:, 0] >= -1e-12 * values[:, -1])


# The mollifier of edges --------------------------------------------------------------------------


@wp.func
def mollifier(
    x0: wp.vec3d, x1: wp.vec3d, x2: wp.vec3d, x3: wp.vec3d, threshold: wp.float64
) -> wp.float64:
    cross_sq = mollifiers.edge_edge_cross_sq(x0, x1, x2, x3)
    return mollifiers.edge_edge_mollifier(cross_sq, threshold)


@wp.func
def mollified_terms(
    mode: wp.int32, x0: wp.vec3d, x1: wp.vec3d, x2: wp.vec3d, x3: wp.vec3d, threshold: wp.float64,
    dhat: wp.float64, stiffness: wp.float64,
):  # fmt: skip
    pair = closest(1, x0, x1, x2, x3)
    d, m = wp.sqrt(pair.distance_sq), mollifier(x0, x1, x2, x3, threshold)
    e0 = barrier.contact_potential(d, dhat, stiffness)
    e1 = barrier.contact_potential_d1(d, dhat, stiffness)
    e2 = barrier.contact_potential_d2(d, dhat, stiffness)
    gradient = pairs.mollified_gradient(pair, x0, x1, x2, x3, threshold, e0, e1)
    terms = pairs.mollifier_terms(pair, x0, x1, x2, x3, threshold, e0, e1, mode)
    h = pairs.pair_hessian(pair, x0, x1, x2, x3, m * e1, m * e2, mode)
    matrix = hessian_matrix(h)
    block_count = int(16)
    for k in range(block_count):
        first = pairs.mollifier_coefficients(pair.weights, k // 4)
        second = pairs.mollifier_coefficients(pair.weights, k % 4)
        block = pairs.mollifier_block(terms, first, second)
        for a in range(3):
            for b in range(3):
                matrix[3 * (k // 4) + a, 3 * (k % 4) + b] += block[a, b]
    return e0 * m, gradient, matrix


def mollified_energy(mode: int, x: Array, threshold: float, dhat: float, stiffness: float) -> list:
    return mapped(mollified_terms, mode, *x.swapaxes(0, 1), threshold, dhat, stiffness)


def mixed_edges(
    seed: int, count: int, angle_exponents: tuple[float, float] = (-9.0, -1.0)
) -> Array:
    """Half in general position, half nearly parallel, so that both branches occur."""
    half = count // 2
    parallel = nearly_parallel_edges(seed, half, angle_exponents)
    return np.concatenate([random_stencils(seed, half), parallel])


def test_threshold_and_mollifier_equal_ipctk() -> None:
    x = mixed_edges(0, 1000)
    rest = x + 0.01 * random_stencils(1, len(x))
    threshold = mapped(mollifiers.edge_edge_mollifier_threshold, *rest.swapaxes(0, 1))
    expected = np.array([ipctk.edge_edge_mollifier_threshold(*nodes) for nodes in rest])
    np.testing.assert_allclose(threshold, expected, rtol=1e-13)
    value = mapped(mollifier, *x.swapaxes(0, 1), threshold)
    # ipctk takes the cross product from the Gram determinant, 1e-16 off in absolute terms.
    values = [ipctk.edge_edge_mollifier(*nodes, e) for nodes, e in zip(x, expected, strict=True)]
    np.testing.assert_allclose(value, values, rtol=1e-9, atol=1e-11)
    assert np.sum(value == 1.0) > 100 and np.sum(value < 0.5) > 100


def test_mollified_energy_equals_the_product_of_ipctk() -> None:
    x, dhat, stiffness, threshold = mixed_edges(2, 600, (-2.5, -1.0)), 3.0, 2.0, 1e-2
    value, gradient, hessian = mollified_energy(PSD_NONE, x, threshold, dhat, stiffness)
    d, g, half = of_ipctk(EDGE_EDGE, x)
    p, p1, p2 = (stiffness / dhat * np.array([f(one, dhat) for one in d]) for f in BARRIERS)
    m, gm, hm = (
        np.array([getattr(ipctk, f"edge_edge_mollifier{suffix}")(*n, threshold) for n in x])
        for suffix in ("", "_gradient", "_hessian")
    )
    np.testing.assert_allclose(value, p * m, rtol=1e-8, atol=1e-11)
    slope = p[:, None] * gm + (m * p1)[:, None] * g
    assert (largest(gradient.reshape(-1, 12) - slope) / (largest(slope) + 1e-3)).max() < 1e-8
    mixed, normal = outer(gm, g) * p1[:, None, None], outer(g, g)
    expected = p[:, None, None] * hm + mixed + mixed.transpose(0, 2, 1)
    expected += (m * p2)[:, None, None] * normal + (m * p1 / d)[:, None, None] * (half - normal)
    assert (largest(hessian - expected) / (largest(expected) + 1e-3)).max() < 1e-7
    assert np.sum(m < 1) > 50 and np.sum((m == 1) & (d < dhat)) > 200
    assert np.abs(expected[m < 1]).max() > 1.0


def test_parallel_edges_have_no_energy_and_no_gradient() -> None:
    x = np.array([[[0, 0, 0], [1, 0, 0], [0.25, 0, 0.1], [0.75, 0, 0.1]]] * 2, dtype=float)
    value, gradient, hessian = mollified_energy(PSD_CLAMP, x, 1e-3, 1.0, 1.0)
    assert not value.any() and not gradient.any() and np.all(np.isfinite(hessian))
    assert np.linalg.eigvalsh(hessian[0]).max() > 1.0, "turning out of parallel costs energy"


def test_projected_mollified_hessian_is_semidefinite_and_close() -> None:
    x, threshold = mixed_edges(3, 2000), 1e-3
    exact, psd = (mollified_energy(m, x, threshold, 1.0, 1.0)[2] for m in (PSD_NONE, PSD_CLAMP))
    assert np.all(np.isfinite(psd))
    values = np.linalg.eigvalsh(psd)
    assert np.all(values[:, 0] >= -1e-10 * np.maximum(values[:, -1], 1e-300))
    best = projected(exact)
    norm = np.linalg.norm(best, axis=(1, 2))
    active = norm > 1e-9 * norm.max()
    off = np.linalg.norm(psd - best, axis=(1, 2))[active] / norm[active]
    cross = np.sum(np.cross(x[:, 1] - x[:, 0], x[:, 3] - x[:, 2]) ** 2, axis=1)
    plain = (cross >= threshold)[active]
    assert plain.sum() > 100 and (~plain).sum() > 100
    above = np.linalg.eigvalsh((psd - exact)[active][plain])[:, 0]
    assert (above > -1e-9 * norm[active][plain]).all()
    assert np.quantile(off[plain], 0.9) < 0.1  # At gaps as wide as the edges are long.
    assert np.median(off[~plain]) < 0.5
