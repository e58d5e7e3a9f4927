# SPDX-License-Identifier: Apache-2.0
"""The start along the last velocities: fewer iterations, the same results."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.geometry.block import block_mesh
from taccel_lab.scene import (
    Element,
    KinematicBody,
    Material,
    Scene,
    SoftBody,
    TimeStepping,
    box_mesh,
)
from taccel_lab.solvers import SolverConfig, SolverIPC, start_step
from taccel_lab.state import initial_state


def drag() -> tuple[np.ndarray, list[int]]:
    """A gel on a mount is pressed on a block and dragged along it; positions and iterations."""
    gel = SoftBody(
        block_mesh((3, 3, 2), (6e-3, 6e-3, 3e-3)),
        Material(1e5, 0.4),
        mount="hand",
        friction_coefficient=0.3,
        element=Element.LINEAR,
    )
    table = KinematicBody(box_mesh((60e-3, 60e-3, 4e-3)), 0.3, name="table")
    time = TimeStepping(quasi_static=False, dt_s=5e-3)
    scene = Scene([gel], [KinematicBody(None, name="hand"), table], 1, time)
    model = scene.finalize()
    solver = SolverIPC(model, SolverConfig(dhat_m=1e-4, relative_tolerance=1e-6))
    upside_down = [1.0, 0, 0, 0]

    def poses(x: float, z: float) -> np.ndarray:
        return np.array([[[x, 0, z, *upside_down], [0, 0, -2e-3, 0, 0, 0, 1]]])

    path = [(0.0, 5e-5 - 5e-5 * k) for k in range(8)]
    path += [(2e-4 * k, path[-1][1]) for k in range(1, 25)]
    state = initial_state(model, poses(*path[0]))
    iterations = []
    for x, z in path[1:]:
        report = solver.step(state, poses(x, z))
        assert report.converged.all(), report.summary()
        iterations.append(int(report.newton_iterations[0]))
    assert np.abs(solver.friction_gradient.numpy()[0, :, 0]).sum() > 0.1, "it rubs"
    return state.positions.numpy(), iterations


def test_a_steady_drag_takes_fewer_iterations(monkeypatch: pytest.MonkeyPatch) -> None:
    found, few = drag()
    monkeypatch.setattr(start_step, "plan_start", lambda run: None)
    expected, many = drag()
    np.testing.assert_allclose(found, expected, atol=2e-8)
    assert sum(few[-10:]) <= 0.8 * sum(many[-10:])
