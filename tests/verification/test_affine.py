# SPDX-License-Identifier: Apache-2.0
"""Affine bodies against mechanics: flight, rotation, slopes, rolling, dragging, wrecking."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from taccel_lab.bodies.mass_properties import mass_properties
from taccel_lab.model.embedding import rotate
from taccel_lab.scene import (
    AffineBody,
    KinematicBody,
    Plane,
    PositionDrive,
    PrismaticJoint,
    RevoluteJoint,
    Surface,
    TimeScheme,
    TriangleMesh,
    sphere_mesh,
)
from taccel_lab.solvers import SolverConfig
from tests.support.blocks import everywhere, pose
from tests.support.variants import variants
from tests.verification.affine_scenes import G, Run, affine_scene, box, turned

NONE = (0.0, 0.0, 0.0)
# An irregular solid: no two principal moments are equal, no axis is the mesh's.
WEDGE = TriangleMesh(
    np.array([[0, 0, 0], [0.12, 0, 0.01], [0.02, 0.06, 0], [0.03, 0.02, 0.09]]),
    np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]),
)


def wedge(**options: Any) -> AffineBody:
    place = np.array([0.3, -0.2, 1.0, *turned((1, 2, 3), 1.0)])
    return AffineBody(WEDGE, initial_pose=place, **options)


def test_free_fall_is_exact() -> None:
    """Implicit Euler: x_n = x_0 + n dt v_0 - g dt^2 n (n + 1) / 2; the body does not turn."""
    velocity = np.array([0.4, -0.3, 2.0])
    run = Run(affine_scene([wedge(initial_velocity_m_s=tuple(velocity))]))
    expected, n = run.y, 30
    run.steps(n)
    expected[0, 0] += n * run.dt * velocity - [0, 0, G * run.dt**2 * n * (n + 1) / 2]
    np.testing.assert_allclose(run.y, expected, atol=1e-12)
    np.testing.assert_allclose(run.v[0, 0], velocity + [0, 0, -G * n * run.dt], rtol=1e-12)


@pytest.mark.parametrize(
    ("scheme", "spin_rad_s"),
    variants(
        [(TimeScheme.EULER, (6.0, -9.0, 4.0)), (TimeScheme.BDF2, (5.0, 7.0, -3.0))],
        TimeScheme,
        [(6.0, -9.0, 4.0), (5.0, 7.0, -3.0), (-2.0, 8.0, 6.0)],
    ),
)
def test_free_rotation(scheme: TimeScheme, spin_rad_s: tuple[float, float, float]) -> None:
    """Near 1e-10 N steps lower the energy by less than its last digit: it took 419 iterations."""
    body = wedge(initial_spin_rad_s=spin_rad_s, initial_velocity_m_s=(0.1, 0.2, 0.3))
    scene = affine_scene([body], gravity=NONE, dt=5e-3, scheme=scheme)
    # On some machines residuals below that are rounding.
    run = Run(scene, SolverConfig(absolute_tolerance_n=3e-9))
    momentum, energy, spin = run.momentum, run.kinetic_energy, run.angular_momentum
    start, strains, newton = run.maps[0], [], []
    for _ in range(60):
        before = run.v
        newton.append(run.step().newton_iterations[0])
        assert np.linalg.norm(run.momentum - momentum) < 1e-10 * np.linalg.norm(momentum)
        if scheme is TimeScheme.EULER:
            # Inner forces have no torque; that, not L itself, is what implicit Euler keeps.
            torque = np.linalg.norm(run.angular_impulse(run.v - before))
            assert torque < 1e-10 * np.linalg.norm(spin)
            assert run.kinetic_energy < energy
            energy = run.kinetic_energy
        strains.append(run.strain)
    assert max(strains) < 1e-4
    assert max(newton) <= (6 if spin_rad_s[0] == 6.0 else 3)
    lost = np.linalg.norm(run.angular_momentum - spin) / np.linalg.norm(spin)
    assert lost < {TimeScheme.EULER: 0.2, TimeScheme.BDF2: 0.01}[scheme]
    assert np.abs(run.maps[0] - start).max() > 0.1, "it has turned"


def test_spin_about_a_principal_axis_follows_the_rotations() -> None:
    """The rigid limit of implicit Euler: tan a' = sin a / (2 - cos a) for the angles of steps."""
    spin = 20.0
    rod = box("b", (0.1, 0.02, 0.03), initial_spin_rad_s=(0, 0, spin))
    run = Run(affine_scene([rod], gravity=NONE))
    # The first velocity is tangential: atan of the first step.
    expected, last, total = np.arctan(spin * run.dt), 0.0, 0.0
    for _ in range(30):
        run.step()
        a = run.maps[0]
        angle = np.unwrap([total, np.arctan2(a[1, 0], a[0, 0])])[1]
        last, total = angle - total, angle
        assert last == pytest.approx(expected, rel=1e-4)
        expected = np.arctan2(np.sin(expected), 2 - np.cos(expected))
    assert run.strain < 1e-4


