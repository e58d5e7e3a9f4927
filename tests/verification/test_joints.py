# SPDX-License-Identifier: Apache-2.0
"""Mechanisms against their closed forms, as implicit Euler has them, with joints closed to 1e-9."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from taccel_lab.scene import (
    AffineBody,
    FixedJoint,
    KinematicBody,
    PositionDrive,
    PrismaticJoint,
    RevoluteJoint,
    StatedMass,
    VelocityDrive,
)
from taccel_lab.solvers import SolverConfig
from tests.support.variants import variants
from tests.verification.affine_scenes import DOWN, G, Run, affine_scene, box, turned

NONE = (0.0, 0.0, 0.0)
ROD = (0.1, 0.02, 0.03)
"""Along x, hinged at its end about y."""
MASS = 1000 * 0.1 * 0.02 * 0.03
MOMENT = MASS * (0.1**2 + 0.03**2) / 12 + MASS * 0.05**2
"""About the hinge."""
ROD_AT_REST = box("rod", ROD, (0.05, 0, 0))


def hinge(
    first: str = "rod",
    second: str | None = None,
    anchor: Any = (0, 0, 0),
    axis: Any = (0, 1, 0),
    **options: Any,
) -> RevoluteJoint:
    return RevoluteJoint(first, second, anchor, axis, name=f"{first}-{second}", **options)


def slider(axis: Any = (0, 0, 1), **options: Any) -> Run:
    return Run(
        affine_scene([box("b", ROD)], [PrismaticJoint("b", None, (0, 0, 0), axis, **options)])
    )


def coordinate(run: Run, joint: int = 0) -> float:
    assert run.solver.joints is not None
    return float(run.solver.joints.coordinates.numpy()[0, joint])


def reading(run: Run, name: str) -> np.ndarray:
    """What the first joint's ``name`` is, of environment 0."""
    return getattr(run.solver.joints, name).numpy()[0, 0]


@pytest.mark.parametrize("stated", [False, True])
def test_small_swings_of_a_pendulum(stated: bool) -> None:
    """Implicit Euler of a'' = -w^2 a, w^2 = m g d / (I + m d^2), of stated masses too."""
    start, mass, about_hinge, below = 0.02, MASS, MOMENT, 0.05
    lever, rest, own = below, np.pi / 2, None
    if stated:
        lever, rest, mass, moment = 0.02, 0.0, 0.3, 4e-4
        own = StatedMass(mass, np.array([0, 0, lever - below]), np.diag([5e-4, moment, 3e-4]))
        about_hinge = moment + mass * below**2
    center = -lever * np.array([np.sin(start), 0, np.cos(start)])
    rod = box("rod", ROD, center, turned((0, 1, 0), rest + start), stated_mass=own)
    run = Run(affine_scene([rod], [hinge()]))
    if stated:
        assert run.masses[0, 0] == mass < run.masses[0].sum(), "with those of control vectors"
    w = np.sqrt(mass * G * below / about_hinge)
    angle, rate = start, 0.0
    found, expected = [], []
    for _ in range(60 if stated else 90):
        run.step()
        rate = (rate - run.dt * w**2 * angle) / (1 + (w * run.dt) ** 2)
        angle += run.dt * rate
        found.append(start + coordinate(run))
        expected.append(angle)
    # sin a = a costs a^2 / 6 of the force.
    np.testing.assert_allclose(found, expected, atol=1e-3 * start)


def test_a_held_rod_needs_its_moment() -> None:
    run = Run(affine_scene([ROD_AT_REST], [FixedJoint("rod", None, (0, 0, 0))]))
    run.steps(3)
    weight = MASS * G
    np.testing.assert_allclose(reading(run, "forces"), [0, 0, weight], atol=1e-6 * weight)
    moment = [0, -0.05 * weight, 0]
    np.testing.assert_allclose(reading(run, "torques"), moment, atol=1e-6 * weight)
    np.testing.assert_allclose(run.maps[0], np.eye(3), atol=1e-6)


def test_a_slider_falls_along_its_axis() -> None:
    axis = np.array([1.0, 0.5, -1.0]) / 1.5
    joint = PrismaticJoint("b", None, (0.3, 0.1, 0), axis, name="slide")
    run = Run(affine_scene([box("b", ROD, (0.1, 0.2, 0.3))], [joint]))
    start, n = run.y[0, 0], 25
    run.steps(n)
    way = (np.array(DOWN) @ axis) * run.dt**2 * n * (n + 1) / 2
    assert coordinate(run) == pytest.approx(way, rel=3e-6)
    np.testing.assert_allclose(run.y[0, 0], start + way * axis, atol=1e-6)
    # Its own force strains it, and nothing turns it.
    assert np.abs(run.maps[0] - run.maps[0].T).max() < 1e-9
    assert run.strain < 1e-5


