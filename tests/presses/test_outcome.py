# SPDX-License-Identifier: Apache-2.0
"""``simulate_press``: what is read at the end agrees with itself; speed, hold and way back of gels
that relax, and of others, which time does not change."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import taccel_lab as tl
from taccel_lab.camera.gel_camera import camera_of, face_of
from taccel_lab.files.atomic_file import to_jsonable
from taccel_lab.presses import PHYSICS, Indenter, PressPhysics, SeenFrom, simulate_press
from taccel_lab.presses.mesh import press_mesh
from taccel_lab.presses.path import HOLD_STEPS
from taccel_lab.scene import MaxwellBranch
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.signals.forces import resultant_wrench
from taccel_lab.signals.rest_surface import rest_surface
from tests.support.blocks import block_mesh
from tests.support.coarse_pads import COARSE, FINER, GEL, LINEAR, pad

GRID = tl.PixelGrid(64, 48, 0.1, 0.1)
X, Y = np.meshgrid(GRID.x_mm() * 1e-3, GRID.y_mm() * 1e-3)
AT_MM = (0.5, -0.3)
PATH = tl.PressPath(0.5, (0.06, 0.0), 2.0, step_mm=0.25)


def press(
    mesh: Any, tool: Indenter, path: tl.PressPath, friction: float,
    physics: PressPhysics = PHYSICS[tl.Accuracy.DEFAULT], **more: Any,
) -> tl.PressOutcome:  # fmt: skip
    setup = tl.PressSetup(mesh, GEL, tool, friction, physics)
    return simulate_press(setup, AT_MM, path, SeenFrom(GRID), **more)


@pytest.fixture(scope="module")
def pressed():
    """A ball in a finer pad, with shear and twist, and its steps as they were done."""
    steps = []
    tool, mesh = tl.parse_indenter("sphere:2.0"), pad(AT_MM, 1.0, FINER)
    return press(mesh, tool, PATH, 0.5, progress=lambda *step: steps.append(step)), steps


@pytest.fixture(scope="module")
def outcome(pressed):
    return pressed[0]


@pytest.mark.thorough
def test_forces_add_up_to_the_wrench(outcome):
    on_gel = resultant_wrench(outcome.positions_m[None], outcome.contact_forces_n[None])[0]
    wrench = outcome.steps[-1].wrench
    assert wrench == pytest.approx(-on_gel, abs=1e-12)
    assert outcome.contact_forces_n.sum(axis=0) == pytest.approx(-wrench[:3], abs=1e-12)
    assert wrench[2] > 0 > wrench[0]
    # Nodes of the contact face alone are touched, middles of edges among them.
    corners = pad(AT_MM, 1.0, FINER).node_count
    assert np.abs(outcome.contact_forces_n[corners:]).max() > 0
    assert 0 < outcome.smallest_volume_ratio < 1
    touched = np.flatnonzero(np.abs(outcome.contact_forces_n).max(axis=1) > 0)
    assert np.isin(touched, outcome.mesh.region_nodes(tl.Region.CONTACT)).all()
    bonded = outcome.mesh.bonded_nodes()
    assert np.array_equal(outcome.positions_m[bonded], outcome.mesh.nodes_m[bonded])


@pytest.mark.thorough
def test_surface_wraps_the_ball(outcome):
    points = np.stack([X, Y, outcome.height_m], axis=-1) - outcome.indenter_pose[:3]
    distance = np.linalg.norm(points, axis=-1) - 2e-3
    inside = outcome.contact_mask
    assert inside.any() and not inside.all()
    # Nothing pokes through the ball; where they touch, the gap is at most dhat.
    assert np.nanmin(distance) > -1e-6
    assert distance[inside].max() < 2.5e-5
    assert np.nanmin(distance[~inside]) > 0
    # The normal of the gel in contact is the ball's; at its rim, where the last pixel in contact
    # meets the first beside it, 4.6 degrees were measured.
    outward = -points / np.linalg.norm(points, axis=-1, keepdims=True)
    cosine = (outward * outcome.normals).sum(axis=-1)[inside]
    assert np.quantile(cosine, 0.05) > np.cos(np.radians(3))
    assert cosine.min() > np.cos(np.radians(6))
    area = inside.sum() * (GRID.mm_per_px_x * 1e-3) ** 2
    assert outcome.contact_radius_m == pytest.approx(np.sqrt(area / np.pi), rel=0.1)
    # Between Hertz on a half-space and the cap that the depth cuts off.
    assert 0.9e-3 < outcome.contact_radius_m < 1.33e-3


def test_rest_surface_is_the_dome(outcome):
    dome = np.sqrt(50e-3**2 - X**2 - Y**2) - 50e-3
    # Facets of edge h dip by h^2 / 8 R: 20 um where this coarse mesh is coarsest.
    assert outcome.rest_height_m == pytest.approx(dome, abs=2e-5)
    near = np.hypot(X - AT_MM[0] * 1e-3, Y - AT_MM[1] * 1e-3) < 1.5e-3
    assert outcome.rest_height_m[near] == pytest.approx(dome[near], abs=1e-6)
    for normals in (outcome.rest_normals, outcome.normals):
        assert np.linalg.norm(normals, axis=-1) == pytest.approx(np.ones(X.shape))
    sunk = outcome.height_m - outcome.rest_height_m
    v, u = np.unravel_index(np.argmin(sunk), sunk.shape)
    assert [GRID.x_mm()[u], GRID.y_mm()[v]] == pytest.approx([0.56, -0.3], abs=0.15)
    assert sunk.min() == pytest.approx(-0.5e-3, abs=3e-5)


def test_figures_progress_and_pose(pressed):
    outcome, done = pressed
    assert [step[:2] for step in done] == [(1, 3), (2, 3), (3, 3)]
    assert [step[2] for step in done] == outcome.steps
    assert [(s.depth_mm, s.shear_mm, s.twist_deg) for s in outcome.steps] == PATH.waypoints()
    pose = outcome.indenter_pose
    touch = np.sqrt(52e-3**2 - (np.array(AT_MM) ** 2).sum() * 1e-6) - 50e-3
    place = [0.56e-3, -0.3e-3, touch - 0.5e-3 + outcome.setback_m]
    assert pose[:2] == pytest.approx(place[:2]) and pose[2] == pytest.approx(place[2], abs=1e-6)
    assert 0 < outcome.setback_m < outcome.physics.dhat_m
    assert pose[3:] == pytest.approx([0, 0, np.sin(np.pi / 180), np.cos(np.pi / 180)])
    figures = outcome.figures()
    reports = [step.report for step in outcome.steps]
    assert figures["force_n"] == outcome.steps[-1].wrench[2]
    assert figures["residual_n"] <= 1e-4 * figures["contact_force_sum_n"]
    assert figures["newton_iterations"] == sum(int(r.newton_iterations[0]) for r in reports)
    assert "seconds" not in json.dumps(figures, default=str), "equal presses have equal figures"
    assert figures["min_distance_m"] == min(float(r.min_distance_m[0]) for r in reports) > 0
    assert figures["step_count"] == len(figures["steps"]) == 3
    assert [step["depth_mm"] for step in figures["steps"]] == [0.25, 0.5, 0.5]
    assert 0 < figures["steps"][0]["force_n"][2] < figures["steps"][1]["force_n"][2]
    json.dumps(to_jsonable(figures), allow_nan=False)


@pytest.mark.thorough
def test_a_flat_indenter_leaves_a_flat_floor():
    outcome = press(pad(AT_MM), tl.parse_indenter("cylinder:1.0"), PATH, 0.0)
    away = np.hypot(X - outcome.indenter_pose[0], Y - outcome.indenter_pose[1])
    end = outcome.indenter_pose[2] - 2e-3
    floor = outcome.height_m[away < 0.8e-3]
    assert end - 2.5e-5 <= floor.max() < end
    assert outcome.contact_mask[away < 0.8e-3].mean() > 0.9
    assert not outcome.contact_mask[away > 1.2e-3].any()


@pytest.mark.thorough
def test_a_flange_far_above_the_gel_does_not_show():
    """A stamp on a plate, 10 mm above its face, is the stamp alone."""
    corners = 0.5e-3 * np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    sizes = ((3, 0.0), (3, 10e-3), (16, 10e-3), (16, 12e-3))
    rings = [np.column_stack([size * corners, np.full(4, z)]) for size, z in sizes]
    faces = [[0, 2, 1], [0, 3, 2], [12, 13, 14], [12, 14, 15]]
    for low in (0, 4, 8):
        for k in range(4):
            a, b = low + k, low + (k + 1) % 4
            faces += [[a, b, b + 4], [a, b + 4, a + 4]]
    plate = Indenter("plate", tl.TriangleMesh(np.concatenate(rings), np.array(faces)))
    plated, alone = (
        press(pad(AT_MM, 1.5, COARSE), tool, tl.PressPath(0.2), 0.0, physics=LINEAR)
        for tool in (plate, tl.parse_indenter("box:3x3"))
    )
    # Pixels at the rim are in contact by a pressure above zero after ten iterations: two of 890
    # differ between surfaces whose triangles differ.
    one, other = (int(found.contact_mask.sum()) for found in (plated, alone))
    assert abs(one - other) <= 4 and other > 500
    apart = np.abs(plated.height_m - alone.height_m)
    assert apart.max() < 5e-6 and (apart > 1e-6).sum() <= 4


@pytest.mark.thorough
def test_heights_of_a_dome_reach_its_border():
    """The mesh of a press has few nodes along it: height maps ended in a polygon."""
    profile = catalogue_profile("rtac", {"width_px": 160, "height_px": 120})
    camera, physics = camera_of(profile), PHYSICS[tl.Accuracy.FAST]
    tool = tl.parse_indenter("sphere:4")
    mesh = press_mesh("rtac", {}, (0.0, 0.0), tool.contact(0.1), physics.mesh)
    setup = tl.PressSetup(mesh, tl.Material(55e3, 0.46), tool, physics=physics)
    seen = SeenFrom(camera, rest_surface(profile.mesh, face_of(camera)))
    found = simulate_press(setup, (0.0, 0.0), tl.PressPath(0.1), seen)
    assert (np.isfinite(found.height_m) == np.isfinite(found.rest_height_m)).mean() > 0.999


MESH = block_mesh((6, 6, 3), (8e-3, 8e-3, 3e-3))
BRANCH = MaxwellBranch(0.4, 2.0)
RELAXING = replace(GEL, branches=(BRANCH,))
COARSE_GRID = tl.PixelGrid(16, 16, 0.4, 0.4)
LOAD = tl.PressPath(0.5)
DOWN = len(LOAD.way_there())


def in_time(
    path: tl.PressPath, material: tl.Material = RELAXING, friction: float = 0.0
) -> tl.PressOutcome:
    setup = tl.PressSetup(MESH, material, tl.parse_indenter("sphere:3"), friction, LINEAR)
    return simulate_press(setup, (0.0, 0.0), path, SeenFrom(COARSE_GRID))


def forces(outcome: tl.PressOutcome) -> np.ndarray:
    return np.array([step.wrench[2] for step in outcome.steps])


@pytest.fixture(scope="module")
def plain():
    return in_time(LOAD, GEL)


def test_a_hold_is_where_the_indenter_is_and_takes_its_time():
    path = replace(LOAD, shear_mm=(0.1, 0.0), twist_deg=4.0, hold_s=8.0, back=True, speed_mm_s=0.5)
    points, times, there = path.waypoints(), path.durations_s(), path.way_there()
    assert len(points) == len(times) == 2 * len(there) + HOLD_STEPS
    held = slice(len(there), len(there) + HOLD_STEPS)
    assert set(points[held]) == {there[-1]} and points[-1] == (0.0, (0.0, 0.0), 0.0)
    assert sum(times[held]) == pytest.approx(8.0)
    assert (np.diff(times[held]) > 0).all()
    # Down and up at 0.5 mm/s; the turn of two steps takes as long as two of 0.2 mm.
    assert sum(times[:DOWN]) == sum(times[-DOWN:]) == pytest.approx(1.0)
    assert sum(times[DOWN : held.start]) == pytest.approx(0.8)


def test_a_hold_relaxes_and_a_way_back_loses_work(plain):
    outcome = in_time(replace(LOAD, hold_s=6.0, back=True))
    found, relaxed = forces(outcome), forces(plain)[-1]
    held = found[DOWN - 1 : DOWN + HOLD_STEPS]
    assert (np.diff(held) < 0).all()
    # Of 0.4 what 0.5 s of loading and 6 s leave, by a force that grows as depth^1.5 does.
    assert held[0] / relaxed == pytest.approx(1 + 0.4 * 0.91, rel=0.01)
    left = (held[-1] - relaxed) / (held[0] - relaxed)
    assert left == pytest.approx(np.exp(-6.0 / BRANCH.time_s), abs=0.01)
    figures = outcome.figures()
    assert figures["hold"] == {"from_n": held[0], "to_n": held[-1], "seconds": 6.0}
    assert 0.2 < figures["loop"]["lost_share"] < 0.5
    times = [step["time_s"] for step in figures["steps"]]
    assert times[DOWN - 1] == pytest.approx(0.5) and times[-1] == pytest.approx(7.0)
    assert abs(found[-1]) < 1e-6 < found[-2], "it has left a gel that is still dented"
    assert (outcome.rest_height_m - outcome.height_m).max() > 1e-5


@pytest.mark.thorough
def test_friction_holds_while_the_indenter_rests(plain):
    """However long: static friction allows as little sliding in a long step as in a short one."""
    path = replace(LOAD, hold_s=60.0)
    found, relaxed = (forces(in_time(path, gel, 1.0))[-1] for gel in (RELAXING, GEL))
    assert relaxed > 1.02 * forces(plain)[-1]
    assert found == pytest.approx(relaxed, rel=5e-3)


@pytest.mark.thorough
def test_a_slow_press_is_softer_than_a_fast_one(plain):
    for speed, ratio, rel in ((1e3, 1.4, 2e-3), (1e-3, 1.0, 2e-2)):
        found = forces(in_time(replace(LOAD, speed_mm_s=speed)))[-1]
        assert found / forces(plain)[-1] == pytest.approx(ratio, rel=rel)


@pytest.mark.thorough
def test_a_gel_that_does_not_relax_goes_back_as_it_came(plain):
    outcome = in_time(replace(LOAD, back=True), GEL)
    found = forces(outcome)
    np.testing.assert_array_equal(found[:DOWN], forces(plain))
    np.testing.assert_allclose(found[DOWN:-1], found[: DOWN - 1][::-1], rtol=2e-3)
    assert outcome.figures()["loop"]["lost_share"] < 2e-3
    figures = plain.figures()
    assert not {"hold", "loop"} & {*figures} and "time_s" not in figures["steps"][0]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"hold_s": 1.0}, "does not relax"),
        ({"speed_mm_s": 1.0}, "does not relax"),
        ({"hold_s": -1.0}, "hold must lie"),
        ({"speed_mm_s": 0.0}, "speed must lie"),
        ({"unload": True, "accuracy": "3%"}, "--unload takes away"),
    ],
)
def test_what_makes_no_sense_is_refused(options, words):
    with pytest.raises(tl.InputError, match=words):
        tl.press("flat_pad", "sphere:4", depth_mm=0.3, **options)
