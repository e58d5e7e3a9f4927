# SPDX-License-Identifier: Apache-2.0
"""Bodies dragged over a plane with friction of 0.35, as the pencil of the IPC paper: by a spring
until they slip, and as a rod that trails or is pushed."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.scene import (
    KinematicBody,
    Plane,
    PositionDrive,
    PrismaticJoint,
    RevoluteJoint,
    Surface,
)
from taccel_lab.solvers import SolverConfig
from tests.support.blocks import everywhere
from tests.verification.affine_scenes import G, Run, affine_scene, box, turned

MU = 0.35
SIDE, STIFFNESS, SPEED, DT = 20e-3, 20.0, 0.05, 2e-3
DHAT = 2e-5


def pulled_block() -> Run:
    """A block that may sink and rise on a light carriage, which a spring pulls along x."""
    block = box("block", (SIDE, SIDE, SIDE), (0, 0, SIDE / 2 + 0.9 * DHAT), friction_coefficient=MU)
    apart = Surface(layer=2, collides_with=0)
    carriage = box("carriage", (5e-3, 5e-3, 5e-3), (0, 0, 0.1), density_kg_m3=100.0, surface=apart)
    joints = [
        PrismaticJoint("block", "carriage", (0, 0, 0), (0, 0, 1), name="guide"),
        PrismaticJoint(
            "carriage", None, (0, 0, 0.1), (1, 0, 0), name="rail", drive=PositionDrive(STIFFNESS)
        ),
    ]
    return Run(
        affine_scene([block, carriage], joints, planes=[Plane(friction_coefficient=MU)], dt=DT),
        SolverConfig(dhat_m=DHAT, kappa_pa=1e4),
    )


def spring_forces(mass: float, limit: float, steps: int) -> np.ndarray:
    """Coulomb's law in steps of implicit Euler: the spring's force [N], shape [steps]."""
    place, speed, forces = 0.0, 0.0, []
    for step in range(1, steps + 1):
        gap = SPEED * step * DT - place
        # Sliding forward: m (v' - v) = dt (k (gap - dt v') - limit).
        ahead = mass * speed + DT * (STIFFNESS * gap - limit)
        speed = max(ahead / (mass + DT**2 * STIFFNESS), 0.0)
        place += DT * speed
        forces.append(STIFFNESS * (SPEED * step * DT - place))
    return np.array(forces)


def test_a_block_pulled_by_a_spring_sticks_and_slips() -> None:
    """The spring's end moves at V. The block sticks until k V t = mu N, and lets go at rest: the
    spring overshoots mu N by V sqrt(k m), less what the steps damp, as an oscillator about mu N
    that starts at speed -V, and settles to steady sliding at mu N."""
    run = pulled_block()
    joints = run.solver.joints
    assert joints is not None
    for _ in range(5):
        run.step()
    weight, mass = run.masses[0, 0, 0] * G, run.masses[:, 0, 0].sum()
    limit, steps = MU * weight, 220
    slips = round(limit / (STIFFNESS * SPEED * DT))
    forces = []
    for step in range(1, steps + 1):
        assert run.state.joints is not None
        targets = run.state.joints.targets.numpy()
        targets[0, 1] = SPEED * step * DT
        run.state.joints.targets.assign(targets)
        run.step()
        forces.append(STIFFNESS * (SPEED * step * DT - joints.coordinates.numpy()[0, 1]))
        if step == slips - 1:
            assert run.v[0, 0, 0] < run.solver.config.friction_speed_m_s, "it sticks"
        nodes = run.model.bodies[0].node_slice
        normal = -run.solver.contact_gradient.numpy()[0, nodes].sum(axis=0)[2]
        assert normal == pytest.approx(weight, rel=2e-3)
    expected = spring_forces(mass, limit, steps)
    np.testing.assert_allclose(forces, expected, atol=0.01 * limit)
    overshoot = (max(forces) - limit) / (SPEED * np.sqrt(STIFFNESS * mass))
    assert 0.9 < overshoot < 1
    assert forces[slips - 2] == pytest.approx(STIFFNESS * SPEED * (slips - 1) * DT, rel=1e-2)


LENGTH, ANGLE = 60e-3, np.radians(45)


@pytest.mark.parametrize("direction", [1, -1], ids=["trailing", "pushed"])
def test_a_rod_dragged_by_its_upper_end(direction: int) -> None:
    """Moments about the hinge: N (cos +- mu sin) = (W / 2) cos for the force N of the plane on the
    tip of a rod at 45 degrees; + where it trails. (With mu tan = 1 a pushed rod would jam.)"""
    top = np.array([0, 0, LENGTH * np.sin(ANGLE) + 2.0e-3])
    # The rod's lower end lies behind, at negative x.
    along = np.array([-np.cos(ANGLE), 0, -np.sin(ANGLE)])
    rod = box(
        "rod",
        (LENGTH, 4e-3, 1e-3),
        top + 0.5 * LENGTH * along,
        turned((0, 1, 0), -ANGLE),
        friction_coefficient=MU,
    )
    hinge = RevoluteJoint(
        "rod", "hand", top, (0, 1, 0), second_pose=np.array([*top, 0, 0, 0, 1]), name="hinge"
    )
    scene = affine_scene(
        [rod],
        [hinge],
        planes=[Plane(friction_coefficient=MU)],
        kinematic=[KinematicBody(None, name="hand")],
        dt=5e-3,
    )

    def hand(x: float, z: float) -> np.ndarray:
        return everywhere(1, np.array([top[0] + x, 0, top[2] + z, 0, 0, 0, 1]))

    run = Run(scene, SolverConfig(dhat_m=DHAT, kappa_pa=1e5), hand(0, 0))
    weight = run.masses[0, 0, 0] * G
    for _ in range(8):
        run.step(hand(0, 0))
    found = []
    nodes = run.model.bodies[0].node_slice
    for step in range(1, 13):
        run.step(hand(direction * 0.1 * step * run.dt, 0))
        contact = -run.solver.contact_gradient.numpy()[0, nodes].sum(axis=0)
        rubbing = -run.solver.friction_gradient.numpy()[0, nodes].sum(axis=0)
        found.append([contact[2], rubbing[0]])
    normal, rubs = np.mean(found[6:], axis=0)
    low = run.vertices[run.vertices[:, 2].argmin()]
    hinge_at = top + [direction * 0.1 * 12 * run.dt, 0, 0]
    r, c = low - hinge_at, run.y[0, 0] - hinge_at
    # Both moments about the hinge, about y, with the tip where it is.
    expected = weight * c[0] / (r[0] + direction * MU * r[2])
    assert rubs == pytest.approx(-direction * MU * normal, rel=1e-3)
    assert normal == pytest.approx(expected, rel=1e-3)
    assert run.overlaps() == []
