# SPDX-License-Identifier: Apache-2.0
"""Tools with edges, facets and hard spots in whole presses, contacts of pixels, faces at rest."""

from __future__ import annotations

import numpy as np
import pytest
import pyvista
import torch

import taccel_lab as tl
from taccel_lab.presses import PHYSICS, Indenter, SeenFrom, simulate_press
from taccel_lab.presses.mesh import press_mesh
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.sensors.registry import sensor_family
from taccel_lab.signals.layer_contact import layer_compliance, solve_contact
from taccel_lab.signals.rest_surface import RestSurface, rest_surface


def press(
    indenter: Indenter, depth_mm: float, grid: tl.PixelGrid, sensor: str = "flat_pad",
    at_mm: tuple[float, float] = (0.0, 0.0), friction: float = 0.0,
    accuracy: tl.Accuracy = tl.Accuracy.FAST, designed_rest: RestSurface | None = None,
) -> tl.PressOutcome:  # fmt: skip
    physics = PHYSICS[accuracy]
    mesh = press_mesh(sensor, {}, at_mm, indenter.contact(depth_mm), physics.mesh)
    setup = tl.PressSetup(mesh, tl.Material(1.5e5, 0.48), indenter, friction, physics)
    return simulate_press(setup, at_mm, tl.PressPath(depth_mm), SeenFrom(grid, designed_rest))


def sunk_mm(press: tl.PressOutcome) -> np.ndarray:
    return 1e3 * (press.height_m - press.rest_height_m)


@pytest.mark.thorough
def test_a_roller_touches_all_between_its_ends():
    """Its ends press many times as hard as its middle, which touches as well."""
    grid = tl.PixelGrid(198, 148, 0.0872, 0.0872)
    found = press(tl.parse_indenter("roller:1.5x4"), 0.5, grid, "gelsight_mini", (1.2, -0.8), 0.3)
    rows, columns = np.nonzero(found.contact_mask)
    assert len(rows) > 0.9 * (np.ptp(rows) + 1) * (np.ptp(columns) + 1)
    assert 4.0 <= (np.ptp(rows) + 1) * grid.mm_per_px_y < 4.2
    # The gel lies below the tool and no deeper than that went.
    assert -1.01 * 0.5 < sunk_mm(found).min() < -0.99 * 0.5


@pytest.mark.slow
def test_the_wall_beside_a_punch_is_even():
    """As high everywhere along a side, and higher with every pixel away from it: no facets."""
    grid = tl.PixelGrid(160, 160, 0.06, 0.06, 79.6, 79.7)
    found = press(
        tl.parse_indenter("box:4x4"), 0.8, grid, friction=0.4, accuracy=tl.Accuracy.DEFAULT
    )
    x_mm, y_mm = np.meshgrid(grid.x_mm(), grid.y_mm())
    floor = np.maximum(np.abs(x_mm), np.abs(y_mm)) < 1.9
    assert np.ptp(sunk_mm(found)[floor]) < 1e-3
    rows = np.abs(y_mm[:, 0]) < 1.2
    for columns in (
        np.flatnonzero(x_mm[0] > 2.08)[:20],
        np.flatnonzero(x_mm[0] < -2.08)[::-1][:20],
    ):
        beside = sunk_mm(found)[rows][:, columns]
        assert (np.diff(beside, axis=1) > -1e-3).all()
        # Rows of the image cut the side alike; nodes are 0.5 mm apart along it.
        assert np.ptp(beside, axis=0).max() < 0.04
        tilt = np.degrees(np.arccos(found.normals[rows][:, columns, 2]))
        assert tilt.std(axis=0).max() < 1.5


@pytest.mark.thorough
def test_a_side_that_is_not_along_the_pixels_is_straight():
    """A punch turned by 17 degrees: where its floor is half of a pixel, on a line to a fifth."""
    grid, box = tl.PixelGrid(120, 120, 0.08, 0.08), tl.box_mesh((4e-3, 4e-3, 4e-3))
    c, s = np.cos(np.radians(17.0)), np.sin(np.radians(17.0))
    rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    turned = Indenter("turned box", tl.TriangleMesh(box.vertices_m @ rotation.T, box.faces))
    found = press(turned, 0.5, grid, friction=0.4, accuracy=tl.Accuracy.DEFAULT)
    right = grid.x_mm() > 0
    off_px = []
    for row in range(45, 75):
        tilt = np.arccos(np.clip(found.normals[row, right, 2], -1, 1))
        # The first pixel that leans by half of what the wall does, to a part of a pixel.
        half = 0.5 * tilt.max()
        column = int(np.argmax(tilt > half))
        before, after = tilt[column - 1 : column + 1]
        x = grid.x_mm()[right][column] - grid.mm_per_px_x * (after - half) / (after - before)
        off_px.append((x * c + grid.y_mm()[row] * s - 2.0) / grid.mm_per_px_x)
    assert np.std(off_px) < 0.25
    assert abs(np.mean(off_px)) < 0.5


