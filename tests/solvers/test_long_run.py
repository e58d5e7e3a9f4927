# SPDX-License-Identifier: Apache-2.0
"""100,000 steps: no memory is kept from step to step, and the last step is as good as the first."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab import (
    KinematicBody,
    Material,
    Outputs,
    Scene,
    SoftBody,
    SolverIPC,
    initial_state,
)
from taccel_lab.geometry.block import block_mesh
from taccel_lab.scene import Ball, Element

STEPS = 100_000
PERIOD = 40
"""Steps of a press, drag and release."""


def resident_mib() -> float:
    with open("/proc/self/status", encoding="ascii") as status:
        (line,) = (line for line in status if line.startswith("VmRSS"))
    return int(line.split()[1]) / 1024


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_long_run_neither_grows_nor_drifts() -> None:
    gel = SoftBody(
        block_mesh((3, 3, 1), (6e-3, 6e-3, 2e-3)),
        Material(young_modulus_pa=1e5, poisson_ratio=0.45),
        element=Element.LINEAR,
        friction_coefficient=0.5,
    )
    solver = SolverIPC(Scene(gel, KinematicBody(Ball(3e-3))).finalize("cpu"))
    phase = 2 * np.pi * np.arange(PERIOD) / PERIOD
    path = np.zeros((PERIOD, 1, 1, 7))
    path[..., 6] = 1.0
    path[:, 0, 0, 0] = 2e-4 * np.sin(phase)
    path[:, 0, 0, 2] = 3e-3 + 1e-4 - 2.5e-4 * (1 - np.cos(phase))
    state = initial_state(solver.model, path[0])
    outputs = Outputs(solver)
    forces, after_warmup = [], 0.0
    for step in range(STEPS):
        report = solver.step(state, path[step % PERIOD])
        assert report.converged.all(), step
        if step % PERIOD == PERIOD // 2:
            forces.append(float(outputs.update(state).soft_wrenches().numpy()[0, 0, 2]))
        if step == 10 * PERIOD:
            after_warmup = resident_mib()
    assert resident_mib() - after_warmup < 5.0
    assert np.abs(forces[0]) > 1e-3
    np.testing.assert_allclose(forces[-1], forces[1], rtol=1e-3)
