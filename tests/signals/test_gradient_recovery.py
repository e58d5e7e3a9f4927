# SPDX-License-Identifier: Apache-2.0
"""The relaxed minimum-norm gradients against a direct solve of the same network."""

from __future__ import annotations

import numpy as np
import warp as wp
from scipy.optimize import minimize

from taccel_lab.signals import ContactSurface
from taccel_lab.signals.gradient_recovery import FEW_SWEEPS, SWEEPS, recover_gradients
from tests.signals.pressed_surface import flat_pad


def _bending(gradients: np.ndarray, edges: np.ndarray, xy: np.ndarray, f: np.ndarray) -> float:
    """Sum over edges of the integral of f''^2 of the Hermite cubic, by Gauss points."""
    edge = xy[edges[:, 1]] - xy[edges[:, 0]]
    length = np.linalg.norm(edge, axis=1)
    start = (gradients[edges[:, 0]] * edge).sum(axis=1)
    end = (gradients[edges[:, 1]] * edge).sum(axis=1)
    rise = f[edges[:, 1]] - f[edges[:, 0]]
    total = 0.0
    for t in (0.5 - np.sqrt(1 / 12), 0.5 + np.sqrt(1 / 12)):
        second = rise * (6 - 12 * t) + start * (6 * t - 4) + end * (6 * t - 2)
        total += float((0.5 * second**2 / length**3).sum())
    return total


def test_the_network_of_least_bending_is_found():
    mesh = flat_pad(1.0, (2.5, 2.5), seed=4)
    surface = ContactSurface.from_mesh(mesh)
    # Millimetres, so that the optimiser sees numbers near one.
    points = mesh.nodes_m[surface.node_idx] * 1e3
    values = np.random.default_rng(0).normal(size=len(points))
    device = "cpu"
    gradients = recover_gradients(
        wp.array(points[None], dtype=wp.vec3d, device=device),
        wp.array(values[None], dtype=wp.float64, device=device),
        wp.array(surface.ring_start, dtype=wp.int32, device=device),
        wp.array(surface.ring_nodes, dtype=wp.int32, device=device),
    ).numpy()[0]

    def energy(flat: np.ndarray) -> float:
        return _bending(flat.reshape(-1, 2), surface.edges, points[:, :2], values)

    best = minimize(energy, np.zeros(2 * len(points)), method="L-BFGS-B", options={"maxfun": 10**6})
    assert energy(gradients.ravel()) <= best.fun * (1 + 1e-9)
    assert np.abs(gradients - best.x.reshape(-1, 2)).max() < 1e-2
    assert np.abs(gradients).max() > 0.5


def test_neighbourhoods_hold_the_edges():
    surface = ContactSurface.from_faces(np.array([[10, 11, 12], [12, 11, 13]]))
    assert surface.node_idx.tolist() == [10, 11, 12, 13]
    assert surface.edges.tolist() == [[0, 1], [0, 2], [1, 2], [1, 3], [2, 3]]
    ring = [
        surface.ring_nodes[a:b].tolist()
        for a, b in zip(surface.ring_start[:-1], surface.ring_start[1:], strict=True)
    ]
    assert ring == [[1, 2], [0, 2, 3], [0, 1, 3], [1, 2]]


def test_sweeps_divide_the_error_as_chebyshev_promises():
    mesh = flat_pad(0.5, (2.5, 2.5), seed=4)
    surface = ContactSurface.from_mesh(mesh)
    points = wp.array(mesh.nodes_m[surface.node_idx][None], dtype=wp.vec3d, device="cpu")
    values = np.random.default_rng(0).normal(size=points.shape)
    field = wp.array(values, dtype=wp.float64, device="cpu")
    ring = [
        wp.array(part, dtype=wp.int32, device="cpu")
        for part in (surface.ring_start, surface.ring_nodes)
    ]

    def gradients(sweeps: int) -> np.ndarray:
        return recover_gradients(points, field, *ring, sweeps=sweeps).numpy()

    converged = gradients(60)
    for sweeps in (2, 5, FEW_SWEEPS, SWEEPS):
        # T_k(2) bounds the energy norm; a factor of ten for single nodes.
        bound = 10 / np.cosh(sweeps * np.arccosh(2.0)) * np.abs(converged).max()
        assert np.abs(gradients(sweeps) - converged).max() < bound
    assert np.abs(gradients(4) - converged).max() > 1e-6 * np.abs(converged).max()
