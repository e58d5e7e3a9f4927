# SPDX-License-Identifier: Apache-2.0
"""Tools with edges, facets and hard spots in whole presses, contacts of pixels, faces at rest."""

from __future__ import annotations

import numpy as np
import pytest
import pyvista
import torch

from taccel_lab.geometry import PixelGrid
from taccel_lab.presses import (
    PHYSICS,
    Accuracy,
    Indenter,
    PressOutcome,
    PressPath,
    parse_indenter,
    simulate_press,
)
from taccel_lab.scene import Ball, Material, TriangleMesh, box_mesh, sphere_mesh
from taccel_lab.sensors.press_mesh import press_mesh
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.sensors.registry import sensor_family
from taccel_lab.signals.layer_contact import layer_compliance, solve_contact
from taccel_lab.signals.rest_surface import rest_surface

DEPTH_MM, AT_MM = 0.5, (1.2, -0.8)


@pytest.mark.thorough
def test_a_roller_touches_all_between_its_ends():
    """Its ends press many times as hard as its middle, which touches as well."""
    tool, physics = parse_indenter("roller:1.5x4"), PHYSICS[Accuracy.FAST]
    mesh = press_mesh("gelsight_mini", {}, AT_MM, tool.contact(DEPTH_MM), physics.mesh)
    grid = PixelGrid(198, 148, 0.0872, 0.0872)
    press = simulate_press(
        mesh, Material(1.5e5, 0.48), tool, AT_MM, PressPath(DEPTH_MM), grid,
        friction_coefficient=0.3, physics=physics,
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


@pytest.mark.slow
def test_the_wall_beside_a_punch_is_even():
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


@pytest.mark.thorough
def test_a_side_that_is_not_along_the_pixels_is_straight():
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


@pytest.mark.slow
def test_facets_of_a_ball_do_not_show():
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


@pytest.mark.thorough
def test_a_file_lands_where_its_coordinates_say(tmp_path):
    """A peg that stands off the origin of its file on the side of +z, pressed off the middle."""
    box = box_mesh((3e-3, 1e-3, 2e-3))
    path = tmp_path / "peg.ply"
    points = 1e3 * box.vertices_m + [2.0, -1.5, 9.0]
    pyvista.make_tri_mesh(points, box.faces).save(path)
    grid = PixelGrid(160, 120, 0.1, 0.1)
    at_mm = (-1.0, 0.5)
    indenter, physics = parse_indenter(f"mesh:{path}@+z"), PHYSICS[Accuracy.FAST]
    mesh = press_mesh("flat_pad", {}, at_mm, indenter.contact(0.3), physics.mesh)
    press = simulate_press(
        mesh, Material(1.5e5, 0.48), indenter, at_mm, PressPath(0.3), grid,
        friction_coefficient=0.0, physics=physics,
    )  # fmt: skip
    rows, columns = np.nonzero(press.contact_mask)
    assert grid.x_mm()[columns].mean() == pytest.approx(1.0, abs=0.06)
    assert grid.y_mm()[rows].mean() == pytest.approx(2.0, abs=0.06)
    assert np.ptp(grid.x_mm()[columns]) == pytest.approx(2.9, abs=0.11)
    assert np.ptp(grid.y_mm()[rows]) == pytest.approx(0.9, abs=0.11)


YOUNG, POISSON = 1.5e5, 0.46
PLANE = YOUNG / (1 - POISSON**2)


def solved(
    grid: PixelGrid, thickness_m: float, obj: np.ndarray, **options: int
) -> tuple[np.ndarray, np.ndarray]:
    """Height [m] and pressures [Pa] of a flat gel under an object."""
    compliance = layer_compliance(grid, YOUNG, POISSON, thickness_m).astype(np.float32)
    under = obj.astype(np.float32)
    flat = np.zeros_like(under)
    options = {"iterations": 20, **options}
    height, pressure = solve_contact(compliance, under, flat, flat, **options)
    return height.astype(float), pressure.astype(float)


def ball(grid: PixelGrid, radius_m: float, depth_m: float) -> np.ndarray:
    x, y = np.meshgrid(1e-3 * grid.x_mm(), 1e-3 * grid.y_mm())
    return np.minimum((x**2 + y**2) / (2 * radius_m), 1e-3) - depth_m


def test_a_ball_on_a_thick_layer_is_hertz_s():
    """Pressures, contact and force of one depth; a layer 12 contact radii thick is 8 % stiffer
    against the depth, but not between these."""
    grid, radius, depth = PixelGrid(240, 240, 0.012, 0.012), 5e-3, 2e-5
    height, pressure = solved(grid, 4e-3, ball(grid, radius, depth)[None])
    pixel = (0.012e-3) ** 2
    force = pressure.sum() * pixel
    a = np.sqrt((pressure > 0).sum() * pixel / np.pi)
    assert a == pytest.approx((3 * force * radius / (4 * PLANE)) ** (1 / 3), rel=0.02)
    assert pressure.max() == pytest.approx(1.5 * force / (np.pi * a**2), rel=0.03)
    under = ball(grid, radius, depth)
    assert (height[0] <= under + 1e-12).all()
    np.testing.assert_allclose(height[0][pressure[0] > 0], under[pressure[0] > 0], atol=4e-9)
    # Beside the contact: Johnson, Contact Mechanics, (3.42a), about the level where it touches.
    x, y = np.meshgrid(1e-3 * grid.x_mm(), 1e-3 * grid.y_mm())
    r = np.hypot(x, y)
    ring = (r > 1.1 * a) & (r < 2.5 * a)
    s = r[ring]
    sunk = (
        1.5
        * force
        / (np.pi * a**2)
        / (2 * PLANE * a)
        * ((2 * a**2 - s**2) * np.arcsin(a / s) + s * a * np.sqrt(1 - (a / s) ** 2))
    )
    difference = height[0][ring] + sunk
    assert np.ptp(difference) < 0.03 * depth


@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
def test_a_wave_touches_as_much_as_westergaard_says(share):
    """Mean pressure over that of full contact, p* = pi E' A / lambda, is sin^2(pi w / 2), w being
    the part of the wave that touches [Westergaard 1939; Johnson 1985, section 13.2]."""
    grid = PixelGrid(256, 8, 0.004, 0.004)
    wave, amplitude = 256 * 0.004e-3, 5e-6
    x = 1e-3 * grid.x_mm()
    full = np.pi * PLANE * amplitude / wave
    k = 3 - 4 * POISSON
    thickness = 4e-3
    squeezed = 8 * thickness * (k - 1) / ((k + 1) ** 2 * PLANE)
    obj = np.tile(amplitude * np.cos(2 * np.pi * x / wave), (8, 1))
    # The mean of z is - squeezed p; in full contact that of the object.
    open_m = {0.2: 0.6, 0.5: 0.9, 0.8: 1.0}[share]
    lowered = obj - share * full * squeezed - amplitude * (1 - open_m)
    _, pressure = solved(grid, thickness, lowered[None], iterations=200)
    mean, part = pressure.mean() / full, (pressure[0, 0] > 0).mean()
    assert 0.05 < mean < 0.98
    assert mean == pytest.approx(np.sin(0.5 * np.pi * part) ** 2, abs=0.02)


def test_a_gpu_s_library_finds_the_same():
    """Presses on a CPU load no torch: both libraries go through the same lines."""
    grid = PixelGrid(120, 100, 0.03, 0.03)
    compliance = layer_compliance(grid, YOUNG, POISSON, 4e-3).astype(np.float32)
    under = ball(grid, 2e-3, 1e-4)[None].astype(np.float32)
    flat, coarse = np.zeros_like(under), np.where(under < 0, 1e3, 0.0).astype(np.float32)
    given = (compliance, under, flat, coarse)
    height, pressure = solve_contact(*given)
    theirs = solve_contact(*map(torch.as_tensor, given))
    assert height.dtype == pressure.dtype == np.float32
    np.testing.assert_allclose(theirs[0].numpy(), height, atol=1e-9)
    np.testing.assert_allclose(theirs[1].numpy(), pressure, atol=1e-4 * pressure.max())


def test_what_is_right_already_stays():
    """A coarse solution that meets the object is given back."""
    grid = PixelGrid(96, 96, 0.03, 0.03)
    obj = ball(grid, 5e-3, 1e-4)[None]
    height, pressure = solved(grid, 4e-3, obj, iterations=100)
    compliance = layer_compliance(grid, YOUNG, POISSON, 4e-3).astype(np.float32)
    given = [a.astype(np.float32) for a in (obj, height, pressure)]
    sharpened = solve_contact(compliance, *given)
    np.testing.assert_allclose(sharpened[0], height, atol=1e-7)
    assert sharpened[1].sum() == pytest.approx(pressure.sum(), rel=3e-3)
    again = solve_contact(compliance, *given, sharpenings=0, iterations=20)
    np.testing.assert_allclose(again[0], height, atol=4e-9)
    np.testing.assert_allclose(again[1], pressure, atol=4e-3 * pressure.max())


def test_environments_do_not_know_each_other():
    """To the bit, in batches of one size: of other sizes some processors round otherwise."""
    grid = PixelGrid(64, 48, 0.03, 0.03)
    objects = np.stack([ball(grid, 5e-3, depth) for depth in (1e-4, -1e-3, 3e-5)])
    together = solved(grid, 4e-3, objects)
    for env, obj in enumerate(objects):
        among_equals = solved(grid, 4e-3, obj[None].repeat(len(objects), axis=0))
        for whole, equals in zip(together, among_equals, strict=True):
            np.testing.assert_array_equal(whole[env], equals[env])
    assert not together[1][1].any() and not together[0][1].any()


@pytest.mark.thorough
def test_a_press_on_a_crowned_pad_is_right_far_from_the_contact():
    profile = catalogue_profile("gelsight_mini")
    family, grid = sensor_family("gelsight_mini"), profile.grid()
    tool, physics = parse_indenter("sphere:2"), PHYSICS[Accuracy.FAST]
    mesh = press_mesh("gelsight_mini", {}, (0.0, 0.0), tool.contact(0.1), physics.mesh)
    arguments = (mesh, Material(1e5, 0.46), tool, (0.0, 0.0), PressPath(0.1), grid)
    plain = simulate_press(*arguments, friction_coefficient=0.0, physics=physics)
    designed = rest_surface(profile.mesh, grid)
    corrected = simulate_press(
        *arguments, friction_coefficient=0.0, physics=physics, designed_rest=designed
    )
    columns, rows = np.meshgrid(np.arange(grid.width_px), np.arange(grid.height_px))
    xy = grid.gel_from_pixel(np.stack([columns, rows], axis=-1).astype(float))
    truth = family.parameters({}).pad().height_mm(xy) * 1e-3
    far = np.hypot(*xy.transpose(2, 0, 1)) > 5.0

    def rms(height):
        return float(np.sqrt(np.nanmean((height - truth)[far] ** 2)))

    assert rms(plain.height_m) > 3e-5
    assert rms(corrected.height_m) < 5e-6
    assert rms(corrected.rest_height_m) < 5e-6
    moved = corrected.height_m - corrected.rest_height_m
    near = ~far & ~corrected.contact_mask & np.isfinite(moved)
    assert moved[near] == pytest.approx((plain.height_m - plain.rest_height_m)[near], abs=1e-9)
    # Where the ball touches, it gives the height.
    touched = corrected.contact_mask
    assert corrected.height_m[touched] == pytest.approx(plain.height_m[touched], abs=1e-12)
