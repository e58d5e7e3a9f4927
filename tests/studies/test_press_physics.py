# SPDX-License-Identifier: Apache-2.0
"""Simulated standard presses against closed forms, scaling laws and each other."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from taccel_lab.envs import PHYSICS, Accuracy, PressEnv, parse_indenter
from taccel_lab.geometry.press_mesh_options import OutlineMeshOptions
from taccel_lab.scene import Material
from taccel_lab.studies.evidence import profile_mm
from taccel_lab.studies.metrics.edge_sharpness import rise_width
from taccel_lab.studies.metrics.two_point import contrast
from taccel_lab.studies.press_batch import REFERENCE_PA, simulate
from tests.studies.coarse_presses import THICK, coarse, jobs, pressed

NU = 0.46
DEFAULT = PHYSICS[Accuracy.DEFAULT].mesh
E_STAR = REFERENCE_PA / (1 - NU**2)


def test_a_ball_on_a_thick_pad_follows_hertz() -> None:
    # Twenty times as thick as the contact is wide, it takes more layers than any sensor's.
    mesh = replace(DEFAULT, layers=5)
    press = coarse("sphere", depth_fraction=0.0, depth_mm=0.3, steps=2, mesh=mesh)
    record = pressed(press, **THICK)
    force = record.force_n[:, 2]
    # Contact begins within the barrier's layer of 0.02 mm, which adds to the depth.
    low = 4 / 3 * E_STAR * math.sqrt(3e-3) * (record.depth_mm * 1e-3) ** 1.5
    high = 4 / 3 * E_STAR * math.sqrt(3e-3) * (record.depth_mm * 1e-3 + 2e-5) ** 1.5
    # Coarse tets and the floor 20 mm below add a few per cent.
    assert (low < force).all() and (force < 1.04 * high).all()


def test_a_flat_punch_on_a_thick_pad() -> None:
    press = coarse(
        "punch", indenters=("cylinder:1",), depth_fraction=0.0, depth_mm=0.1, steps=2, mesh=DEFAULT
    )
    record = pressed(press, **THICK)
    slope = float(np.diff(record.force_n[:, 2])[0] / np.diff(record.depth_mm * 1e-3)[0])
    # Sneddon 1965: F = 2 E* a d; a layer twenty radii thick and coarse tets are a little stiffer.
    assert 1.0 < slope / (2 * E_STAR * 1e-3) < 1.12


def test_thin_bonded_gels_are_stiffer() -> None:
    press = coarse("sphere", depth_fraction=0.0, depth_mm=0.4, steps=2)
    forces = [
        pressed(press, thickness_mm=t, crown_radius_mm=0).force_n[-1, 2] for t in (8.0, 4.0, 2.0)
    ]
    assert forces[0] < forces[1] < forces[2]
    assert forces[2] > 1.3 * forces[0]


def test_positions_do_not_depend_on_the_modulus() -> None:
    """What lets designs of other stiffness take over simulations: forces scale, shapes stay; with
    friction as well."""
    job = jobs(coarse("shear", steps=2, shear_steps=1, twist_steps=1), friction=1.0)[0]
    press = job.press
    found = {}
    for modulus in (REFERENCE_PA, 7.3 * REFERENCE_PA):
        env = PressEnv(
            job.mesh,
            Material(modulus, NU),
            parse_indenter(job.indenter),
            np.zeros((1, 2)),
            friction_coefficient=job.friction,
            gel_from_press=job.gel_from_press[None],
        )
        depth = press.full_depth_mm(float(env.thickness_m[0]) * 1e3)
        for point in press.waypoints():
            shear = (point.shear * press.shear_fraction * depth, 0.0)
            env.move_to(depth * point.depth, shear, point.twist * press.twist_deg)
        found[modulus] = env.positions[0].copy(), env.press_force[0] / modulus
    (x, f), (y, g) = found.values()
    assert g == pytest.approx(f, abs=2 * PHYSICS[Accuracy.DEFAULT].relative_tolerance * f[2])
    assert np.abs(x - y).max() < 2e-3 * np.abs(x - env.mesh.nodes_m).max()


def test_records_scale() -> None:
    record = pressed(coarse("sphere", steps=2))
    twice = record.scaled(2.0)
    assert np.array_equal(twice.force_n, 2 * record.force_n)
    assert np.array_equal(twice.bond_peak_pa, 2 * record.bond_peak_pa)
    assert twice.moved_m is record.moved_m and np.array_equal(twice.depth_mm, record.depth_mm)


def test_a_batch_gives_what_its_designs_give_alone() -> None:
    press = coarse("sphere", steps=2)
    made = [jobs(press, thickness_mm=t)[0] for t in (5.0, 3.0)]
    together = [simulated.record for simulated in simulate(made)]
    for job, record in zip(made, together, strict=True):
        alone = simulate([job])[0].record
        assert record.depth_mm == pytest.approx(alone.depth_mm)
        assert record.force_n == pytest.approx(alone.force_n, rel=2e-3, abs=1e-4)
        assert record.mesh.nodes_m == pytest.approx(alone.mesh.nodes_m)
    assert together[0].depth_mm[-1] == pytest.approx(2.0, rel=1e-3)
    assert together[1].depth_mm[-1] == pytest.approx(1.2, rel=1e-3)


def test_edges_are_blurred_over_the_thickness() -> None:
    widths = []
    for thickness in (2.0, 4.0, 8.0):
        record = pressed(
            coarse("edge", depth_fraction=0.0, depth_mm=0.2, steps=1),
            thickness_mm=thickness,
            crown_radius_mm=0,
        )
        x, change = profile_mm(record, 8.0)
        widths.append(rise_width(x, -change))
    assert widths[0] < widths[1] < widths[2]
    assert widths[2] > 1.5 * widths[0]


def test_far_pins_are_told_apart_and_near_ones_less() -> None:
    contrasts = []
    for gap in (0.06, 3.0):
        press = coarse(
            "pairs",
            indenters=(f"pair:0.3x{gap}",),
            depth_fraction=0.0,
            depth_mm=0.4,
            steps=1,
            mesh=replace(DEFAULT, scattered=OutlineMeshOptions(core=8, outer=2, layers=2)),
        )
        x, change = profile_mm(pressed(press, thickness_mm=4.0), 0.6 + gap)
        contrasts.append(contrast(x, -change, 0.3 + gap / 2))
    assert contrasts[0] < 0.45 and contrasts[1] > 0.8


def test_friction_alone_makes_loops_that_lose_work() -> None:
    from taccel_lab.studies.metrics.hysteresis import lost_part

    press = coarse("shear", steps=2, shear_steps=2, shear_fraction=0.5, twist_deg=0.0)
    lost = {}
    for friction in (0.1, 1.0):
        record = pressed(press, friction=friction)
        start = record.down.stop - 1
        lost[friction] = lost_part(record.shear_mm[start:], -record.force_n[start:, 0])
    # A ball that slips loses work, one that sticks gives it back.
    assert lost[0.1] > 0.5
    assert lost[1.0] < 0.5 * lost[0.1]
    assert lost[1.0] > -0.01


def test_twist_is_resisted_about_the_normal() -> None:
    record = pressed(coarse("shear", steps=2, shear_steps=1, twist_steps=1))
    assert record.twist_deg[-1] == 8.0
    assert record.torque_nm[-1] < 0
    assert abs(record.torque_nm[record.down.stop - 1]) < 0.1 * abs(record.torque_nm[-1])
