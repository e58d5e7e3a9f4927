# SPDX-License-Identifier: Apache-2.0
"""Blocks of contact between gels and affine bodies: in the matrix (GPUs) or in a list (the CPU)."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
import pytest

from taccel_lab.model.build import build_model
from taccel_lab.scene import Element, Scene, TimeStepping
from taccel_lab.solvers import SolverConfig, SolverIPC
from taccel_lab.state import initial_state
from tests.solvers.driven_grasp import base_poses, driven_grasp
from tests.support.blocks import cube, pose, soft_block
from tests.support.variants import variants

METHODS = ["ssor", "arrow", "cg"]


def cube_on_a_gel() -> Scene:
    gel = soft_block((3, 3, 2), (6e-3, 6e-3, 3e-3), friction_coefficient=0.5)
    falling = cube(
        3e-3, pose(0.2e-3, 0, 1.6e-3), friction_coefficient=0.5,
        initial_velocity_m_s=(0.05, 0.0, -0.1),
    )  # fmt: skip
    time = TimeStepping(quasi_static=False, dt_s=2e-3, gravity_m_s2=(0.0, 0.0, -9.81))
    return Scene([gel], [], 1, time, affine_bodies=[falling])


def fingers() -> Scene:
    """Fingers that drives push, with gels on them, close on a box."""
    return driven_grasp(1, (Element.LINEAR, Element.LINEAR))


@pytest.mark.thorough(cases=("fingers-ssor",))
@pytest.mark.parametrize(
    ("make", "method"),
    variants(
        [*product([cube_on_a_gel], METHODS), (fingers, "ssor")], [cube_on_a_gel, fingers], METHODS
    ),
)
def test_results_are_the_same(make: Callable[[], Scene], method: str) -> None:
    ends, extras, counts = [], [], []
    for in_pattern in (False, True):
        model = build_model(make(), "cpu", contact_in_pattern=in_pattern)
        config = SolverConfig(dhat_m=1e-4, relative_tolerance=1e-8, linear_method=method)
        solver = SolverIPC(model, config)
        poses = base_poses(1) if len(model.kinematic) else None
        state = initial_state(model, poses)
        most = 0
        for _ in range(6):
            report = solver.step(state, poses)
            assert report.converged.all(), report.summary()
            most = max(most, int(solver.linear.extra.counts.numpy()[0]))
        ends.append(state.positions.numpy())
        extras.append(most)
        counts.append(model.pattern.block_count)
    off_m = 1e-10 if make is cube_on_a_gel else 1e-9
    np.testing.assert_allclose(ends[1], ends[0], atol=off_m)
    assert extras[0] > 0 == extras[1]
    assert counts[1] > counts[0]