@pytest.mark.slow
def test_facets_of_a_ball_do_not_show():
    """Chords of 0.5 mm turn by 14 degrees from one to the next, of which nothing is seen but for
    a pixel or two beside their ridges, where the gel's coarse face keeps 4 um away."""
    grid = tl.PixelGrid(120, 120, 0.05, 0.05)
    ball, facets = (
        press(Indenter("ball", shape), 0.6, grid, friction=0.4, accuracy=tl.Accuracy.DEFAULT)
        for shape in (tl.Ball(2e-3), tl.sphere_mesh(2e-3, 0.5e-3))
    )
    x_mm, y_mm = np.meshgrid(grid.x_mm(), grid.y_mm())
    contact = np.hypot(x_mm, y_mm) < 0.85e3 * ball.contact_radius_m
    cosine = (ball.normals * facets.normals).sum(axis=-1)[contact]
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    assert np.sqrt((angle**2).mean()) < 1.0 and np.quantile(angle, 0.99) < 3.0
    assert facets.contact_radius_m == pytest.approx(ball.contact_radius_m, rel=0.06)


@pytest.mark.thorough
def test_a_file_lands_where_its_coordinates_say(tmp_path):
    """A peg that stands off the origin of its file on the side of +z, pressed off the middle."""
    box, path = tl.box_mesh((3e-3, 1e-3, 2e-3)), tmp_path / "peg.ply"
    pyvista.make_tri_mesh(1e3 * box.vertices_m + [2.0, -1.5, 9.0], box.faces).save(path)
    grid = tl.PixelGrid(160, 120, 0.1, 0.1)
    found = press(tl.parse_indenter(f"mesh:{path}@+z"), 0.3, grid, at_mm=(-1.0, 0.5))
    rows, columns = np.nonzero(found.contact_mask)
    x, y = grid.x_mm()[columns], grid.y_mm()[rows]
    assert (x.mean(), y.mean()) == pytest.approx((1.0, 2.0), abs=0.06)
    assert (np.ptp(x), np.ptp(y)) == pytest.approx((2.9, 0.9), abs=0.11)


@pytest.mark.thorough
def test_a_press_on_a_crowned_pad_is_right_far_from_the_contact():
    profile, tool = catalogue_profile("gelsight_mini"), tl.parse_indenter("sphere:2")
    grid = profile.grid()
    plain, corrected = (
        press(tool, 0.1, grid, "gelsight_mini", designed_rest=rest)
        for rest in (None, rest_surface(profile.mesh, grid))
    )
    columns, rows = np.meshgrid(np.arange(grid.width_px), np.arange(grid.height_px))
    xy = grid.gel_from_pixel(np.stack([columns, rows], axis=-1).astype(float))
    truth = sensor_family("gelsight_mini").parameters({}).pad().height_mm(xy) * 1e-3
    far = np.hypot(*xy.transpose(2, 0, 1)) > 5.0

    def rms(height):
        return float(np.sqrt(np.nanmean((height - truth)[far] ** 2)))

    assert rms(plain.height_m) > 3e-5
    assert rms(corrected.height_m) < 5e-6
    assert rms(corrected.rest_height_m) < 5e-6
    moved = sunk_mm(corrected)
    near = ~far & ~corrected.contact_mask & np.isfinite(moved)
    assert moved[near] == pytest.approx(sunk_mm(plain)[near], abs=1e-6)
    # Where the ball touches, it gives the height.
    touched = corrected.contact_mask
    assert corrected.height_m[touched] == pytest.approx(plain.height_m[touched], abs=1e-12)


YOUNG, POISSON, THICKNESS_M = 1.5e5, 0.46, 4e-3
PLANE = YOUNG / (1 - POISSON**2)


def compliance_of(grid: tl.PixelGrid) -> np.ndarray:
    return layer_compliance(grid, YOUNG, POISSON, THICKNESS_M).astype(np.float32)


def solved(
    grid: tl.PixelGrid, obj: np.ndarray, iterations: int = 20
) -> tuple[np.ndarray, np.ndarray]:
    """Height [m] and pressures [Pa] of a flat gel under an object."""
    under = obj.astype(np.float32)
    flat = np.zeros_like(under)
    found = solve_contact(compliance_of(grid), under, flat, flat, iterations=iterations)
    return found[0].astype(float), found[1].astype(float)


def ball(grid: tl.PixelGrid, radius_m: float, depth_m: float) -> np.ndarray:
    x, y = np.meshgrid(1e-3 * grid.x_mm(), 1e-3 * grid.y_mm())
    return np.minimum((x**2 + y**2) / (2 * radius_m), 1e-3) - depth_m


