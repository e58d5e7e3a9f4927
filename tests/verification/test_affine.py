# SPDX-License-Identifier: Apache-2.0
"""Affine bodies against mechanics: free flight, free rotation, friction on a slope."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from taccel_lab.model.embedding import rotate
from taccel_lab.scene import AffineBody, Plane, TimeScheme, TriangleMesh
from taccel_lab.solvers import SolverConfig
from tests.verification.affine_scenes import DOWN, G, Run, affine_scene, box, turned

NONE = (0.0, 0.0, 0.0)
# An irregular solid: no two principal moments are equal, no axis is the mesh's.
WEDGE = TriangleMesh(
    np.array([[0, 0, 0], [0.12, 0, 0.01], [0.02, 0.06, 0], [0.03, 0.02, 0.09]]),
    np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]),
)


def wedge(**options: object) -> AffineBody:
    pose = np.array([0.3, -0.2, 1.0, *turned((1, 2, 3), 1.0)])
    return AffineBody(WEDGE, name="wedge", initial_pose=pose, **options)  # type: ignore[arg-type]


def test_free_fall_is_exact() -> None:
    """Implicit Euler: x_n = x_0 + n dt v_0 - g dt^2 n (n + 1) / 2; the body does not turn."""
    velocity = np.array([0.4, -0.3, 2.0])
    run = Run(affine_scene([wedge(initial_velocity_m_s=tuple(velocity))]))
    start, n = run.y, 30
    for _ in range(n):
        run.step()
    fallen = np.array([0, 0, -G * run.dt**2 * n * (n + 1) / 2])
    np.testing.assert_allclose(
        run.y[0, 0], start[0, 0] + n * run.dt * velocity + fallen, atol=1e-12
    )
    np.testing.assert_allclose(run.y[0, 1:], start[0, 1:], atol=1e-12)
    np.testing.assert_allclose(run.v[0, 0], velocity + [0, 0, -G * n * run.dt], rtol=1e-12)


@pytest.mark.parametrize("scheme", list(TimeScheme))
def test_free_rotation_of_an_asymmetric_body(scheme: TimeScheme) -> None:
    body = wedge(initial_spin_rad_s=(6.0, -9.0, 4.0), initial_velocity_m_s=(0.1, 0.2, 0.3))
    run = Run(
        affine_scene([body], gravity=NONE, dt=5e-3, scheme=scheme),
        # On some machines residuals below that are rounding.
        SolverConfig(absolute_tolerance_n=3e-9),
    )
    momentum, energy, spin = run.momentum, run.kinetic_energy, run.angular_momentum
    strains, newton = [], []
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
    assert max(newton) <= 6
    lost = np.linalg.norm(run.angular_momentum - spin) / np.linalg.norm(spin)
    assert lost < {TimeScheme.EULER: 0.2, TimeScheme.BDF2: 0.01}[scheme]
    assert np.abs(run.maps[0] - run.maps[0].T).max() > 0.1


@pytest.mark.parametrize("spin", [(5.0, 7.0, -3.0), (-2.0, 8.0, 6.0)])
@pytest.mark.parametrize("scheme", list(TimeScheme))
def test_rounding_of_the_energy_holds_nothing_up(
    scheme: TimeScheme, spin: tuple[float, float, float]
) -> None:
    """Steps that lower the residual from 1e-8 N to 1e-10 N lower the energy by 1e-19 J, which is
    less than its last digit: one in 60 took 419 iterations when that was not allowed for."""
    body = wedge(initial_spin_rad_s=spin, initial_velocity_m_s=(0.1, 0.2, 0.3))
    scene = affine_scene([body], gravity=NONE, dt=5e-3, scheme=scheme)
    run = Run(scene, SolverConfig(absolute_tolerance_n=3e-9))
    assert max(run.step().newton_iterations[0] for _ in range(60)) <= 3


@pytest.mark.parametrize("spin", [2.0, 20.0])
def test_spin_about_a_principal_axis_follows_the_rotations(spin: float) -> None:
    """The rigid limit of implicit Euler: tan a' = sin a / (2 - cos a) for the angles of steps."""
    run = Run(
        affine_scene([box("b", (0.1, 0.02, 0.03), initial_spin_rad_s=(0, 0, spin))], gravity=NONE)
    )
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


def on_slope(friction: float, slope: float) -> Run:
    """A box at rest just above a plane; gravity is what is tilted."""
    gravity = (G * np.sin(slope), 0.0, -G * np.cos(slope))
    body = box("block", (0.1, 0.1, 0.04), (0, 0, 0.02 + 1e-5), friction_coefficient=friction)
    return Run(affine_scene([body], planes=[Plane()], gravity=gravity))


@pytest.mark.parametrize(("friction", "slope"), [(0.2, 0.5), (0.0, 0.3)])
def test_a_block_above_the_friction_angle_slides(friction: float, slope: float) -> None:
    """At g (sin - mu cos), from the first step that is held by the plane."""
    run = on_slope(friction, slope)
    for _ in range(5):
        run.step()
    before, n = run.v[0, 0, 0], 15
    for _ in range(n):
        run.step()
    found = (run.v[0, 0, 0] - before) / (n * run.dt)
    assert found == pytest.approx(G * (np.sin(slope) - friction * np.cos(slope)), rel=1e-3)
    assert run.strain < 1e-4
    assert run.overlaps() == []


def test_a_dropped_box_comes_to_rest() -> None:
    """Through an impact on an edge, without energy from nowhere and without overlap."""
    body = box(
        "b", (0.1, 0.06, 0.04), (0, 0, 0.12), turned((1, 0.3, 0.2), 0.5), friction_coefficient=0.4
    )
    run = Run(affine_scene([body], planes=[Plane()], gravity=DOWN))
    mass = run.masses[0, 0, 0]
    total = mass * G * run.y[0, 0, 2]
    for _ in range(60):
        run.step()
        assert run.overlaps() == []
        energy = run.kinetic_energy + mass * G * run.y[0, 0, 2]
        # What the contact and the body's stiffness give back is stored at most for a step.
        assert energy < total * (1 + 1e-6)
        total = min(total, energy * (1 + 1e-3))
        assert run.strain < 1e-4
    assert run.kinetic_energy < 1e-6 * mass * G * 0.1
    assert run.y[0, 0, 2] == pytest.approx(0.02, abs=3e-5)


def test_a_tilted_plate_that_slides_and_turns_in_its_first_contact() -> None:
    """It goes 15 of its lengths sideways in the step that stops its fall: the turn about the corner
    that touches must not lift it off. On the screw of both it took 909 Newton iterations."""
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
    assert run.overlaps() == []