def test_a_tilted_plate_that_slides_and_turns_in_its_first_contact() -> None:
    """It goes 15 lengths sideways while it stops: turning about its corner must not lift it off."""
    tilt = turned((1, -1, 0.3), 0.7)
    plate = box("plate", (4e-3, 3.2e-3, 1.6e-4), (0, 0, 0), tilt, young_modulus_pa=4.6e6)
    vertices = rotate(tilt[None], plate.shape.vertices_m)
    plate = replace(
        plate,
        initial_pose=np.array([0, 0, 1.5e-6 - vertices[:, 2].min(), *tilt]),
        initial_velocity_m_s=(1.2, -1.4, -8.0),
        initial_spin_rad_s=(10.0, -8.0, 9.0),
    )
    run = Run(affine_scene([plate], planes=[Plane()], dt=0.032), SolverConfig(dhat_m=1.7e-4))
    report = run.step()
    assert report.substeps[0] == 1
    assert report.newton_iterations[0] < 60
    assert run.crossings() == []


RADIUS, SLOPE = 20e-3, np.radians(10)


@pytest.mark.parametrize("friction", [0.5, 0.02])
def test_a_ball_on_a_slope(friction: float) -> None:
    """It rolls where mu > 2/7 tan, at 5/7 g sin, and else slides at g (sin - mu cos)."""
    # 2,562 vertices.
    mesh, dhat, n = sphere_mesh(RADIUS, 2e-3), 1e-4, 15
    properties = mass_properties(mesh, 1000.0)
    ratio = properties.mass_kg * RADIUS**2 / properties.inertia_kg_m2[1, 1]
    assert ratio == pytest.approx(2.5, rel=3e-3)
    reach = float(np.linalg.norm(mesh.vertices_m, axis=1).max())
    scene = affine_scene(
        AffineBody(
            mesh, friction_coefficient=friction, initial_pose=pose(0, 0, reach + 0.5 * dhat)
        ),
        planes=Plane(friction_coefficient=friction),
        gravity=(G * np.sin(SLOPE), 0.0, -G * np.cos(SLOPE)),
        dt=5e-3,
        scheme=TimeScheme.BDF2,
    )
    run = Run(scene, SolverConfig(dhat_m=dhat, kappa_pa=1e5))
    places, angles = [0.0], [0.0]
    for _ in range(2 * n):
        run.step()
        places.append(run.y[0, 0, 0])
        a = run.maps[0]
        angles.append(float(np.arctan2(-a[2, 0], a[0, 0])))
    assert run.crossings() == []
    found = np.diff(places[::n], n=2)[0] / (n * run.dt) ** 2
    arc = RADIUS * np.unwrap(angles)[-1]
    if friction > 2 / 7 * np.tan(SLOPE):
        assert found == pytest.approx(5 / 7 * G * np.sin(SLOPE), rel=1e-2)
        assert arc == pytest.approx(places[-1], rel=5e-3)
    else:
        assert found == pytest.approx(G * (np.sin(SLOPE) - friction * np.cos(SLOPE)), rel=1e-2)
        assert arc < 0.5 * places[-1]
    assert run.strain < 1e-4


MU = 0.35
BLOCK, SPRING, DRAG_SPEED, DRAG_DT = 20e-3, 20.0, 0.05, 2e-3
DHAT = 2e-5


def spring_forces(mass: float, limit: float, steps: int) -> np.ndarray:
    """Coulomb's law in steps of implicit Euler: the spring's force [N], shape [steps]."""
    place, speed, forces = 0.0, 0.0, []
    for step in range(1, steps + 1):
        gap = DRAG_SPEED * step * DRAG_DT - place
        # Sliding forward: m (v' - v) = dt (k (gap - dt v') - limit).
        ahead = mass * speed + DRAG_DT * (SPRING * gap - limit)
        speed = max(ahead / (mass + DRAG_DT**2 * SPRING), 0.0)
        place += DRAG_DT * speed
        forces.append(SPRING * (DRAG_SPEED * step * DRAG_DT - place))
    return np.array(forces)


