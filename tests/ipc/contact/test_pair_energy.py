# SPDX-License-Identifier: Apache-2.0
"""The energy of a pair: barrier, derivatives by its nodes, projection, mollifier; against ipctk."""

from __future__ import annotations

import ipctk
import numpy as np
import pytest

from taccel_lab.ipc.contact.pair_energy import GAUSS_NEWTON
from taccel_lab.ipc.elasticity.principal import PSD_CLAMP, PSD_NONE
from tests.ipc import batch
from tests.ipc.batch import Array
from tests.ipc.stencils import nearly_parallel_edges, random_stencils

KINDS = {
    "point_triangle": (batch.POINT_TRIANGLE, 4),
    "edge_edge": (batch.EDGE_EDGE, 4),
    "point_edge": (batch.POINT_EDGE, 3),
    "point_point": (batch.POINT_POINT, 2),
}


# The barrier ---------------------------------------------------------------------------------


def test_the_barrier_equals_ipctk() -> None:
    rng = np.random.default_rng(0)
    dhat = 10.0 ** rng.uniform(-6, 0, 2000)
    d = dhat * 10.0 ** rng.uniform(-8, 0.2, 2000)
    ipc_form, _ = batch.barrier(d, dhat)
    pairs = list(zip(d, dhat, strict=True))
    functions = (ipctk.barrier, ipctk.barrier_first_derivative, ipctk.barrier_second_derivative)
    active = d < dhat
    assert 0 < active.sum() < len(d)
    assert np.all(ipc_form[~active] == 0.0)
    for column, function in enumerate(functions):
        expected = np.array([function(*pair) for pair in pairs])
        scale = dhat ** (2 - column)
        np.testing.assert_allclose(
            ipc_form[:, column] / scale, expected / scale, rtol=1e-11, atol=1e-14
        )
    assert np.all(ipc_form[active, 1] < 0.0) and np.all(ipc_form[active, 2] > 0.0)


def test_contact_potential_is_the_scaled_barrier() -> None:
    dhat, stiffness = 2e-4, 3.7
    d = dhat * np.linspace(0.01, 1.1, 50)
    ipc_form, potential = batch.barrier(d, dhat, stiffness)
    np.testing.assert_allclose(potential, ipc_form * stiffness / dhat, rtol=1e-13)
    # Pressure depends on d / dhat alone: force at half the distance of half the dhat is equal.
    _, halved = batch.barrier(d / 2, dhat / 2, stiffness)
    np.testing.assert_allclose(halved[:, 1], potential[:, 1], rtol=1e-13)


# Derivatives of an energy of the distance ------------------------------------------------------


def of_ipctk(name: str, x: Array) -> tuple[Array, Array, Array]:
    """Distances, gradients [n, 12], and half the Hessians of the squares [n, 12, 12]."""
    count = KINDS[name][1]
    d, gradients, halves = np.zeros(len(x)), np.zeros((len(x), 12)), np.zeros((len(x), 12, 12))
    size = 3 * count
    for i, nodes in enumerate(x[:, :count]):
        d[i] = getattr(ipctk, f"{name}_distance")(*nodes) ** 0.5
        gradients[i, :size] = getattr(ipctk, f"{name}_distance_gradient")(*nodes) / (2 * d[i])
        halves[i, :size, :size] = getattr(ipctk, f"{name}_distance_hessian")(*nodes) / 2
    return d, gradients, halves


def outer(a: Array, b: Array) -> Array:
    return a[:, :, None] * b[:, None, :]


def chain_rule(name: str, x: Array, e1: Array, e2: Array) -> Array:
    """12x12 Hessian of E(d)."""
    d, g, half = of_ipctk(name, x)
    normal = outer(g, g)
    return e2[:, None, None] * normal + (e1 / d)[:, None, None] * (half - normal)


def projected(hessian: Array) -> Array:
    values, vectors = np.linalg.eigh(hessian)
    return (vectors * np.maximum(values, 0.0)[:, None, :]) @ vectors.transpose(0, 2, 1)


