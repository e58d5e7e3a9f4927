# SPDX-License-Identifier: Apache-2.0
"""Elasticity against closed forms: patch test, uniaxial stretch, simple shear, rigid motion."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from taccel_lab.geometry import TetMesh
from taccel_lab.scene import Element, Material, Scene, SoftBody
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.state import initial_state
from tests.support.blocks import block_mesh
from tests.verification.assembly import Assembly

SIZE = (3e-3, 2e-3, 2e-3)
VOLUME = float(np.prod(SIZE))
MATERIAL = Material(young_modulus_pa=1.3e5, poisson_ratio=0.42)
MU, LAM = MATERIAL.shear_modulus_pa, MATERIAL.lame_lambda_pa
NO_BODIES = np.zeros((1, 0, 7))


def random_block(seed: int) -> TetMesh:
    return block_mesh((3, 3, 3), SIZE, jitter=0.2, seed=seed)


def solve_inside(mesh: TetMesh, held: np.ndarray, target: np.ndarray, tolerance_n: float) -> tuple:
    """Equilibrium of the other nodes while the nodes ``held`` are at ``target`` [node_count, 3]."""
    model = Scene(SoftBody(mesh, MATERIAL, bonded_nodes=held, element=Element.LINEAR)).finalize()
    solver = SolverIPC(model, SolverConfig(absolute_tolerance_n=tolerance_n))
    state = initial_state(model, NO_BODIES)
    # The others start off the solution, so that the solver has work to do, but in no tet inverted.
    start = target + np.random.default_rng(0).uniform(-2e-5, 2e-5, target.shape)
    start[held] = target[held]
    state.positions = wp.array(start[None], dtype=wp.vec3d)
    report = solver.step(state)
    assert report.converged.all(), report.summary()
    assert report.newton_iterations[0] > 1
    return state.positions.numpy()[0], Assembly(model, SolverConfig(), NO_BODIES)


@settings(max_examples=5)
@given(seed=st.integers(0, 10_000))
def test_patch(seed: int) -> None:
    """Boundary nodes moved affinely: the solved interior is affine and the strain uniform."""
    mesh = random_block(seed)
    f = np.eye(3) + 0.2 * np.random.default_rng(seed).uniform(-1, 1, (3, 3))
    affine = mesh.nodes_m @ f.T + [1e-3, -2e-3, 3e-3]
    boundary = np.unique(mesh.faces)
    inside = np.setdiff1d(np.arange(mesh.node_count), boundary)
    assert len(inside) == 8
    x, assembly = solve_inside(mesh, boundary, affine, tolerance_n=1e-14)
    np.testing.assert_allclose(x, affine, atol=1e-12 * SIZE[0])
    gradient = assembly.elastic_gradient(affine[None])[0]
    assert np.abs(gradient[inside]).max() < 1e-12 * np.abs(gradient[boundary]).max()
    p = affine[mesh.tets]
    rest = mesh.nodes_m[mesh.tets]
    strain = np.swapaxes(p[:, 1:] - p[:, :1], 1, 2) @ np.linalg.inv(
        np.swapaxes(rest[:, 1:] - rest[:, :1], 1, 2)
    )
    np.testing.assert_allclose(strain, np.broadcast_to(f, strain.shape), atol=1e-12)


def _uniaxial_stress(stretch: float) -> tuple[float, float]:
    """(lateral stretch, first Piola-Kirchhoff stress [Pa]) of a bar with free sides."""

    def side_stress(w: float) -> float:
        return MU * (w - 1 / w) + LAM * np.log(stretch * w * w) / w

    w = float(brentq(side_stress, 0.2, 3.0, xtol=1e-15))
    return w, MU * (stretch - 1 / stretch) + LAM * np.log(stretch * w * w) / stretch


@pytest.mark.parametrize("stretch", [0.5, 0.9, 1.001, 1.3, 2.0])
def test_uniaxial_stretch_with_free_sides(stretch: float) -> None:
    mesh = random_block(1)
    lateral, stress = _uniaxial_stress(stretch)
    target = mesh.nodes_m * [stretch, lateral, lateral]
    x0 = mesh.nodes_m[:, 0]
    end = x0 > x0.max() - 1e-9
    held = np.flatnonzero(end | (x0 < x0.min() + 1e-9))
    x, assembly = solve_inside(mesh, held, target, tolerance_n=1e-13)
    np.testing.assert_allclose(x, target, atol=1e-9 * SIZE[0])
    pull = assembly.elastic_gradient(x[None])[0, end].sum(axis=0)
    area = SIZE[1] * SIZE[2]
    assert pull[0] == pytest.approx(stress * area, rel=1e-8)
    assert np.abs(pull[1:]).max() < 1e-9 * MU * area
    if stretch == 1.001:
        # The slope at rest is Young's modulus.
        assert pull[0] / area / 1e-3 == pytest.approx(MATERIAL.young_modulus_pa, rel=3e-3)


@pytest.mark.parametrize("shear", [1e-4, 0.1, 1.0])
def test_simple_shear(shear: float) -> None:
    """J = 1: energy mu g^2 / 2 and shear stress P13 = P31 = mu g, whatever lambda is."""
    mesh = random_block(2)
    boundary = np.unique(mesh.faces)
    target = mesh.nodes_m + shear * mesh.nodes_m[:, 2:] * [1, 0, 0]
    x, assembly = solve_inside(mesh, boundary, target, tolerance_n=1e-13)
    energy = assembly.elastic_energy(x[None])[0]
    assert energy == pytest.approx(0.5 * MU * shear**2 * VOLUME, rel=1e-8)
    gradient = assembly.elastic_gradient(x[None])[0]
    # Virtual work of a uniform displacement gradient: V P_ij = sum of force_i times position_j.
    stress = np.einsum("ni,nj->ij", gradient, mesh.nodes_m) / VOLUME
    assert stress[0, 2] == pytest.approx(MU * shear, rel=1e-8)
    assert stress[2, 0] == pytest.approx(MU * shear, rel=1e-8)
    normal = np.array([0, 0, 0]) if shear < 1 else np.array([stress[0, 0], 0, 0])
    np.testing.assert_allclose(np.diag(stress) - normal, 0, atol=1e-8 * MU)


@pytest.mark.parametrize("ratio", [0.5, 0.8, 1.2])
def test_uniform_compression(ratio: float) -> None:
    """p = mu (s - 1/s) + 3 lambda ln(s) / s for F = s I."""
    mesh = random_block(3)
    made = Scene(SoftBody(mesh, MATERIAL, element=Element.LINEAR)).finalize()
    assembly = Assembly(made, SolverConfig(), NO_BODIES)
    x = mesh.nodes_m * ratio
    gradient = assembly.elastic_gradient(x[None])[0]
    stress = np.einsum("ni,nj->ij", gradient, mesh.nodes_m) / VOLUME
    expected = MU * (ratio - 1 / ratio) + 3 * LAM * np.log(ratio) / ratio
    np.testing.assert_allclose(stress, expected * np.eye(3), rtol=1e-10, atol=1e-10 * MU)


@settings(max_examples=20)
@given(seed=st.integers(0, 10_000), shift=st.floats(-1.0, 1.0))
def test_rigid_motion_costs_nothing(seed: int, shift: float) -> None:
    mesh = random_block(4)
    made = Scene(SoftBody(mesh, MATERIAL, element=Element.LINEAR)).finalize()
    assembly = Assembly(made, SolverConfig(), NO_BODIES)
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    x = mesh.nodes_m @ turn.T + shift
    # At 1 m from the origin, positions are known to 2e-16 m, strains of 0.5 mm tets to 1e-12.
    assert abs(assembly.elastic_energy(x[None])[0]) < 1e-14 * MU * VOLUME
    force = np.abs(assembly.elastic_gradient(x[None])[0]).max()
    assert force < 1e-11 * LAM * SIZE[1] * SIZE[2]
