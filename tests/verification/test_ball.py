# SPDX-License-Identifier: Apache-2.0
"""A ball is one node with a radius; it must press like the same sphere as a triangle mesh."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.envs import Indenter, PressEnv
from taccel_lab.scene import Ball, Material, TriangleMesh, sphere_mesh
from taccel_lab.sensors.press_mesh import PressMeshOptions, press_mesh
from taccel_lab.solvers import SolverConfig

RADIUS_M = 2e-3
AT_MM = (1.0, -0.5)


def force_n(shape: Ball | TriangleMesh, dhat_m: float, size: float, depth_mm: float) -> float:
    """Force of a press on a gel of quadratic tets, ``size`` elements to the contact radius."""
    radius_mm = (depth_mm * RADIUS_M * 1e3) ** 0.5
    mesh = press_mesh("gelsight", {}, AT_MM, radius_mm, PressMeshOptions(size, core=4, rings=8))
    env = PressEnv(
        mesh,
        Material(1.5e5, 0.46),
        Indenter("ball", shape),
        np.array([AT_MM]),
        config=SolverConfig(dhat_m=dhat_m),
    )
    env.move_to(depth_mm)
    return float(env.wrench[0, 2])


@pytest.mark.parametrize(
    ("dhat_m", "size"),
    [pytest.param(2e-5, 3.0, marks=pytest.mark.slow), (2e-5, 1.5), (5e-6, 3.0)],
)
def test_a_ball_presses_like_its_mesh(dhat_m: float, size: float) -> None:
    meshed = force_n(sphere_mesh(RADIUS_M, 0.08e-3), dhat_m, size, 0.1)
    assert force_n(Ball(RADIUS_M), dhat_m, size, 0.1) == pytest.approx(meshed, rel=0.01)
