# SPDX-License-Identifier: Apache-2.0
"""``simulate_press``: what is read at the end of a press agrees with itself."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from taccel_lab.camera.gel_camera import camera_of, face_of
from taccel_lab.files.atomic_file import to_jsonable
from taccel_lab.geometry import PixelGrid, Region
from taccel_lab.presses import (
    PHYSICS,
    Accuracy,
    Indenter,
    PressOutcome,
    PressPath,
    parse_indenter,
    simulate_press,
)
from taccel_lab.scene import Material, TriangleMesh
from taccel_lab.sensors.press_mesh import press_mesh
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.signals.forces import resultant_wrench
from taccel_lab.signals.rest_surface import rest_surface
from tests.support.coarse_pads import COARSE, FINER, GEL, LINEAR, pad

GRID = PixelGrid(64, 48, 0.1, 0.1)
X, Y = np.meshgrid(GRID.x_mm() * 1e-3, GRID.y_mm() * 1e-3)
AT_MM = (0.5, -0.3)
PATH = PressPath(0.5, (0.06, 0.0), 2.0, step_mm=0.25)


def press(mesh: Any, tool: Indenter, path: PressPath, friction: float, **more: Any) -> PressOutcome:
    return simulate_press(mesh, GEL, tool, AT_MM, path, GRID, friction_coefficient=friction, **more)


@pytest.fixture(scope="module")
def pressed():
    """A ball in a finer pad, with shear and twist, and its steps as they were done."""
    steps = []
    tool, mesh = parse_indenter("sphere:2.0"), pad(AT_MM, 1.0, FINER)
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
    assert np.isin(touched, outcome.mesh.region_nodes(Region.CONTACT)).all()
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
    outcome = press(pad(AT_MM), parse_indenter("cylinder:1.0"), PATH, 0.0)
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
    plate = Indenter("plate", TriangleMesh(np.concatenate(rings), np.array(faces)))
    plated, alone = (
        press(pad(AT_MM, 1.5, COARSE), tool, PressPath(0.2), 0.0, physics=LINEAR)
        for tool in (plate, parse_indenter("box:3x3"))
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
    camera, physics = camera_of(profile), PHYSICS[Accuracy.FAST]
    tool = parse_indenter("sphere:4")
    mesh = press_mesh("rtac", {}, (0.0, 0.0), tool.contact(0.1), physics.mesh)
    found = simulate_press(
        mesh, Material(55e3, 0.46), tool, (0.0, 0.0), PressPath(0.1), camera,
        friction_coefficient=0.0, physics=physics,
        designed_rest=rest_surface(profile.mesh, face_of(camera)),
    )  # fmt: skip
    assert (np.isfinite(found.height_m) == np.isfinite(found.rest_height_m)).mean() > 0.999