def relative_error(ours: Array, expected: Array) -> Array:
    return np.abs(ours - expected).max(axis=(1, 2)) / np.abs(expected).max(axis=(1, 2))


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("signs", [(-1, 1), (1, -1), (1, 1), (-1, -1)])
def test_exact_and_projected(name: str, signs: tuple[int, int]) -> None:
    kind, _ = KINDS[name]
    x = random_stencils(10 + kind, 500)
    rng = np.random.default_rng(0)
    e1 = signs[0] * 10.0 ** rng.uniform(-2, 2, len(x))
    e2 = signs[1] * 10.0 ** rng.uniform(-2, 2, len(x))
    expected = chain_rule(name, x, e1, e2)
    gradient, exact = batch.pair_energy(kind, PSD_NONE, x, e1, e2)
    assert relative_error(exact, expected).max() < 1e-9
    unit = of_ipctk(name, x)[1].reshape(-1, 4, 3)
    np.testing.assert_allclose(gradient / e1[:, None, None], unit, atol=1e-11)
    if name != "point_point" or min(signs) < 0:
        assert np.linalg.eigvalsh(expected).min() < -1e-3, "nothing to project"

    _, psd = batch.pair_energy(kind, PSD_CLAMP, x, e1, e2)
    np.testing.assert_allclose(psd, psd.transpose(0, 2, 1), atol=1e-12 * np.abs(psd).max())
    scale = np.abs(expected).max(axis=(1, 2))
    assert (np.linalg.eigvalsh(psd)[:, 0] > -1e-12 * scale).all()
    assert (np.linalg.eigvalsh(psd - expected)[:, 0] > -1e-9 * scale).all(), "not above the whole"


@pytest.mark.parametrize("name", ["point_edge", "point_point"])
@pytest.mark.parametrize("e1", [-3.0, 2.0])
def test_terms_that_are_orthogonal_are_projected_as_the_whole(name: str, e1: float) -> None:
    """Along an edge and across it; only what a third term shares with them is counted twice."""
    kind, _ = KINDS[name]
    x = random_stencils(50 + kind, 500)
    slopes, none = np.full(len(x), e1), np.zeros(len(x))
    expected = chain_rule(name, x, slopes, none)
    _, psd = batch.pair_energy(kind, PSD_CLAMP, x, slopes, none)
    off = np.abs(psd - projected(expected)).max(axis=(1, 2)) / np.abs(expected).max(axis=(1, 2))
    assert off.max() < 1e-9
    if name == "point_edge" or e1 > 0:
        assert np.median(np.linalg.eigvalsh(psd)[:, -1]) > 1e-3, "nothing is left"


@pytest.mark.parametrize("name", KINDS)
def test_near_contact_the_sum_of_projections_is_that_of_the_whole(name: str) -> None:
    """A barrier at a hundredth of the features' size: off by a few parts in a thousand."""
    kind, _ = KINDS[name]
    x = random_stencils(60 + kind, 1000)
    d, unit, _ = of_ipctk(name, x)
    first = 2 if name == "edge_edge" else 1
    normal = unit.reshape(-1, 4, 3)[:, :first].sum(axis=1)
    x[:, :first] -= (0.99 * d)[:, None, None] * normal[:, None]
    d = np.sqrt(batch.query_pairs(kind, x).distance_sq)
    assert d.max() < 0.1
    _, psd = batch.pair_energy(kind, PSD_CLAMP, x, -1 / d, 1 / d**2)
    best = projected(chain_rule(name, x, -1 / d, 1 / d**2))
    off = np.linalg.norm(psd - best, axis=(1, 2)) / np.linalg.norm(best, axis=(1, 2))
    assert np.percentile(off, 90) < 5e-3


@pytest.mark.parametrize("name", KINDS)
def test_gauss_newton_is_the_normal_term(name: str) -> None:
    kind, _ = KINDS[name]
    x = random_stencils(20 + kind, 300)
    g = of_ipctk(name, x)[1]
    _, hessian = batch.pair_energy(kind, GAUSS_NEWTON, x, -3.0, 5.0)
    np.testing.assert_allclose(hessian, 5.0 * outer(g, g), atol=1e-10)
    _, hessian = batch.pair_energy(kind, GAUSS_NEWTON, x, -3.0, -5.0)
    assert np.all(hessian == 0.0)
    touching = batch.pair_energy(kind, GAUSS_NEWTON, np.zeros((1, 4, 3)), -1.0, 1.0)
    assert all(np.isfinite(part).all() for part in touching)