def test_a_ball_on_a_thick_layer_is_hertz_s():
    """Pressures, contact and force of one depth; a layer 12 contact radii thick is 8 % stiffer
    against the depth, but not between these."""
    grid, radius, depth = tl.PixelGrid(240, 240, 0.012, 0.012), 5e-3, 2e-5
    under, pixel = ball(grid, radius, depth), (0.012e-3) ** 2
    (height,), (pressure,) = solved(grid, under[None])
    force = pressure.sum() * pixel
    a = np.sqrt((pressure > 0).sum() * pixel / np.pi)
    peak = 1.5 * force / (np.pi * a**2)
    assert a == pytest.approx((3 * force * radius / (4 * PLANE)) ** (1 / 3), rel=0.02)
    assert pressure.max() == pytest.approx(peak, rel=0.03)
    assert (height <= under + 1e-12).all()
    np.testing.assert_allclose(height[pressure > 0], under[pressure > 0], atol=4e-9)
    # Beside the contact: Johnson, Contact Mechanics, (3.42a), about the level where it touches.
    r = np.hypot(*np.meshgrid(1e-3 * grid.x_mm(), 1e-3 * grid.y_mm()))
    ring = (r > 1.1 * a) & (r < 2.5 * a)
    s = r[ring]
    johnson = (2 * a**2 - s**2) * np.arcsin(a / s) + s * a * np.sqrt(1 - (a / s) ** 2)
    assert np.ptp(height[ring] + peak / (2 * PLANE * a) * johnson) < 0.03 * depth


@pytest.mark.parametrize(("share", "open_m"), [(0.2, 0.6), (0.5, 0.9), (0.8, 1.0)])
def test_a_wave_touches_as_much_as_westergaard_says(share, open_m):
    """Mean pressure over that of full contact, p* = pi E' A / lambda, is sin^2(pi w / 2), w being
    the part of the wave that touches [Westergaard 1939; Johnson 1985, section 13.2]."""
    grid, wave, amplitude = tl.PixelGrid(256, 8, 0.004, 0.004), 256 * 0.004e-3, 5e-6
    full = np.pi * PLANE * amplitude / wave
    k = 3 - 4 * POISSON
    squeezed = 8 * THICKNESS_M * (k - 1) / ((k + 1) ** 2 * PLANE)
    obj = np.tile(amplitude * np.cos(2 * np.pi * 1e-3 * grid.x_mm() / wave), (8, 1))
    # The mean of z is - squeezed p; in full contact that of the object.
    lowered = obj - share * full * squeezed - amplitude * (1 - open_m)
    _, pressure = solved(grid, lowered[None], iterations=200)
    mean, part = pressure.mean() / full, (pressure[0, 0] > 0).mean()
    assert 0.05 < mean < 0.98
    assert mean == pytest.approx(np.sin(0.5 * np.pi * part) ** 2, abs=0.02)


def test_a_gpu_s_library_finds_the_same():
    """Presses on a CPU load no torch: both libraries go through the same lines."""
    grid = tl.PixelGrid(120, 100, 0.03, 0.03)
    under = ball(grid, 2e-3, 1e-4)[None].astype(np.float32)
    coarse = np.where(under < 0, 1e3, 0.0).astype(np.float32)
    given = (compliance_of(grid), under, np.zeros_like(under), coarse)
    height, pressure = solve_contact(*given)
    theirs = solve_contact(*map(torch.as_tensor, given))
    assert height.dtype == pressure.dtype == np.float32
    np.testing.assert_allclose(theirs[0].numpy(), height, atol=1e-9)
    np.testing.assert_allclose(theirs[1].numpy(), pressure, atol=1e-4 * pressure.max())


def test_what_is_right_already_stays():
    """A coarse solution that meets the object is given back."""
    grid = tl.PixelGrid(96, 96, 0.03, 0.03)
    obj = ball(grid, 5e-3, 1e-4)[None]
    height, pressure = solved(grid, obj, iterations=100)
    given = [compliance_of(grid), *(a.astype(np.float32) for a in (obj, height, pressure))]
    sharpened = solve_contact(*given)
    np.testing.assert_allclose(sharpened[0], height, atol=1e-7)
    assert sharpened[1].sum() == pytest.approx(pressure.sum(), rel=3e-3)
    again = solve_contact(*given, sharpenings=0, iterations=20)
    np.testing.assert_allclose(again[0], height, atol=4e-9)
    np.testing.assert_allclose(again[1], pressure, atol=4e-3 * pressure.max())


def test_environments_do_not_know_each_other():
    """To the bit, in batches of one size: of other sizes some processors round otherwise."""
    grid = tl.PixelGrid(64, 48, 0.03, 0.03)
    objects = np.stack([ball(grid, 5e-3, depth) for depth in (1e-4, -1e-3, 3e-5)])
    together = solved(grid, objects)
    for env, obj in enumerate(objects):
        among_equals = solved(grid, obj[None].repeat(len(objects), axis=0))
        for whole, equals in zip(together, among_equals, strict=True):
            np.testing.assert_array_equal(whole[env], equals[env])
    assert not together[1][1].any() and not together[0][1].any()
