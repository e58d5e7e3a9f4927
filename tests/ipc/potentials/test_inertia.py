# SPDX-License-Identifier: Apache-2.0
"""Inertia of an implicit Euler step: value, derivatives and mass."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.scene import TimeStepping
from taccel_lab.solvers.config import SolverConfig
from tests.verification.assembly import Assembly, central_difference, coordinate_probe
from tests.verification.blocks import block_mesh, scene

DT, GRAVITY = 0.01, (0.0, 1.0, -9.81)
SIZE = (2e-3, 3e-3, 1e-3)


def test_inertia_matches_its_formula_and_differences() -> None:
    mesh = block_mesh((2, 1, 1), SIZE, jitter=0.2)
    n = mesh.node_count
    stepping = TimeStepping(quasi_static=False, dt_s=DT, gravity_m_s2=GRAVITY)
    model = scene(mesh, env_count=6 * n, density=1200, time=stepping).finalize()
    assembly = Assembly(model, SolverConfig(), np.zeros((6 * n, 0, 7)))
    inertia = assembly.solver.inertia
    assert inertia is not None
    rng = np.random.default_rng(0)
    start, velocity = mesh.nodes_m, rng.normal(size=(n, 3))
    many = (6 * n, 1, 1)
    inertia.begin_step(
        assembly.nodal(np.tile(start, many)), assembly.nodal(np.tile(velocity, many))
    )
    x = start + rng.normal(size=(n, 3)) * 1e-3

    free = assembly.free
    masses = model.masses.numpy()[0]
    assert masses.sum() == pytest.approx(1200 * np.prod(SIZE), rel=1e-12)
    offset = (x - (start + DT * velocity + DT**2 * np.array(GRAVITY)))[free]
    expected = 0.5 * (masses[free] * (offset**2).sum(axis=1)).sum() / DT**2
    at_x = assembly.nodal(np.tile(x, many))
    assert inertia.energy(assembly.active, at_x)[0] == pytest.approx(expected, rel=1e-12)

    step = 1e-7
    probes = coordinate_probe(x, np.arange(n), step)
    slope = central_difference(inertia.energy(assembly.active, assembly.nodal(probes)), step)
    out = assembly.nodal()
    inertia.add_gradient(assembly.active, at_x, out)
    gradient = out.numpy()[0]
    assert np.abs(gradient).max() > 1e-6
    np.testing.assert_allclose(gradient, slope.reshape(-1, 3), atol=1e-7 * np.abs(gradient).max())

    system = assembly.system()
    inertia.add_hessian(assembly.active, system.values)
    matrix = assembly.dense(system.values)[0]
    np.testing.assert_allclose(matrix, np.diag(np.repeat(masses[free] / DT**2, 3)), rtol=1e-14)


def test_mass_follows_the_rest_shape_of_each_environment() -> None:
    mesh = block_mesh((2, 1, 1), SIZE)
    rest = np.stack([mesh.nodes_m, mesh.nodes_m * [2, 1, 1]])
    stepping = TimeStepping(quasi_static=False)
    masses = scene(mesh, env_count=2, rest_m=rest, time=stepping).finalize().masses.numpy()
    np.testing.assert_allclose(masses[1], 2 * masses[0])
