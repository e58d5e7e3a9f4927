# SPDX-License-Identifier: Apache-2.0
"""Tools with edges, facets, and contacts that press hard in some places, in whole presses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import pyvista

from taccel_lab.envs import Indenter, PressOutcome, PressPath, parse_indenter, simulate_press
from taccel_lab.geometry import PixelGrid
from taccel_lab.scene import Ball, Material, TriangleMesh, box_mesh, sphere_mesh
from taccel_lab.sensors.press_mesh import press_mesh

DEPTH_MM, AT_MM = 0.5, (1.2, -0.8)


def test_a_roller_touches_all_between_its_ends() -> None:
    """Its ends press many times as hard as its middle, which touches as well."""
    tool = parse_indenter("roller:1.5x4")
    mesh = press_mesh("gelsight_mini", {}, AT_MM, tool.contact(DEPTH_MM))
    grid = PixelGrid(198, 148, 0.0872, 0.0872)
    press = simulate_press(
        mesh, Material(1.5e5, 0.48), tool, AT_MM, PressPath(DEPTH_MM), grid,
        friction_coefficient=0.3,
    )  # fmt: skip
    rows, columns = np.nonzero(press.contact_mask)
    box = (np.ptp(rows) + 1) * (np.ptp(columns) + 1)
    assert len(rows) > 0.9 * box
    assert 4.0 <= (np.ptp(rows) + 1) * grid.mm_per_px_y < 4.2
    # The gel lies below the tool and no deeper than that went.
    sunk_mm = 1e3 * (press.height_m - press.rest_height_m)
    assert -1.01 * DEPTH_MM < sunk_mm.min() < -0.99 * DEPTH_MM


def _press(indenter: Indenter, depth_mm: float, grid: PixelGrid) -> PressOutcome:
    mesh = press_mesh("flat_pad", {}, (0.0, 0.0), indenter.contact(depth_mm))
    return simulate_press(
        mesh, Material(1.5e5, 0.48), indenter, (0.0, 0.0), PressPath(depth_mm), grid,
        friction_coefficient=0.4,
    )  # fmt: skip


def test_the_wall_beside_a_punch_is_even() -> None:
    """As high everywhere along a side, and higher with every pixel away from it: no facets."""
    grid = PixelGrid(160, 160, 0.06, 0.06, 79.6, 79.7)
    press = _press(parse_indenter("box:4x4"), 0.8, grid)
    x_mm, y_mm = np.meshgrid(grid.x_mm(), grid.y_mm())
    sunk_mm = 1e3 * (press.height_m - press.rest_height_m)
    floor = np.maximum(np.abs(x_mm), np.abs(y_mm)) < 1.9
    assert np.ptp(sunk_mm[floor]) < 1e-3
    rows = np.abs(y_mm[:, 0]) < 1.2
    for columns in (
        np.flatnonzero(x_mm[0] > 2.08)[:20],
        np.flatnonzero(x_mm[0] < -2.08)[::-1][:20],
    ):
        beside = sunk_mm[rows][:, columns]
        assert (np.diff(beside, axis=1) > -1e-3).all()
        # Rows of the image cut the side alike; nodes are 0.5 mm apart along it.
        assert np.ptp(beside, axis=0).max() < 0.04
        tilt = np.degrees(np.arccos(press.normals[rows][:, columns, 2]))
        assert tilt.std(axis=0).max() < 1.5


def test_a_side_that_is_not_along_the_pixels_is_straight() -> None:
    """A punch turned by 17 degrees: where its floor is half of a pixel, on a line to a fifth."""
    grid = PixelGrid(120, 120, 0.08, 0.08)
    box = box_mesh((4e-3, 4e-3, 4e-3))
    turn = np.radians(17.0)
    normal = np.array([np.cos(turn), np.sin(turn)])
    rotation = np.array([[normal[0], -normal[1], 0], [normal[1], normal[0], 0], [0, 0, 1]])
    shape = TriangleMesh(box.vertices_m @ rotation.T, box.faces)
    press = _press(Indenter("turned box", shape), 0.5, grid)
    tilt = np.arccos(np.clip(press.normals[..., 2], -1, 1))
    off_px = []
    for row in range(45, 75):
        y = grid.y_mm()[row]
        right = grid.x_mm() > 0
        # The first pixel that leans by half of what the wall does, to a part of a pixel.
        half = 0.5 * tilt[row, right].max()
        column = int(np.argmax(tilt[row, right] > half))
        before, after = tilt[row, right][column - 1 : column + 1]
        x = grid.x_mm()[right][column] - grid.mm_per_px_x * (after - half) / (after - before)
        off_px.append((x * normal[0] + y * normal[1] - 2.0) / grid.mm_per_px_x)
    assert np.std(off_px) < 0.25
    assert abs(np.mean(off_px)) < 0.5


def test_facets_of_a_ball_do_not_show() -> None:
    """Chords of 0.5 mm turn by 14 degrees from one to the next, of which nothing is seen but for
    a pixel or two beside their ridges, where the gel's coarse face keeps 4 um away."""
    grid = PixelGrid(120, 120, 0.05, 0.05)
    ball = _press(Indenter("ball", Ball(2e-3)), 0.6, grid)
    facets = _press(Indenter("facets", sphere_mesh(2e-3, 0.5e-3)), 0.6, grid)
    x_mm, y_mm = np.meshgrid(grid.x_mm(), grid.y_mm())
    contact = np.hypot(x_mm, y_mm) < 0.85e3 * ball.contact_radius_m
    cosine = (ball.normals * facets.normals).sum(axis=-1)[contact]
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    assert np.sqrt((angle**2).mean()) < 1.0 and np.quantile(angle, 0.99) < 3.0
    assert facets.contact_radius_m == pytest.approx(ball.contact_radius_m, rel=0.06)


def test_a_file_lands_where_its_coordinates_say(tmp_path: Path) -> None:
    """A peg that stands off the origin of its file on the side of +z, pressed off the middle."""
    box = box_mesh((3e-3, 1e-3, 2e-3))
    path = tmp_path / "peg.ply"
    points = 1e3 * box.vertices_m + [2.0, -1.5, 9.0]
    pyvista.make_tri_mesh(points, box.faces).save(path)
    grid = PixelGrid(160, 120, 0.1, 0.1)
    at_mm = (-1.0, 0.5)
    for name, y_mm in ((f"mesh:{path}", -1.0), (f"mesh:{path}@+z", 2.0)):
        indenter = parse_indenter(name)
        mesh = press_mesh("flat_pad", {}, at_mm, indenter.contact(0.3))
        press = simulate_press(mesh, Material(1.5e5, 0.48), indenter, at_mm, PressPath(0.3), grid)
        rows, columns = np.nonzero(press.contact_mask)
        assert grid.x_mm()[columns].mean() == pytest.approx(1.0, abs=0.06)
        assert grid.y_mm()[rows].mean() == pytest.approx(y_mm, abs=0.06)
        assert np.ptp(grid.x_mm()[columns]) == pytest.approx(2.9, abs=0.11)
        assert np.ptp(grid.y_mm()[rows]) == pytest.approx(0.9, abs=0.11)
