# SPDX-License-Identifier: Apache-2.0
"""Edge-edge mollifier and the mollified energy."""

from __future__ import annotations

import ipctk
import numpy as np

from taccel_lab.ipc.elasticity.principal import PSD_CLAMP, PSD_NONE
from tests.ipc import batch
from tests.ipc.batch import Array
from tests.ipc.stencils import nearly_parallel_edges, random_stencils


def perturbed(x: Array, step: float) -> Array:
    shifts = step * np.stack([np.eye(12), -np.eye(12)]).reshape(2, 12, 4, 3)
    return (x[:, None, None] + shifts).reshape(-1, 4, 3)


def mixed_edges(
    seed: int, count: int, angle_exponents: tuple[float, float] = (-9.0, -1.0)
) -> Array:
    """Half in general position, half nearly parallel, so that both branches occur."""
    half = count // 2
    parallel = nearly_parallel_edges(seed, half, angle_exponents)
    return np.concatenate([random_stencils(seed, half), parallel])


def test_equals_ipctk() -> None:
    x = mixed_edges(0, 1000)
    rest = x + 0.01 * random_stencils(1, len(x))
    threshold, value, gradient, hessian = batch.mollifier(x, rest)
    for i, nodes in enumerate(x):
        eps = ipctk.edge_edge_mollifier_threshold(*rest[i])
        np.testing.assert_allclose(threshold[i], eps, rtol=1e-13)
        # ipctk takes the cross product from the Gram determinant, 1e-16 off in absolute terms.
        np.testing.assert_allclose(value[i], ipctk.edge_edge_mollifier(*nodes, eps), rtol=1e-9,
                                   atol=1e-11)  # fmt: skip
        expected = ipctk.edge_edge_mollifier_gradient(*nodes, eps)
        np.testing.assert_allclose(gradient[i].ravel(), expected, rtol=1e-8, atol=1e-9)
        expected = ipctk.edge_edge_mollifier_hessian(*nodes, eps)
        np.testing.assert_allclose(
            hessian[i], expected, rtol=1e-8, atol=1e-8 * np.abs(expected).max()
        )
    assert np.sum(value == 1.0) > 100
    assert np.sum(value < 0.5) > 100
    assert np.abs(gradient).max() > 1.0


def test_parallel_edges_have_no_energy_and_no_gradient() -> None:
    x = np.array([[[0, 0, 0], [1, 0, 0], [0.25, 0, 0.1], [0.75, 0, 0.1]]], dtype=float)
    value, gradient, hessian = batch.mollified_energy(PSD_CLAMP, 1.0, 1.0, x, 1e-3)
    assert value[0] == 0.0
    assert np.all(gradient == 0.0)
    assert np.all(np.isfinite(hessian))
    assert np.linalg.eigvalsh(hessian[0]).max() > 1.0, "turning out of parallel costs energy"


def test_mollified_energy_equals_finite_differences() -> None:
    x = mixed_edges(2, 600, (-2.5, -1.0))
    dhat, stiffness, threshold, step = 3.0, 2.0, 1e-2, 1e-7
    _, gradient, hessian = batch.mollified_energy(PSD_NONE, dhat, stiffness, x, threshold)
    moved = perturbed(x, step)
    value_near, gradient_near, _ = batch.mollified_energy(
        PSD_NONE, dhat, stiffness, moved, threshold
    )
    pairs, near = batch.query_pairs(batch.EDGE_EDGE, x), batch.query_pairs(batch.EDGE_EDGE, moved)
    cross = np.sum(np.cross(x[:, 1] - x[:, 0], x[:, 3] - x[:, 2]) ** 2, axis=1)
    # Where the region or the branch of the mollifier changes nearby there is no second derivative.
    steady = np.all(near.region.reshape(-1, 24) == pairs.region[:, None], axis=1)
    steady &= np.abs(cross / threshold - 1.0) > 1e-4
    steady &= pairs.distance_sq > 1e-3
    mollified = steady & (cross < threshold)
    assert mollified.sum() > 50
    assert (steady & ~mollified).sum() > 200

    values = value_near.reshape(-1, 2, 12)
    slope = (values[:, 0] - values[:, 1]) / (2 * step)
    scale = np.abs(slope).max(axis=1) + 1e-3
    error = np.abs(gradient.reshape(-1, 12) - slope).max(axis=1) / scale
    assert error[steady].max() < 1e-5

    slopes = gradient_near.reshape(-1, 2, 12, 12)
    curvature = (slopes[:, 0] - slopes[:, 1]) / (2 * step)
    scale = np.abs(curvature).max(axis=(1, 2)) + 1e-3
    error = np.abs(hessian - curvature).max(axis=(1, 2)) / scale
    assert error[steady].max() < 1e-4
    assert np.median(error[mollified]) < 1e-6
    assert np.abs(curvature[mollified]).max() > 1.0


def test_projected_hessian_is_semidefinite_and_close() -> None:
    x = mixed_edges(3, 2000)
    dhat, threshold = 1.0, 1e-3
    exact = batch.mollified_energy(PSD_NONE, dhat, 1.0, x, threshold)[2]
    psd = batch.mollified_energy(PSD_CLAMP, dhat, 1.0, x, threshold)[2]
    assert np.all(np.isfinite(psd))
    values = np.linalg.eigvalsh(psd)
    assert np.all(values[:, 0] >= -1e-10 * np.maximum(values[:, -1], 1e-300))

    cross = np.sum(np.cross(x[:, 1] - x[:, 0], x[:, 3] - x[:, 2]) ** 2, axis=1)
    lowest, vectors = np.linalg.eigh(exact)
    best = (vectors * np.maximum(lowest, 0.0)[:, None, :]) @ vectors.transpose(0, 2, 1)
    norm = np.linalg.norm(best, axis=(1, 2))
    active = norm > 1e-9 * norm.max()
    difference = np.linalg.norm(psd - best, axis=(1, 2))[active] / norm[active]
    plain = (cross >= threshold)[active]
    assert plain.sum() > 100
    assert (~plain).sum() > 100
    above = np.linalg.eigvalsh((psd - exact)[active][plain])[:, 0]
    assert (above > -1e-9 * norm[active][plain]).all()
    assert np.quantile(difference[plain], 0.9) < 0.1  # At gaps as wide as the edges are long.
    print("mollified, relative to the true projection: median", np.median(difference[~plain]),
          "90 %", np.quantile(difference[~plain], 0.9), "max", difference.max())  # fmt: skip
    assert np.median(difference[~plain]) < 0.5
