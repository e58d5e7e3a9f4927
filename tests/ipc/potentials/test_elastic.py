# SPDX-License-Identifier: Apache-2.0
"""Elastic energy of a mesh: gradient and matrix against finite differences, projection, momenta."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.ipc.elasticity.neo_hookean import PSD_ABS, PSD_CLAMP, PSD_NONE
from taccel_lab.solvers.config import SolverConfig
from tests.verification.assembly import Assembly, central_difference, coordinate_probe
from tests.verification.blocks import block_mesh, scene

STEP = 1e-8
CELLS, SIZE = (2, 2, 1), (2e-3, 2e-3, 1e-3)


def deformed(x: np.ndarray, seed: int, amount: float) -> np.ndarray:
    """Random nodal motion of ``amount`` [m] plus a rotation and a stretch."""
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    return (x * [1.1, 0.95, 0.9]) @ turn.T + rng.uniform(-amount, amount, x.shape)


def probing_assembly(rest: np.ndarray) -> Assembly:
    """One environment for each probe of each coordinate, all with the rest shape ``rest``."""
    mesh = block_mesh(CELLS, SIZE)
    count = 6 * mesh.node_count
    made = scene(mesh, env_count=count, rest_m=np.repeat(rest[None], count, axis=0))
    return Assembly(made.finalize(), SolverConfig(), np.zeros((count, 0, 7)))


@pytest.mark.parametrize("seed", [0, 1])
def test_gradient_and_hessian_are_the_derivatives(seed: int) -> None:
    rest = block_mesh(CELLS, SIZE, jitter=0.2, seed=seed).nodes_m
    assembly = probing_assembly(rest)
    x = deformed(rest, seed, 2e-5)
    probes = coordinate_probe(x, np.arange(len(x)), STEP)

    gradient = assembly.elastic_gradient(np.repeat(x[None], len(probes), axis=0))[0]
    slope = central_difference(assembly.elastic_energy(probes), STEP).reshape(-1, 3)
    assert np.abs(gradient).max() > 1e-3
    np.testing.assert_allclose(gradient, slope, atol=1e-6 * np.abs(gradient).max())

    free = assembly.free
    hessian = assembly.elastic_hessian(np.repeat(x[None], len(probes), axis=0), PSD_NONE)[0]
    change = central_difference(assembly.elastic_gradient(probes), STEP)
    change = change.reshape(len(x), 3, len(x), 3)[free][:, :, free].reshape(hessian.shape)
    assert np.abs(hessian).max() > 1
    np.testing.assert_allclose(hessian, change, atol=1e-6 * np.abs(hessian).max())
    np.testing.assert_allclose(hessian, hessian.T, atol=1e-12 * np.abs(hessian).max())


def test_environments_use_their_own_rest_shape() -> None:
    mesh = block_mesh(CELLS, SIZE)
    rests = np.stack([block_mesh(CELLS, SIZE, 0.2, seed).nodes_m for seed in range(3)])
    assembly = Assembly(
        scene(mesh, env_count=3, rest_m=rests).finalize(), SolverConfig(), np.zeros((3, 0, 7))
    )
    at_rest = assembly.elastic_energy(rests)
    shuffled = assembly.elastic_energy(rests[[1, 2, 0]])
    assert np.abs(at_rest).max() < 1e-12 * shuffled.min()
    alone = Assembly(scene(mesh, rest_m=rests[2:]).finalize(), SolverConfig(), np.zeros((1, 0, 7)))
    assert alone.elastic_energy(rests[:1])[0] == shuffled[2]
    np.testing.assert_array_equal(
        alone.elastic_gradient(rests[:1])[0], assembly.elastic_gradient(rests[[1, 2, 0]])[2]
    )


@pytest.mark.parametrize("mode", [PSD_CLAMP, PSD_ABS])
def test_projected_matrix_is_positive_and_differs_where_it_must(mode: int) -> None:
    mesh = block_mesh((3, 3, 2), (3e-3, 3e-3, 2e-3), 0.2)
    assembly = Assembly(scene(mesh).finalize(), SolverConfig(), np.zeros((1, 0, 7)))
    # A compressed block: without projection the matrix is indefinite.
    x = (deformed(mesh.nodes_m, 3, 1e-4) * 0.7)[None]
    exact = assembly.elastic_hessian(x, PSD_NONE)[0]
    projected = assembly.elastic_hessian(x, mode)[0]
    scale = np.abs(exact).max()
    assert np.linalg.eigvalsh(exact)[0] < -1e-3 * scale
    assert np.linalg.eigvalsh(projected)[0] > 0
    assert np.linalg.eigvalsh(projected - exact)[0] > -1e-10 * scale


def test_internal_forces_have_no_resultant() -> None:
    mesh = block_mesh((3, 3, 2), (3e-3, 3e-3, 2e-3), 0.2)
    assembly = Assembly(scene(mesh).finalize(), SolverConfig(), np.zeros((1, 0, 7)))
    x = deformed(mesh.nodes_m, 5, 1e-4)
    gradient = assembly.elastic_gradient(x[None])[0]
    scale = np.abs(gradient).sum()
    np.testing.assert_allclose(gradient.sum(axis=0), 0, atol=1e-13 * scale)
    moment = np.cross(x, gradient).sum(axis=0)
    np.testing.assert_allclose(moment, 0, atol=1e-13 * scale * np.abs(x).max())


def test_inverted_tet_has_infinite_energy() -> None:
    mesh = block_mesh(CELLS, SIZE)
    assembly = Assembly(scene(mesh).finalize(), SolverConfig(), np.zeros((1, 0, 7)))
    x = mesh.nodes_m.copy()
    x[np.argmax(x[:, 2])] -= [0, 0, 3e-3]
    assert np.isposinf(assembly.elastic_energy(x[None])[0])


@pytest.mark.parametrize("strain", [1e-3, 1e-6, 1e-9])
def test_energy_of_a_small_strain_keeps_its_digits(strain: float) -> None:
    """The line search compares changes of the energy that are small against E * volume."""
    mesh = block_mesh(CELLS, SIZE)
    made = scene(mesh, young_pa=1e5, poisson=0.3)
    assembly = Assembly(made.finalize(), SolverConfig(), np.zeros((1, 0, 7)))
    x = mesh.nodes_m + strain * mesh.nodes_m * [1, 0, 0]
    material = made.soft_body.material
    modulus = material.lame_lambda_pa + 2 * material.shear_modulus_pa
    linear = 0.5 * modulus * strain**2 * np.prod(SIZE)
    # The next order of the energy is of relative size strain; F = I + H keeps 1e-16 / strain.
    assert assembly.elastic_energy(x[None])[0] == pytest.approx(
        linear, rel=2 * strain + 1e-14 / strain
    )