@pytest.mark.parametrize("density", variants([1000.0], [1000.0, 20_000.0, 20.0]))
def test_a_double_pendulum_loses_energy_only(density: float) -> None:
    """From the horizontal, with a heavy or a light end: mass ratios of 20 and 50."""
    lower = box("lower", ROD, (0.15, 0, 0), density_kg_m3=density)
    joints = [hinge("upper"), hinge("lower", "upper", anchor=(0.1, 0, 0))]
    run = Run(affine_scene([box("upper", ROD, (0.05, 0, 0)), lower], joints))
    masses = run.masses[:, 0, 0]
    energies = [0.0]
    for _ in range(25):
        run.step()
        energies.append(run.kinetic_energy + G * float(masses @ run.y[:, 0, 2]))
        assert run.strain < 1e-4
        # Both stay in the plane of the motion.
        assert np.abs(run.y[:, 0, 1]).max() < 1e-9
    assert (np.diff(energies) < 1e-9).all()
    assert run.y[1, 0, 2] < -0.08


def test_a_floating_pair_keeps_its_momentum() -> None:
    bodies = [
        box("a", ROD, (0.05, 0, 0), initial_spin_rad_s=(1, 2, 3)),
        box("b", (0.04, 0.05, 0.06), (0.13, 0, 0), initial_velocity_m_s=(0.1, 0.2, -0.3)),
    ]
    drive = PositionDrive(stiffness=0.05, damping=1e-4, target=1.0)
    joint = RevoluteJoint("a", "b", (0.105, 0, 0), (0, 1, 1), drive=drive)
    # The default, 1e-7 N, may change the momentum by 5e-10 N s a step: all of the bound.
    config = SolverConfig(absolute_tolerance_n=1e-8)
    run = Run(affine_scene(bodies, [joint], gravity=NONE, dt=5e-3), config)
    momentum, size = run.momentum, np.linalg.norm(run.angular_momentum)
    for _ in range(30):
        before = run.v
        run.step()
        assert np.linalg.norm(run.momentum - momentum) < 1e-8 * np.linalg.norm(momentum)
        assert np.linalg.norm(run.angular_impulse(run.v - before)) < 1e-8 * size
    assert abs(coordinate(run)) > 0.1


@pytest.mark.thorough
def test_two_cubes_fixed_together_are_one_box() -> None:
    spin = (3.0, 5.0, -2.0)
    cubes = [
        box(
            name,
            (0.1, 0.1, 0.1),
            (x, 0, 0),
            initial_spin_rad_s=spin,
            initial_velocity_m_s=tuple(np.cross(spin, [x - 0.1, 0, 0])),
        )
        for name, x in (("a", 0.05), ("b", 0.15))
    ]
    one = box("w", (0.2, 0.1, 0.1), (0.1, 0, 0), initial_spin_rad_s=spin)
    whole = Run(affine_scene([one], gravity=NONE, dt=5e-3))
    joint = FixedJoint("a", "b", (0.1, 0, 0))
    pair = Run(affine_scene(cubes, [joint], gravity=NONE, dt=5e-3))
    for _ in range(40):
        whole.step()
        pair.step()
        np.testing.assert_allclose(pair.maps, whole.maps.repeat(2, axis=0), atol=1e-5)
    ends = 0.1 * whole.maps[0][:, 0] * np.array([[-0.5], [0.5]])
    np.testing.assert_allclose(pair.y[:, 0], whole.y[0, 0] + ends, atol=1e-6)
    assert np.abs(whole.maps[0] - np.eye(3)).max() > 0.5


