# SPDX-License-Identifier: Apache-2.0
"""A block that rests on a slope: the wrench between block and slope, to a micronewton."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.geometry.block import free_block
from taccel_lab.outputs import Outputs
from taccel_lab.scene import (
    AffineBody,
    Element,
    KinematicBody,
    Material,
    Plane,
    Scene,
    SoftBody,
    TimeStepping,
    box_mesh,
)
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.state import initial_state
from tests.support.blocks import everywhere, pose

G, SIDE, DENSITY = 9.81, 2e-2, 1000.0
MASS = DENSITY * SIDE**3
DHAT, EPS = 2e-5, 1e-6


def resting(soft: bool, floor: str, slope: float, mu: float) -> Outputs:
    """A cube of 8 g after half a second on a floor under leaning gravity."""
    angle = np.arctan(slope)
    gravity = (G * np.sin(angle), 0.0, -G * np.cos(angle))
    time = TimeStepping(quasi_static=False, dt_s=0.02, gravity_m_s2=gravity)
    start = 0.5 * DHAT
    if soft:
        body = SoftBody(
            free_block((3, 3, 3), SIDE),
            Material(1e6, 0.3, DENSITY),
            initial_pose=pose(1e-3, 2e-3, SIDE + start),
            element=Element.LINEAR,
        )
        bodies = {"soft_bodies": body}
    else:
        cube = AffineBody(
            box_mesh((SIDE, SIDE, SIDE)), DENSITY, initial_pose=pose(1e-3, 2e-3, SIDE / 2 + start)
        )
        bodies = {"affine_bodies": cube}
    if floor == "plane":
        bodies["planes"] = Plane(friction_coefficient=mu)
        poses = np.zeros((1, 0, 7))
    else:
        bodies["kinematic_bodies"] = KinematicBody(box_mesh((0.1, 0.1, 0.02)), mu, name="floor")
        poses = everywhere(1, pose(0, 0, -0.01))
    model = Scene(time=time, **bodies).finalize()
    config = SolverConfig(
        dhat_m=DHAT,
        friction_speed_m_s=EPS / 0.02,
        relative_tolerance=1e-8,
        absolute_tolerance_n=1e-9,
    )
    solver, state = SolverIPC(model, config), initial_state(model, poses)
    for _ in range(25):
        report = solver.step(state)
        assert report.converged.all(), report.summary()
    return Outputs(solver).update(state)


@pytest.mark.parametrize("floor", ["plane", "box"])
@pytest.mark.parametrize("soft", [False, True])
def test_the_wrench_balances_the_weight(soft: bool, floor: str) -> None:
    slope, mu = 0.3, 0.5
    outputs = resting(soft, floor, slope, mu)
    angle = np.arctan(slope)
    normal = outputs.contact_wrenches().wrenches.numpy()[0, 0, 1]
    friction = outputs.friction_wrenches().wrenches.numpy()[0, 0, 1]
    weight = MASS * G
    np.testing.assert_allclose(friction[:3], [-weight * np.sin(angle), 0, 0], atol=1e-6)
    np.testing.assert_allclose(normal[:3], [0, 0, weight * np.cos(angle)], atol=1e-6)
    # And torques balance about the centre of mass of the block.
    x = outputs.state.positions.numpy()[0]
    model = outputs._model
    masses = model.masses.numpy()[0] * model.gravity_scale.numpy()
    centre = tuple(masses @ x / masses.sum())
    about = outputs.contact_wrenches(centre).wrenches.numpy()[0, 0, 1, 3:]
    about = about + outputs.friction_wrenches(centre).wrenches.numpy()[0, 0, 1, 3:]
    assert np.abs(about).max() < 1e-6 * SIDE * 2
    # The floor gets the same with the other sign.
    assert outputs.contact_wrenches().wrenches.numpy()[0, 1, 0, 2] == pytest.approx(
        -normal[2], rel=1e-12
    )