def test_a_block_pulled_by_a_spring_sticks_and_slips() -> None:
    """It sticks until k V t = mu N, then the spring overshoots by V sqrt(k m), less damping."""
    size, place = (BLOCK, BLOCK, BLOCK), (0, 0, BLOCK / 2 + 0.9 * DHAT)
    block = box("block", size, place, friction_coefficient=MU)
    # It may sink and rise on a light carriage, which a spring pulls along x.
    apart = Surface(layer=2, collides_with=0)
    carriage = box("carriage", (5e-3, 5e-3, 5e-3), (0, 0, 0.1), density_kg_m3=100.0, surface=apart)
    rail = PrismaticJoint("carriage", None, (0, 0, 0.1), (1, 0, 0), drive=PositionDrive(SPRING))
    joints = [PrismaticJoint("block", "carriage", (0, 0, 0), (0, 0, 1), name="guide"), rail]
    floor = Plane(friction_coefficient=MU)
    scene = affine_scene([block, carriage], joints, floor, dt=DRAG_DT)
    run = Run(scene, SolverConfig(dhat_m=DHAT, kappa_pa=1e4))
    run.steps(5)
    weight, mass = run.masses[0, 0, 0] * G, run.masses[:, 0, 0].sum()
    limit, steps = MU * weight, 220
    slips = round(limit / (SPRING * DRAG_SPEED * DRAG_DT))
    forces = []
    for step in range(1, steps + 1):
        assert run.state.joints is not None and run.solver.joints is not None
        end = DRAG_SPEED * step * DRAG_DT
        run.state.joints.targets.assign(np.array([[0.0, end]]))
        run.step()
        forces.append(SPRING * (end - run.solver.joints.coordinates.numpy()[0, 1]))
        if step == slips - 1:
            assert run.v[0, 0, 0] < run.solver.config.friction_speed_m_s, "it sticks"
        assert run.force("block")[2] == pytest.approx(weight, rel=2e-3)
    expected = spring_forces(mass, limit, steps)
    np.testing.assert_allclose(forces, expected, atol=0.01 * limit)
    overshoot = (max(forces) - limit) / (DRAG_SPEED * np.sqrt(SPRING * mass))
    assert 0.9 < overshoot < 1
    assert forces[slips - 2] == pytest.approx(SPRING * DRAG_SPEED * (slips - 1) * DRAG_DT, rel=1e-2)


LENGTH, ANGLE = 60e-3, np.radians(45)


@pytest.mark.parametrize("direction", [1, -1], ids=["trailing", "pushed"])
def test_a_rod_dragged_by_its_upper_end(direction: int) -> None:
    """N (cos +- mu sin) = (W / 2) cos about the hinge, at 45 degrees; + where it trails."""
    top = np.array([0, 0, LENGTH * np.sin(ANGLE) + 2.0e-3])
    # The rod's lower end lies behind, at negative x.
    along = np.array([-np.cos(ANGLE), 0, -np.sin(ANGLE)])
    middle, rotation = top + 0.5 * LENGTH * along, turned((0, 1, 0), -ANGLE)
    rod = box("rod", (LENGTH, 4e-3, 1e-3), middle, rotation, friction_coefficient=MU)
    hinge = RevoluteJoint("rod", "hand", top, (0, 1, 0), second_pose=pose(*top))
    floor, hand = Plane(friction_coefficient=MU), KinematicBody(None, name="hand")
    scene = affine_scene([rod], [hinge], floor, hand, dt=5e-3)
    run = Run(scene, SolverConfig(dhat_m=DHAT, kappa_pa=1e5), everywhere(1, pose(*top)))
    for _ in range(8):
        run.step(pose(*top))
    found = []
    for step in range(1, 13):
        run.step(pose(top[0] + direction * 0.1 * step * run.dt, *top[1:]))
        found.append([run.force("rod")[2], run.friction("rod").sum(axis=0)[0]])
    normal, rubs = np.mean(found[6:], axis=0)
    low = run.vertices[run.vertices[:, 2].argmin()]
    hinge_at = top + [direction * 0.1 * 12 * run.dt, 0, 0]
    r, c = low - hinge_at, run.y[0, 0] - hinge_at
    # Both moments about the hinge, about y, with the tip where it is.
    expected = run.weight * c[0] / (r[0] + direction * MU * r[2])
    assert rubs == pytest.approx(-direction * MU * normal, rel=1e-3)
    assert normal == pytest.approx(expected, rel=1e-3)
    assert run.crossings() == []
