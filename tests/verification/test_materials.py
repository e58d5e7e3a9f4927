# SPDX-License-Identifier: Apache-2.0
"""Materials in solved scenes: bars, shear, bodies of two materials, presses."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import warp as wp
from scipy.optimize import brentq

from taccel_lab.benchmarks.stress.balance import ElasticLaw
from taccel_lab.scene import Material, MaterialField, MaterialModel, Scene, SoftBody
from tests.support.blocks import block_mesh, labelled
from tests.support.scene_steps import Stepped, linear
from tests.verification.elements import ElementForces

YOUNG, NU, RATIO = 1.3e5, 0.42, 0.3
MU, LAM = YOUNG / (2 * (1 + NU)), YOUNG * NU / ((1 + NU) * (1 - 2 * NU))
SIZE = (3e-3, 2e-3, 2e-3)
MODELS = list(MaterialModel)


def material(model: MaterialModel) -> Material:
    ratio = RATIO if model is MaterialModel.MOONEY_RIVLIN else 0.0
    return Material(YOUNG, NU, model=model, mooney_ratio=ratio)


def principal_stress(model: MaterialModel) -> Callable[[float, float, float], float]:
    """First Piola-Kirchhoff stress [Pa] along the first of three stretches, by the formulas of the
    stress suite's referee."""
    ratio = material(model).mooney_ratio
    law = ElasticLaw(model, *map(np.float64, (MU, LAM, ratio)))
    return lambda s, t, w: float(law.piola(np.diag([s, t, w]), law.lam)[0, 0])


def solved(body: SoftBody, target: np.ndarray) -> tuple[np.ndarray, ElementForces]:
    """Equilibrium with the bonded nodes at ``target``; the others start off it."""
    run, held = Stepped(Scene(body), absolute_tolerance_n=1e-13), body.bonded()
    start = target + np.random.default_rng(0).uniform(-2e-5, 2e-5, target.shape)
    start[held] = target[held]
    run.state.positions = wp.array(start[None], dtype=wp.vec3d)
    assert run.step().newton_iterations[0] > 1
    return run.x(), ElementForces(run.model)


@pytest.mark.parametrize(
    ("model", "stretch"),
    [
        *[(model, stretch) for model in MODELS for stretch in (0.8, 1.001, 1.3, 1.7)],
        *[(MaterialModel.NEO_HOOKEAN, stretch) for stretch in (0.5, 2.0)],
    ],
)
def test_uniaxial_stretch_with_free_sides(model: MaterialModel, stretch: float) -> None:
    mesh = block_mesh((3, 3, 3), SIZE, jitter=0.2, seed=1)
    law = principal_stress(model)
    w = float(brentq(lambda w: law(w, w, stretch), 0.4, 2.0, xtol=1e-15))
    stress = law(stretch, w, w)
    x0 = mesh.nodes_m[:, 0]
    end = x0 > x0.max() - 1e-9
    held = np.flatnonzero(end | (x0 < x0.min() + 1e-9))
    target = mesh.nodes_m * [stretch, w, w]
    x, forces = solved(linear(mesh, material(model), bonded_nodes=held), target)
    np.testing.assert_allclose(x, target, atol=1e-9 * SIZE[0])
    pull = forces.gradient(x[None])[0, end].sum(axis=0)
    area = SIZE[1] * SIZE[2]
    assert pull[0] == pytest.approx(stress * area, rel=1e-8)
    assert np.abs(pull[1:]).max() < 1e-9 * MU * area
    if stretch == 1.001:
        # The slope at rest is Young's modulus, the contraction Poisson's ratio.
        assert stress / 1e-3 == pytest.approx(YOUNG, rel=3e-3)
        assert (1 - w) / 1e-3 == pytest.approx(NU, rel=3e-3)


@pytest.mark.parametrize("model", MODELS)
def test_a_body_of_two_materials_is_the_sum_of_two_bodies(model: MaterialModel) -> None:
    mesh = block_mesh((3, 3, 4), SIZE, jitter=0.2, seed=3)
    upper = mesh.nodes_m[mesh.tets].mean(axis=1)[:, 2] > -1e-3
    mooney = model is MaterialModel.MOONEY_RIVLIN
    halves = [
        Material(1e5, 0.3, 900.0, model, 0.1 if mooney else 0.0),
        Material(4e5, 0.45, 1500.0, model, 0.4 if mooney else 0.0),
    ]

    def by_tet(name: str) -> np.ndarray:
        return np.where(upper, getattr(halves[1], name), getattr(halves[0], name))

    young, poisson, density, ratio = map(
        by_tet, ("young_modulus_pa", "poisson_ratio", "density_kg_m3", "mooney_ratio")
    )
    field = MaterialField(young, poisson, density, model, ratio)
    rng = np.random.default_rng(4)
    x = mesh.nodes_m * [1.1, 0.95, 0.9] + rng.uniform(-5e-5, 5e-5, mesh.nodes_m.shape)

    def assembled(body_mesh, tet_material, positions) -> tuple:
        body = linear(body_mesh, tet_material, bonded_nodes=np.array([0, 1, 2]))
        forces = ElementForces(Scene(body).finalize())
        return (
            forces.energy(positions[None])[0],
            forces.gradient(positions[None])[0],
            forces.model.masses.numpy()[0],
        )

    energy, gradient, masses = assembled(mesh, field, x)
    for half, tets in zip(halves, (mesh.tets[~upper], mesh.tets[upper]), strict=True):
        nodes, local = np.unique(tets, return_inverse=True)
        part = labelled(mesh.nodes_m[nodes], local.reshape(-1, 4))
        e, g, m = assembled(part, half, x[nodes])
        energy -= e
        gradient[nodes] -= g
        masses[nodes] -= m
    assert np.abs(energy) < 1e-13 * e
    np.testing.assert_allclose(gradient, 0, atol=1e-13 * np.abs(g).max())
    np.testing.assert_allclose(masses, 0, atol=1e-13 * m.max())
    # It is not one of the two materials alone.
    other = assembled(mesh, halves[0], x)[1]
    assert np.abs(other - assembled(mesh, field, x)[1]).max() > 0.1 * np.abs(g).max()
