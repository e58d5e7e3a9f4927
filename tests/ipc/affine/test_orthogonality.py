# SPDX-License-Identifier: Apache-2.0
"""Energy that keeps affine bodies rigid: values, derivatives, projections, invariance."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.ipc.elasticity.principal import PSD_CLAMP, PSD_NONE
from taccel_lab.ipc.potentials.affine import AffinePotential
from taccel_lab.scene import AffineBody, Scene, TimeStepping, box_mesh
from taccel_lab.state import initial_state
from tests.ipc.derivatives import Dense, assert_derivatives
from tests.support.turns import random_turns

SIZES = ((0.1, 0.02, 0.03), (0.04, 0.05, 0.06))
YOUNG = (1e6, 3e7)
VOLUMES = np.prod(SIZES, axis=1)


@cache
def assembly() -> Dense:
    bodies = [
        AffineBody(box_mesh(size), young_modulus_pa=young, name=str(young))
        for size, young in zip(SIZES, YOUNG, strict=True)
    ]
    # As many environments as probes of the 24 coordinates need.
    scene = Scene(affine_bodies=bodies, env_count=48, time=TimeStepping(quasi_static=False))
    model = scene.finalize()
    return Dense(model, AffinePotential(model), initial_state(model).positions.numpy()[0])


def strained(seed: int, amount: float) -> tuple[np.ndarray, np.ndarray]:
    """Linear maps [2, 3, 3] of both bodies, and their control nodes [8, 3]."""
    rng = np.random.default_rng(seed)
    maps = random_turns(rng, 2) @ (np.eye(3) + amount * rng.uniform(-1, 1, size=(2, 3, 3)))
    nodes = rng.normal(size=(2, 4, 3))
    lengths = assembly().model.affine.lengths.numpy()
    nodes[:, 1:] = lengths[:, None, None] * maps.transpose(0, 2, 1)
    return maps, nodes.reshape(8, 3)


@settings(max_examples=20)
@given(seed=st.integers(0, 2**31), amount=st.floats(1e-3, 1.5))
def test_energy_gradient_hessian_and_its_projection(seed: int, amount: float) -> None:
    found = assembly()
    maps, nodes = strained(seed, amount)
    gram = maps.transpose(0, 2, 1) @ maps - np.eye(3)
    expected = (VOLUMES * YOUNG / 8 * (gram**2).sum(axis=(1, 2))).sum()
    assert found.energy(nodes[None])[0] == pytest.approx(expected, rel=1e-10)
    matrix = found.hessian(nodes, PSD_NONE)
    least = (1e-3 * amount, 0.0)
    assert_derivatives(nodes, 1e-6, found.energy, found.gradient, matrix, least=least)
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-14 * np.abs(matrix).max())
    # Clamped eigenvalues, exactly those that numpy finds.
    values, vectors = np.linalg.eigh(matrix)
    projected = (vectors * np.maximum(values, 0)) @ vectors.T
    off = 1e-9 * np.abs(matrix).max()
    np.testing.assert_allclose(found.hessian(nodes, PSD_CLAMP), projected, atol=off)


@given(seed=st.integers(0, 2**31))
def test_rotations_cost_nothing(seed: int) -> None:
    nodes, found = strained(seed, 0.0)[1], assembly()
    size = YOUNG[1] * VOLUMES[1]
    assert found.energy(nodes[None])[0] < 1e-28 * size
    assert np.abs(found.gradient(nodes[None])).max() < 1e-14 * size / 0.02
    # Turns and shifts of each body, 6 of 12, are free; all others are not.
    values = np.linalg.eigvalsh(found.hessian(nodes, PSD_CLAMP))
    assert (np.abs(values[:12]) < 1e-9 * values[-1]).all()
    assert (values[12:] > 1e-4 * values[-1]).all()
