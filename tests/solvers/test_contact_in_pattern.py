# SPDX-License-Identifier: Apache-2.0
"""Blocks of contact between gels and affine bodies: in the matrix (GPUs) or in a list (the CPU)."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.geometry.block import block_mesh
from taccel_lab.model.build import build_model
from taccel_lab.scene import AffineBody, Element, Material, Scene, SoftBody, TimeStepping, box_mesh
from taccel_lab.solvers import SolverConfig, SolverIPC
from taccel_lab.state import initial_state
from tests.solvers.driven_grasp import base_poses, driven_grasp


@pytest.mark.parametrize("method", ["ssor", "arrow", "cg"])
def test_results_are_the_same(method: str) -> None:
    gel = SoftBody(
        block_mesh((3, 3, 2), (6e-3, 6e-3, 3e-3)),
        Material(1e5, 0.4),
        friction_coefficient=0.5,
        element=Element.LINEAR,
    )
    cube = AffineBody(
        box_mesh((3e-3, 3e-3, 3e-3)),
        name="cube",
        friction_coefficient=0.5,
        initial_pose=np.array([0.2e-3, 0, 1.6e-3, 0, 0, 0, 1.0]),
        initial_velocity_m_s=(0.05, 0.0, -0.1),
    )
    time = TimeStepping(quasi_static=False, dt_s=2e-3, gravity_m_s2=(0.0, 0.0, -9.81))
    scene = Scene([gel], [], 1, time, affine_bodies=[cube])
    ends, extras, counts = [], [], []
    for in_pattern in (False, True):
        model = build_model(scene, "cpu", contact_in_pattern=in_pattern)
        config = SolverConfig(dhat_m=1e-4, relative_tolerance=1e-8, linear_method=method)
        solver = SolverIPC(model, config)
        state = initial_state(model)
        most = 0
        for _ in range(6):
            assert solver.step(state).converged.all()
            most = max(most, int(solver.linear.extra.counts.numpy()[0]))
        ends.append(state.positions.numpy())
        extras.append(most)
        counts.append(model.pattern.block_count)
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-10)
    assert extras[0] > 0 == extras[1]
    assert counts[1] > counts[0]


@pytest.mark.parametrize("method", ["ssor", "arrow", "cg"])
def test_results_are_the_same_of_gels_on_driven_bodies(method: str) -> None:
    """Fingers that drives push, with gels on them, close on a box."""
    scene = driven_grasp(1, (Element.LINEAR, Element.LINEAR))
    ends, blocks = [], []
    for in_pattern in (False, True):
        model = build_model(scene, "cpu", contact_in_pattern=in_pattern)
        config = SolverConfig(dhat_m=5e-5, relative_tolerance=1e-8, linear_method=method)
        solver = SolverIPC(model, config)
        state = initial_state(model, base_poses(1))
        for _ in range(6):
            report = solver.step(state, base_poses(1))
            assert report.converged.all(), report.summary()
        assert report.contact_force_n[0] > 1.0
        ends.append(state.positions.numpy())
        blocks.append(model.pattern.block_count)
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-9)
    assert blocks[1] > blocks[0]