def test_a_four_bar_linkage_follows_its_closed_form() -> None:
    """A closed loop: crank 40, coupler 100, rocker 80, ground 100 mm; a whole turn of the crank."""
    a, b, c, d = 0.04, 0.1, 0.08, 0.1

    def loop(crank: float) -> tuple[np.ndarray, np.ndarray]:
        """Ends of crank and rocker, in the plane (x, z), coupler above."""
        p = a * np.array([np.cos(crank), np.sin(crank)])
        to_pivot = np.array([d, 0]) - p
        r = np.linalg.norm(to_pivot)
        along = (b**2 - c**2 + r**2) / (2 * r)
        up = np.array([-to_pivot[1], to_pivot[0]]) / r
        return p, p + along * to_pivot / r + np.sqrt(b**2 - along**2) * up

    def rod(name: str, start: np.ndarray, end: np.ndarray, y: float) -> AffineBody:
        way, middle = end - start, (start + end) / 2
        # Turning about -y leads from x to z.
        rotation = turned((0, -1, 0), np.arctan2(way[1], way[0]))
        size = (float(np.linalg.norm(way)), 0.01, 0.01)
        return box(name, size, (middle[0], y, middle[1]), rotation)

    start = 0.7
    p, q = loop(start)
    pivot = np.array([d, 0.0])
    bodies = [
        rod("crank", np.zeros(2), p, 0),
        rod("coupler", p, q, 0.02),
        rod("rocker", pivot, q, 0),
    ]
    rate = 2 * np.pi
    motor = VelocityDrive(damping=10.0, target=rate)
    joints = [
        hinge(first, second, anchor=(at[0], 0.01, at[1]), axis=(0, -1, 0), drive=drive)
        for first, second, at, drive in (
            ("crank", None, (0, 0), motor),
            ("coupler", "crank", p, None),
            ("rocker", "coupler", q, None),
            ("rocker", None, pivot, None),
        )
    ]
    run = Run(affine_scene(bodies, joints, dt=0.02))
    q_start = loop(start)[1] - pivot
    for _ in range(52):
        run.step()
        crank = start + coordinate(run, 0)
        rocker = loop(crank)[1] - pivot
        turn = np.arctan2(q_start[0] * rocker[1] - q_start[1] * rocker[0], q_start @ rocker)
        assert coordinate(run, 3) == pytest.approx(turn, abs=1e-5)
    assert coordinate(run, 0) == pytest.approx(52 * 0.02 * rate, rel=1e-3)


def test_a_hinge_stops_at_its_limit_and_stays() -> None:
    run = Run(affine_scene([ROD_AT_REST], [hinge(limits_deg=(-5, 30))]))
    limit = np.radians(30)
    for _ in range(30):
        run.step()
        assert coordinate(run) < limit + 1e-9
    assert coordinate(run) == pytest.approx(limit, abs=1e-9)
    moment = [0, -MASS * G * 0.05 * np.cos(limit), 0]
    np.testing.assert_allclose(reading(run, "torques"), moment, atol=1e-6 * MASS * G)
    assert run.kinetic_energy < 1e-12


def test_a_slider_leaves_its_limit_when_pushed_back() -> None:
    run = slider(limits_mm=(-2, 2), drive=PositionDrive(1e-9))
    run.steps(8)
    assert coordinate(run) == pytest.approx(-2e-3, abs=1e-10)
    assert run.state.joints is not None
    run.state.joints.targets.fill_(1e9 * 2 * MASS * G)
    run.step()
    # Net force: the drive pulls twice the weight.
    assert coordinate(run) == pytest.approx(-2e-3 + G * run.dt**2, rel=1e-6)
    assert reading(run, "efforts") == pytest.approx(2 * MASS * G, rel=1e-9)


def test_a_servo_settles_where_spring_and_weight_balance() -> None:
    run = slider(drive=PositionDrive(200.0, damping=5.0, target=0.02))
    run.steps(80)
    assert coordinate(run) == pytest.approx(0.02 - MASS * G / 200.0, abs=1e-6)


@pytest.mark.parametrize("effort", [0.1, np.inf])
def test_a_motor_reaches_its_rate_with_its_force(effort: float) -> None:
    run = slider((1, 0, 0), drive=VelocityDrive(damping=1e3, target=0.3, max_effort=effort))
    rates = []
    for _ in range(25):
        run.step()
        rates.append(run.v[0, 0, 0])
    if effort < 1:
        # Constant force until the rate is reached.
        assert rates[9] == pytest.approx(10 * run.dt * effort / MASS, rel=1e-6)
    else:
        assert rates[0] == pytest.approx(0.3, rel=1e-2)
    assert rates[-1] == pytest.approx(0.3, rel=1e-6)


def test_a_joint_follows_a_kinematic_body() -> None:
    rod = box("rod", ROD, (0, 0, -0.05), turned((0, 1, 0), np.pi / 2))
    carriage = KinematicBody(None, name="carriage")
    run = Run(affine_scene([rod], [hinge("rod", "carriage")], kinematic=carriage))
    for i in range(1, 15):
        place = np.array([0.02, 0.005, -0.01]) * i
        run.step(np.append(place, turned((0, 0.3, 1), 0.05 * i)))
        held = run.y[0, 0] + run.maps[0] @ [-0.05, 0, 0]
        np.testing.assert_allclose(held, place, atol=1e-9)
    assert abs(coordinate(run)) > 0.1


def test_a_servo_turns_many_times() -> None:
    target = 3 * 2 * np.pi + 1
    joint = hinge(drive=PositionDrive(stiffness=1.0, damping=0.1, target=target))
    run = Run(affine_scene([ROD_AT_REST], [joint], gravity=NONE, dt=0.02))
    run.steps(80)
    assert coordinate(run) == pytest.approx(target, abs=1e-3)
