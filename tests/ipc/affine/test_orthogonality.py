# SPDX-License-Identifier: Apache-2.0
"""Energy that keeps affine bodies rigid: values, derivatives, projections, invariance."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.bodies.bodies import AffineBody
from taccel_lab.bodies.primitives import box_mesh
from taccel_lab.bodies.scene_description import TimeStepping
from taccel_lab.ipc.elasticity.principal import PSD_CLAMP, PSD_NONE
from taccel_lab.ipc.potentials.affine import AffinePotential
from taccel_lab.scene import Scene
from taccel_lab.state import initial_state
from tests.ipc.dense_system import Dense, differences
from tests.support.turns import random_turns

SIZES = ((0.1, 0.02, 0.03), (0.04, 0.05, 0.06))
YOUNG = (1e6, 3e7)


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


def controls(maps: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Control nodes of both bodies at linear maps [2, 3, 3], shape [8, 3]."""
    lengths = assembly().model.affine.lengths.numpy()
    nodes = np.zeros((2, 4, 3))
    nodes[:, 0] = rng.normal(size=(2, 3))
    nodes[:, 1:] = lengths[:, None, None] * maps.transpose(0, 2, 1)
    return nodes.reshape(8, 3)


def strained(seed: int, amount: float) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    maps = random_turns(rng, 2) @ (np.eye(3) + amount * rng.uniform(-1, 1, size=(2, 3, 3)))
    return maps, controls(maps, rng)


def expected_energy(maps: np.ndarray) -> float:
    gram = maps.transpose(0, 2, 1) @ maps - np.eye(3)
    volumes = np.prod(SIZES, axis=1)
    return float((volumes * YOUNG / 8 * (gram**2).sum(axis=(1, 2))).sum())


@settings(max_examples=20)
@given(seed=st.integers(0, 2**31), amount=st.floats(1e-3, 1.5))
def test_energy_gradient_and_hessian(seed: int, amount: float) -> None:
    found = assembly()
    maps, nodes = strained(seed, amount)
    assert found.energy(nodes[None])[0] == pytest.approx(expected_energy(maps), rel=1e-10)
    step = 1e-6
    gradient = found.gradient(nodes[None])[0]
    scale = np.abs(gradient).max()
    assert scale > 1e-3 * amount
    slope = differences(found.energy, nodes, step).reshape(8, 3)
    np.testing.assert_allclose(gradient, slope, atol=1e-6 * scale)
    matrix = found.hessian(nodes, PSD_NONE)
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-14 * np.abs(matrix).max())
    change = differences(found.gradient, nodes, step).reshape(24, 24)
    np.testing.assert_allclose(matrix, change, atol=1e-6 * np.abs(matrix).max())


@settings(max_examples=20)
@given(seed=st.integers(0, 2**31), amount=st.floats(1e-3, 1.5))
def test_projection(seed: int, amount: float) -> None:
    """Clamped eigenvalues, exactly those that numpy finds."""
    found = assembly()
    nodes = strained(seed, amount)[1]
    exact = found.hessian(nodes, PSD_NONE)
    scale = np.abs(exact).max()
    values, vectors = np.linalg.eigh(exact)
    expected = (vectors * np.maximum(values, 0)) @ vectors.T
    np.testing.assert_allclose(found.hessian(nodes, PSD_CLAMP), expected, atol=1e-9 * scale)


@given(seed=st.integers(0, 2**31))
def test_rotations_cost_nothing(seed: int) -> None:
    rng = np.random.default_rng(seed)
    maps = random_turns(rng, 2)
    nodes = controls(maps, rng)
    found = assembly()
    size = YOUNG[1] * np.prod(SIZES[1])
    assert found.energy(nodes[None])[0] < 1e-28 * size
    assert np.abs(found.gradient(nodes[None])).max() < 1e-14 * size / 0.02
    # Turns and shifts of each body, 6 of 12, are free; all others are not.
    values = np.linalg.eigvalsh(found.hessian(nodes, PSD_CLAMP))
    assert (np.abs(values[:12]) < 1e-9 * values[-1]).all()
    assert (values[12:] > 1e-4 * values[-1]).all()
