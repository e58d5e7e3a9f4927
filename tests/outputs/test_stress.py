# SPDX-License-Identifier: Apache-2.0
"""Cauchy stress against closed forms, for every law and element."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from taccel_lab.benchmarks.stress.balance import ElasticLaw
from taccel_lab.geometry.block import block_mesh
from taccel_lab.ipc.potentials.elements.elastic import ElasticPotential
from taccel_lab.model import Model
from taccel_lab.outputs import Outputs
from taccel_lab.outputs.stress import StressReader, peak_at, von_mises
from taccel_lab.scene import Element, Material, MaterialModel, MaxwellBranch, Scene, SoftBody
from tests.support.scene_steps import Stepped

E, NU = 1e5, 0.4
MU, LAM = E / (2 * (1 + NU)), E * NU / ((1 + NU) * (1 - 2 * NU))
F = np.array([[1.3, 0.2, 0.0], [-0.1, 0.9, 0.15], [0.05, 0.0, 1.1]])
MESH = block_mesh((3, 2, 2), (3e-3, 2e-3, 2e-3), jitter=0.25)


def block(law: MaterialModel, element: Element, ratio: float = 0.0, env_count: int = 1) -> Model:
    material = Material(E, NU, model=law, mooney_ratio=ratio)
    return Scene(SoftBody(MESH, material, element=element), env_count=env_count).finalize()


def stresses(model: Model, f: np.ndarray) -> tuple[StressReader, np.ndarray, wp.array]:
    """Element and nodal stresses of the block under x -> F x."""
    x = model.rest_positions.numpy()[0] @ f.T
    positions = wp.array(np.tile(x, (model.env_count, 1, 1)), dtype=wp.vec3d)
    reader = StressReader(model, model.elastic[0])
    by_element = reader.read(positions).numpy()
    nodal = wp.zeros(positions.shape, dtype=wp.mat33d)
    reader.add_to_nodes(nodal)
    return reader, by_element, nodal


def cauchy(law: MaterialModel, f: np.ndarray, ratio: float = 0.0) -> np.ndarray:
    """Cauchy stress [Pa] by the formulas of the stress suite's referee."""
    elastic = ElasticLaw(law, *map(np.float64, (MU, LAM, ratio)))
    return elastic.piola(f, elastic.lam) @ f.T / np.linalg.det(f)


@pytest.mark.parametrize("element", list(Element))
@pytest.mark.parametrize("law", list(MaterialModel))
def test_a_uniform_deformation_has_the_cauchy(law: MaterialModel, element: Element) -> None:
    f, ratio = F, 0.3 if law is MaterialModel.MOONEY_RIVLIN else 0.0
    expected = cauchy(law, f, ratio)
    reader, by_element, nodal = stresses(block(law, element, ratio), f)
    scale = np.abs(expected).max()
    assert scale > 1e4
    np.testing.assert_allclose(by_element, np.broadcast_to(expected, by_element.shape), rtol=1e-10)
    np.testing.assert_allclose(nodal.numpy() - expected, 0, atol=1e-10 * scale)
    volume = np.linalg.det(f) * 3e-3 * 2e-3 * 2e-3
    assert reader.volumes.numpy().sum() == pytest.approx(volume, rel=1e-12)
    deviator = expected - np.trace(expected) / 3 * np.eye(3)
    equivalent = von_mises(nodal).numpy()
    np.testing.assert_allclose(equivalent, np.sqrt(1.5 * (deviator**2).sum()), rtol=1e-9)


@pytest.mark.parametrize("element", list(Element))
def test_branches_add_what_has_not_relaxed(element: Element) -> None:
    branches = MaxwellBranch(0.5, 1.0), MaxwellBranch(0.2, 3.0)
    law = MaterialModel.NEO_HOOKEAN
    material = Material(E, NU, model=law, branches=branches)
    run, f = Stepped(Scene(SoftBody(MESH, material, element=element))), F
    kept = np.array([np.diag([0.8, 1.1, 1.0]), np.eye(3) + 0.1 * np.eye(3, k=1)])
    expected = cauchy(law, f)
    for branch, inverse in zip(branches, kept, strict=True):
        volume = np.linalg.det(f @ inverse) / np.linalg.det(f)
        expected = expected + branch.relative_modulus * volume * cauchy(law, f @ inverse)
    run.state.positions = wp.array((run.rest @ f.T)[None], dtype=wp.vec3d)
    inverses = np.repeat(kept, run.model.viscous_point_count // 2, axis=0)[None]
    run.state.viscous_inverses = wp.array(inverses, dtype=wp.mat33d)
    found = Outputs(run.solver).update(run.state).nodal_stresses.numpy()[0]
    np.testing.assert_allclose(found - expected, 0, atol=1e-10 * np.abs(expected).max())
    run.state.viscous_inverses = None
    found = Outputs(run.solver).update(run.state).nodal_stresses.numpy()[0]
    sudden = 1.7 * cauchy(law, f)
    np.testing.assert_allclose(found - sudden, 0, atol=1e-10 * np.abs(sudden).max())


@pytest.mark.parametrize("element", list(Element))
def test_stress_balances_the_forces_of_the_potential(element: Element) -> None:
    """sum_e sigma V = sum_i x_i (x) g_i: the virial of the gradient, in any deformation."""
    model = block(MaterialModel.MOONEY_RIVLIN, element, 0.3)
    x = model.rest_positions.numpy()
    x = x + np.random.default_rng(0).normal(size=x.shape) * 2e-5
    positions = wp.array(x, dtype=wp.vec3d)
    gradient = wp.zeros(positions.shape, dtype=wp.vec3d)
    active = wp.full(1, 1, dtype=wp.int32)
    ElasticPotential(model, model.elastic[0]).add_gradient(active, positions, gradient)
    reader = StressReader(model, model.elastic[0])
    total = np.einsum("eij,e->ij", reader.read(positions).numpy()[0], reader.volumes.numpy()[0])
    virial = np.einsum("ni,nj->ij", gradient.numpy()[0], x[0])
    np.testing.assert_allclose(virial, total, atol=1e-10 * np.abs(total).max())


def test_the_peak_at_the_bond_and_where_it_is() -> None:
    values = np.zeros((2, MESH.node_count))
    bonded = MESH.bonded_nodes()
    values[0, bonded[3]] = 5.0
    values[1, bonded[1]] = 7.0
    free = np.setdiff1d(np.arange(MESH.node_count), bonded)
    values[:, free[0]] = 100.0
    peaks, places = peak_at(bonded, wp.array(values, dtype=wp.float64))
    assert peaks.numpy().tolist() == [5.0, 7.0]
    assert places.numpy().tolist() == [bonded[3], bonded[1]]