def test_nearly_parallel_edges_stay_finite_and_semidefinite() -> None:
    x = nearly_parallel_edges(30, 1000)
    _, hessian = batch.pair_energy(batch.EDGE_EDGE, PSD_CLAMP, x, -1.0, 1.0)
    assert np.all(np.isfinite(hessian))
    values = np.linalg.eigvalsh(hessian)
    assert np.all(values[:, 0] >= -1e-12 * values[:, -1])


# The mollifier of edges --------------------------------------------------------------------------


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
    threshold, value = batch.mollifier(x, rest)
    expected = np.array([ipctk.edge_edge_mollifier_threshold(*nodes) for nodes in rest])
    np.testing.assert_allclose(threshold, expected, rtol=1e-13)
    # ipctk takes the cross product from the Gram determinant, 1e-16 off in absolute terms.
    values = [ipctk.edge_edge_mollifier(*nodes, e) for nodes, e in zip(x, expected, strict=True)]
    np.testing.assert_allclose(value, values, rtol=1e-9, atol=1e-11)
    assert np.sum(value == 1.0) > 100 and np.sum(value < 0.5) > 100


def test_mollified_energy_equals_the_product_of_ipctk() -> None:
    """P(d) m, its gradient and its Hessian by the product rule."""
    x, dhat, stiffness, threshold = mixed_edges(2, 600, (-2.5, -1.0)), 3.0, 2.0, 1e-2
    value, gradient, hessian = batch.mollified_energy(PSD_NONE, dhat, stiffness, x, threshold)
    d, g, half = of_ipctk("edge_edge", x)
    functions = (ipctk.barrier, ipctk.barrier_first_derivative, ipctk.barrier_second_derivative)
    p, p1, p2 = (stiffness / dhat * np.array([f(one, dhat) for one in d]) for f in functions)
    m = np.array([ipctk.edge_edge_mollifier(*nodes, threshold) for nodes in x])
    gm = np.array([ipctk.edge_edge_mollifier_gradient(*nodes, threshold) for nodes in x])
    hm = np.array([ipctk.edge_edge_mollifier_hessian(*nodes, threshold) for nodes in x])
    np.testing.assert_allclose(value, p * m, rtol=1e-8, atol=1e-11)
    slope = p[:, None] * gm + (m * p1)[:, None] * g
    scale = np.abs(slope).max(axis=1) + 1e-3
    assert (np.abs(gradient.reshape(-1, 12) - slope).max(axis=1) / scale).max() < 1e-8
    mixed = outer(gm, g) * p1[:, None, None]
    normal = outer(g, g)
    expected = p[:, None, None] * hm + mixed + mixed.transpose(0, 2, 1)
    expected += (m * p2)[:, None, None] * normal + (m * p1 / d)[:, None, None] * (half - normal)
    scale = np.abs(expected).max(axis=(1, 2)) + 1e-3
    assert (np.abs(hessian - expected).max(axis=(1, 2)) / scale).max() < 1e-7
    assert np.sum(m < 1) > 50 and np.sum((m == 1) & (d < dhat)) > 200
    assert np.abs(expected[m < 1]).max() > 1.0


def test_parallel_edges_have_no_energy_and_no_gradient() -> None:
    x = np.array([[[0, 0, 0], [1, 0, 0], [0.25, 0, 0.1], [0.75, 0, 0.1]]], dtype=float)
    value, gradient, hessian = batch.mollified_energy(PSD_CLAMP, 1.0, 1.0, x, 1e-3)
    assert value[0] == 0.0
    assert np.all(gradient == 0.0)
    assert np.all(np.isfinite(hessian))
    assert np.linalg.eigvalsh(hessian[0]).max() > 1.0, "turning out of parallel costs energy"


def test_projected_mollified_hessian_is_semidefinite_and_close() -> None:
    x = mixed_edges(3, 2000)
    dhat, threshold = 1.0, 1e-3
    exact = batch.mollified_energy(PSD_NONE, dhat, 1.0, x, threshold)[2]
    psd = batch.mollified_energy(PSD_CLAMP, dhat, 1.0, x, threshold)[2]
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
