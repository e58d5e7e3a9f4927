# SPDX-License-Identifier: Apache-2.0
"""The contact of pixels against Hertz and Westergaard."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from taccel_lab.geometry import PixelGrid
from taccel_lab.signals.layer_contact import layer_compliance, solve_contact

YOUNG, POISSON = 1.5e5, 0.46
PLANE = YOUNG / (1 - POISSON**2)


def solved(
    grid: PixelGrid, thickness_m: float, obj: np.ndarray, **options: int
) -> tuple[np.ndarray, np.ndarray]:
    """Height [m] and pressures [Pa] of a flat gel under an object."""
    compliance = torch.as_tensor(
        layer_compliance(grid, YOUNG, POISSON, thickness_m), dtype=torch.float32
    )
    under = torch.as_tensor(obj, dtype=torch.float32)
    flat = torch.zeros_like(under)
    options = {"iterations": 20, **options}
    height, pressure = solve_contact(compliance, under, flat, flat, **options)
    return height.numpy().astype(float), pressure.numpy().astype(float)


def ball(grid: PixelGrid, radius_m: float, depth_m: float) -> np.ndarray:
    x, y = np.meshgrid(1e-3 * grid.x_mm(), 1e-3 * grid.y_mm())
    return np.minimum((x**2 + y**2) / (2 * radius_m), 1e-3) - depth_m


def test_a_ball_on_a_thick_layer_is_hertz_s() -> None:
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
def test_a_wave_touches_as_much_as_westergaard_says(share: float) -> None:
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


def test_full_contact_shows_the_object() -> None:
    grid = PixelGrid(64, 64, 0.02, 0.02)
    wave = 64 * 0.02e-3
    obj = 1e-6 * np.cos(2 * np.pi * 1e-3 * grid.x_mm() / wave)[None].repeat(64, axis=0) - 1e-4
    height, pressure = solved(grid, 4e-3, obj[None])
    assert (pressure > 0).all()
    np.testing.assert_allclose(height[0], obj, atol=1e-9)


def test_what_is_right_already_stays() -> None:
    """A coarse solution that meets the object is given back."""
    grid = PixelGrid(96, 96, 0.03, 0.03)
    obj = ball(grid, 5e-3, 1e-4)[None]
    height, pressure = solved(grid, 4e-3, obj, iterations=100)
    compliance = torch.as_tensor(layer_compliance(grid, YOUNG, POISSON, 4e-3), dtype=torch.float32)
    given = [torch.as_tensor(a, dtype=torch.float32) for a in (obj, height, pressure)]
    sharpened = solve_contact(compliance, *given)
    np.testing.assert_allclose(sharpened[0].numpy(), height, atol=1e-7)
    assert sharpened[1].numpy().sum() == pytest.approx(pressure.sum(), rel=3e-3)
    again = solve_contact(compliance, *given, sharpenings=0, iterations=20)
    np.testing.assert_allclose(again[0].numpy(), height, atol=4e-9)
    np.testing.assert_allclose(again[1].numpy(), pressure, atol=4e-3 * pressure.max())


def test_environments_do_not_know_each_other() -> None:
    """To the bit, in batches of one size: of other sizes some processors round otherwise."""
    grid = PixelGrid(64, 48, 0.03, 0.03)
    objects = np.stack([ball(grid, 5e-3, depth) for depth in (1e-4, -1e-3, 3e-5)])
    together = solved(grid, 4e-3, objects)
    for env, obj in enumerate(objects):
        among_equals = solved(grid, 4e-3, obj[None].repeat(len(objects), axis=0))
        for whole, equals in zip(together, among_equals, strict=True):
            np.testing.assert_array_equal(whole[env], equals[env])
    assert not together[1][1].any() and not together[0][1].any()
