# SPDX-License-Identifier: Apache-2.0
"""Standard presses: paths, refusals, jobs; simulated ones against closed forms and each other."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import Delaunay

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.presses import PHYSICS, Accuracy, PressEnv, parse_indenter
from taccel_lab.presses.mesh import press_mesh
from taccel_lab.presses.mesh_options import OutlineMeshOptions
from taccel_lab.scene import Material
from taccel_lab.sensors.families.gelsight import GelSightParameters
from taccel_lab.studies.metrics.evidence import profile_mm
from taccel_lab.studies.metrics.shear import lost_part
from taccel_lab.studies.metrics.surface import contrast
from taccel_lab.studies.presses.press_batch import REFERENCE_PA, place_mm, press_jobs, simulate
from taccel_lab.studies.presses.press_record import section_heights
from taccel_lab.studies.presses.standard import (
    DEFAULT_PRESSES,
    STANDARD_PRESSES,
    StandardPress,
    standard_presses,
)
from tests.studies.coarse_presses import COARSE, THICK, coarse, jobs, pressed, sphere_on_gelsight
from tests.support.variants import variants


def test_the_standard_six() -> None:
    assert DEFAULT_PRESSES == ("sphere", "punch", "cylinder", "edge", "grating", "shear")
    assert [press.name for press in standard_presses()] == list(DEFAULT_PRESSES)
    assert standard_presses(["pairs"]) == [STANDARD_PRESSES["pairs"]]


@pytest.mark.parametrize("press", STANDARD_PRESSES.values(), ids=lambda press: press.name)
def test_paths(press: StandardPress) -> None:
    path = press.waypoints()
    assert [point.depth for point in path[: press.steps]] == pytest.approx(
        np.arange(1, press.steps + 1) / press.steps
    )
    for a, b in itertools.pairwise(path):
        assert 0 <= b.depth <= 1 and abs(b.shear - a.shear) <= 1 / press.shear_steps + 1e-12
    assert path[-1].depth == (0.0 if press.release else 1.0)
    assert max(point.shear for point in path) == (1.0 if press.shear_fraction else 0.0)
    assert path[-1].twist == (1.0 if press.twist_deg else 0.0)


def test_shear_goes_back_before_the_twist_and_depth_follows_the_thickness() -> None:
    path = replace(STANDARD_PRESSES["shear"], shear_steps=2, twist_steps=1).waypoints()
    after = [(point.shear, point.twist) for point in path[-5:]]
    assert after == [(0.5, 0), (1.0, 0), (0.5, 0), (0.0, 0), (0.0, 1.0)]
    press = replace(STANDARD_PRESSES["sphere"], depth_fraction=0.4, depth_limit_mm=2.0)
    assert press.full_depth_mm(1.5) == pytest.approx(0.6)
    assert press.full_depth_mm(50.0) == 2.0
    fixed = replace(press, depth_fraction=0.0, depth_mm=0.3)
    assert fixed.full_depth_mm(1.5) == fixed.full_depth_mm(10.0) == 0.3


SMALL = {"length_x_mm": 12.0, "length_y_mm": 12.0}


@pytest.mark.parametrize(
    ("make", "message"),
    [
        *[
            (lambda c=changes: dataclasses.replace(STANDARD_PRESSES["sphere"], **c), message)
            for changes, message in (
                ({"name": "a b"}, "must be a word"),
                ({"indenters": ()}, "at least one indenter"),
                ({"indenters": ("ball:3",)}, "not understood"),
                ({"places": ()}, "at least one indenter and one place"),
                ({"places": ((2.0, 0.0),)}, "in \\[-1, 1\\]"),
                ({"depth_mm": 1.0}, "either depth_fraction or depth_mm"),
                ({"depth_fraction": 0.0}, "either depth_fraction or depth_mm"),
                ({"depth_fraction": 0.9}, "depth_fraction must lie in"),
                ({"depth_limit_mm": 0.0}, "depth_limit_mm must be above 0"),
                ({"twist_deg": 180.0}, "twist_deg must lie in"),
                ({"shear_fraction": float("nan")}, "shear_fraction must lie in"),
                ({"steps": 0}, r"steps must lie in \[1, 200\], got 0"),
            )
        ],
        (lambda: standard_presses(["ball"]), "no press 'ball'; known: sphere, punch"),
        (lambda: jobs(coarse("sphere", places=((1.0, 1.0),)), **SMALL),
         r"beside the contact face|inside the pad"),
    ],
)  # fmt: skip
def test_bad_presses(make: Callable[[], object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()


def test_places_are_parts_of_the_view_and_presses_go_along_the_normal() -> None:
    grid = PixelGrid(101, 51, 0.1, 0.2, center_u_px=40)
    assert place_mm(grid, (0, 0)) == pytest.approx((1.0, 0.0))
    assert place_mm(grid, (1, -1)) == pytest.approx((6.0, -5.0))
    pose = jobs(coarse("sphere", places=((0.5, 0.0),)))[0].gel_from_press
    assert pose[0] == pytest.approx(0.25 * 639 * 0.0295e-3)
    assert pose[2] == pytest.approx(np.sqrt(0.05**2 - pose[0] ** 2) - 0.05)
    assert 2 * np.arcsin(pose[4]) == pytest.approx(np.arcsin(pose[0] / 0.05))


def test_a_press_of_a_study_is_meshed_as_any_press() -> None:
    job = press_jobs(STANDARD_PRESSES["punch"], GelSightParameters())[0]
    pad = GelSightParameters().pad()
    outline = parse_indenter("cylinder:2").contact(0.15 * pad.thickness_mm)
    mesh = press_mesh("gelsight", {}, (0.0, 0.0), outline)
    assert np.array_equal(job.setup.mesh.tets, mesh.tets)
    assert job.setup.mesh.nodes_m == pytest.approx(mesh.nodes_m, abs=1e-12)


def test_alike_designs_share_keys() -> None:
    press = coarse("sphere")
    first = jobs(press)[0]
    for alike in ({"young_modulus_mpa": 0.5}, {"density_kg_m3": 1500}):
        assert jobs(press, **alike)[0].key == first.key
    for other in ({"thickness_mm": 4.0}, {"poisson_ratio": 0.4}, {"friction": 0.5}):
        assert jobs(press, **other)[0].key != first.key
    assert jobs(press, thickness_mm=4.8)[0].batch_key == first.batch_key
    for apart in (
        jobs(press, friction=0.5),
        jobs(coarse("sphere", mesh=replace(COARSE, core=6))),
        jobs(coarse("sphere", steps=4)),
    ):
        assert apart[0].batch_key != first.batch_key
    assert jobs(coarse("sphere", name="ball"))[0].key == first.key


# Physics ------------------------------------------------------------------------------------------


NU = 0.46
DEFAULT = PHYSICS[Accuracy.DEFAULT].mesh
E_STAR = REFERENCE_PA / (1 - NU**2)


@pytest.mark.thorough
def test_a_ball_on_a_thick_pad_follows_hertz() -> None:
    # Twenty times as thick as the contact is wide, it takes more layers than any sensor's.
    mesh = replace(DEFAULT, layers=5)
    press = coarse("sphere", depth_fraction=0.0, depth_mm=0.3, steps=2, mesh=mesh)
    record = pressed(press, **THICK)
    # Contact begins within the barrier's layer of 0.02 mm, which adds to the depth.
    low, high = (
        4 / 3 * E_STAR * math.sqrt(3e-3) * (record.depth_mm * 1e-3 + layer_m) ** 1.5
        for layer_m in (0.0, 2e-5)
    )
    # Coarse tets and the floor 20 mm below add a few per cent.
    force = record.force_n[:, 2]
    assert (low < force).all() and (force < 1.04 * high).all()


@pytest.mark.thorough
def test_a_flat_punch_on_a_thick_pad() -> None:
    press = coarse(
        "punch", indenters=("cylinder:1",), depth_fraction=0.0, depth_mm=0.1, steps=2, mesh=DEFAULT
    )
    record = pressed(press, **THICK)
    slope = float(np.diff(record.force_n[:, 2])[0] / np.diff(record.depth_mm * 1e-3)[0])
    # Sneddon 1965: F = 2 E* a d; a layer twenty radii thick and coarse tets are a little stiffer.
    assert 1.0 < slope / (2 * E_STAR * 1e-3) < 1.12


@pytest.mark.thorough
def test_positions_do_not_depend_on_the_modulus() -> None:
    """What lets designs of other stiffness take over simulations: forces scale, shapes stay; with
    friction as well."""
    job = jobs(coarse("shear", steps=1, shear_steps=1, twist_steps=1), friction=1.0)[0]
    press, found = job.press, []
    for modulus in (REFERENCE_PA, 7.3 * REFERENCE_PA):
        gel, how = Material(modulus, NU), PHYSICS[Accuracy.DEFAULT]
        setup = replace(job.setup, material=gel, physics=how)
        env = PressEnv(setup, np.zeros((1, 2)), gel_from_press=job.gel_from_press[None])
        depth = press.full_depth_mm(float(env.thickness_m[0]) * 1e3)
        for point in press.waypoints():
            shear = (point.shear * press.shear_fraction * depth, 0.0)
            env.move_to(depth * point.depth, shear, point.twist * press.twist_deg)
        found.append((env.positions[0].copy(), env.press_force[0] / modulus))
    (x, f), (y, g) = found
    assert g == pytest.approx(f, abs=2 * PHYSICS[Accuracy.DEFAULT].relative_tolerance * f[2])
    assert np.abs(x - y).max() < 2e-3 * np.abs(x - env.mesh.nodes_m).max()


@pytest.mark.thorough
def test_records_scale() -> None:
    record = sphere_on_gelsight()
    twice = record.scaled(2.0)
    assert np.array_equal(twice.force_n, 2 * record.force_n)
    assert np.array_equal(twice.bond_peak_pa, 2 * record.bond_peak_pa)
    assert twice.moved_m is record.moved_m and np.array_equal(twice.depth_mm, record.depth_mm)


@pytest.mark.thorough
def test_a_batch_gives_what_its_designs_give_alone() -> None:
    press = coarse("sphere", steps=1, depth_fraction=0.15)
    made = [jobs(press, thickness_mm=t)[0] for t in (5.0, 4.7)]
    together = [simulated.record for simulated in simulate(made)]
    for job, record, depth_mm in zip(made, together, (0.75, 0.705), strict=True):
        alone = simulate([job])[0].record
        assert record.depth_mm == pytest.approx(alone.depth_mm)
        assert record.force_n == pytest.approx(alone.force_n, rel=2e-3, abs=1e-4)
        assert record.mesh.nodes_m == pytest.approx(alone.mesh.nodes_m)
        assert record.depth_mm[-1] == pytest.approx(depth_mm, rel=1e-3)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("gap", "low", "high"),
    [(3.0, 0.8, 1.0), pytest.param(0.06, -1.0, 0.45, marks=pytest.mark.slow)],
)
def test_far_pins_are_told_apart_and_near_ones_less(gap: float, low: float, high: float) -> None:
    mesh = replace(COARSE, scattered=OutlineMeshOptions(core=4, outer=2, layers=2))
    press = coarse(
        "pairs", indenters=(f"pair:0.3x{gap}",), depth_fraction=0.0, depth_mm=0.4, steps=1,
        mesh=mesh,
    )  # fmt: skip
    x, change = profile_mm(pressed(press, thickness_mm=4.0), 0.6 + gap)
    assert low < contrast(x, -change, 0.3 + gap / 2) <= high


def test_a_section_is_the_piecewise_linear_interpolant() -> None:
    """As scipy's on the same triangles."""
    rng = np.random.default_rng(0)
    plane = rng.uniform(-1, 1, (300, 2))
    plane[:20, 1] = 0.0  # Nodes on the line, and edges along it.
    mesh, heights = Delaunay(plane), rng.normal(size=300)
    x = np.linspace(-1.2, 1.2, 500)
    points = np.column_stack([plane, heights])
    found = section_heights(points, mesh.simplices, x)
    expected = LinearNDInterpolator(mesh, heights)(x, np.zeros(500))
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert np.isnan(found).any() and np.isfinite(found).sum() > 300
    # Of two surfaces the upper one is seen.
    both = np.concatenate([points, points - [0, 0, 1]])
    faces = np.concatenate([mesh.simplices + 300, mesh.simplices])
    np.testing.assert_array_equal(section_heights(both, faces, x), found)


@pytest.mark.thorough
@pytest.mark.parametrize("friction", variants([0.1], [0.1, 1.0]))
def test_friction_alone_makes_loops_that_lose_work(friction: float) -> None:
    """A ball that slips loses work, one that sticks gives it back; both resist the twist."""
    record = pressed(
        coarse("shear", steps=1, shear_steps=2, shear_fraction=0.5, twist_steps=1),
        friction=friction,
    )
    loop = slice(record.down.stop - 1, -1)
    lost = lost_part(record.shear_mm[loop], -record.force_n[loop, 0])
    assert 0.5 < lost if friction < 1 else -0.01 < lost < 0.25
    assert record.twist_deg[-1] == 8.0 and record.torque_nm[-1] < 0
    assert abs(record.torque_nm[record.down.stop - 1]) < 0.1 * abs(record.torque_nm[-1])
