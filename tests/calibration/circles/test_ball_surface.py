# SPDX-License-Identifier: Apache-2.0
"""Gel under balls and tools: a bonded layer, held against elasticity and finite elements."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.calibration.capture import ContactCircle
from taccel_lab.calibration.circles import ball_surface as sink_in
from taccel_lab.calibration.circles.ball_surface import ball_in_layer, layer_of
from taccel_lab.calibration.circles.bonded_layer import (
    FAR_MM,
    BondedLayer,
    press_in_view,
    press_layer,
)
from taccel_lab.calibration.normals.synthetic_presses import draw_tool
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.signals.normals import normals_from_height
from tests.support.analytic_surface import analytic_surface
from tests.support.finite_element_press import simulated_press

FINE = PixelGrid(200, 160, 0.05, 0.05)
CIRCLE = ContactCircle(100.0, 80.0, 20.0)


def test_in_contact_it_is_the_sphere_and_beyond_the_skirt_flat() -> None:
    surface = analytic_surface(CIRCLE, FINE, 2.0, decay_mm=1e-4)
    x = np.arange(200) - 100.0
    inside = np.abs(x) < 19
    expected = 2.0 - np.sqrt(4.0 - (0.05 * x[inside]) ** 2)
    height = surface.height_m[80] * 1e3
    assert height[inside] - height[100] == pytest.approx(expected, abs=1e-4)
    assert np.all(surface.height_m[80, 121:] == pytest.approx(0.0, abs=1e-9))
    assert surface.depth_mm == pytest.approx(2.0 - math.sqrt(3.0), abs=1e-3)
    assert surface.normals[80, 110] == pytest.approx([-0.25, 0.0, math.sqrt(1 - 0.0625)], abs=1e-3)


@pytest.mark.parametrize("decay_mm", [math.inf, 1.0])
def test_normals_belong_to_the_heights(decay_mm: float) -> None:
    surface = analytic_surface(CIRCLE, FINE, 2.0, decay_mm=decay_mm)
    numeric = normals_from_height(surface.height_m, FINE)
    ring = np.abs(CIRCLE.distance_px(FINE) - 20) > 2  # the slope has a kink at the rim
    assert np.abs(numeric - surface.normals)[ring].max() < 5e-3


def test_skirt_follows_johnson() -> None:
    surface = analytic_surface(CIRCLE, FINE, 2.0)
    r = 0.05 * np.arange(22, 90)
    rim = 1.0
    johnson = (2 * rim**2 - r**2) * np.arcsin(rim / r) + rim * np.sqrt(r**2 - rim**2)
    height = surface.height_m[80, 122:190] * 1e3
    slope = (1.0 / math.sqrt(3.0)) / (math.pi * rim)
    assert np.diff(height) == pytest.approx(-slope * np.diff(johnson), rel=0.01)


def compliance_by_equations(k: float, thickness: float, nu: float) -> float:
    """Sinking over pressure of one wave, from Navier's equations in plane strain.

    Displacements ``(i U(z), W(z)) e^(ikx)`` with U, W of the general solution (a + b z) e^(+-kz);
    four conditions: none at the base z = -t, no shear and unit pressure at the face z = 0.
    """
    mu = 1.0
    modulus = 2 * mu * (1 + nu)
    kappa = 3 - 4 * nu

    def rows(z: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        # Columns: U = W = e^kz; U = z e^kz, W = (z - kappa / k) e^kz; the same for -k.
        up, down = np.exp(k * z), np.exp(-k * z)
        u = np.array([up, z * up, down, z * down])
        w = np.array([-up, -(z - kappa / k) * up, down, (z + kappa / k) * down])
        du = np.array([k * up, (1 + k * z) * up, -k * down, (1 - k * z) * down])
        dw = np.array([-k * up, -(1 + k * z - kappa) * up, -k * down, (1 - k * z - kappa) * down])
        return u, w, du, dw

    # u_x = U sin(kx), u_z = W cos(kx).
    ub, wb, _, _ = rows(-thickness)
    u, w, du, dw = rows(0.0)
    lame = 2 * mu * nu / (1 - 2 * nu)
    shear = mu * (du - k * w)
    normal = (lame + 2 * mu) * dw + lame * k * u
    solved = np.linalg.solve(np.stack([ub, wb, shear, normal]), [0.0, 0.0, 0.0, -1.0])
    return float(-(w @ solved) * modulus / (2 * (1 - nu**2)))


@given(st.floats(0.05, 8.0), st.floats(0.5, 6.0), st.floats(0.0, 0.49))
def test_waves_sink_as_the_equations_of_elasticity_say(k: float, t: float, nu: float) -> None:
    found = BondedLayer(t, nu).compliance_mm(np.array([k]))[0]
    assert found == pytest.approx(compliance_by_equations(k, t, nu), rel=1e-5)


def test_limits_are_the_half_space_and_the_thin_layer() -> None:
    layer = BondedLayer(3.0, 0.4)
    k = np.array([0.0, 1e-4, 50.0])
    found = layer.compliance_mm(k)
    # A thin bonded layer sinks by p t (1 - 2 nu) (1 + nu) / (E (1 - nu)).
    thin = 3.0 * (1 - 0.8) * 1.4 / 0.6 / (2 * (1 - 0.16))
    assert found[:2] == pytest.approx(thin, rel=1e-3)
    assert found[2] == pytest.approx(1 / 50.0)


def grid_of(step: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    values = (np.arange(count) - (count - 1) / 2) * step
    x, y = np.meshgrid(values, values)
    return x, y


@pytest.mark.thorough
def test_a_ball_in_a_thick_layer_is_hertz() -> None:
    x, y = grid_of(0.02, 128)
    ball = 5.0 - np.sqrt(25.0 - np.minimum(x**2 + y**2, 24.0))
    found = press_layer(ball, 0.05, (0.02, 0.02), BondedLayer(20.0, 0.3))  # 40 contact radii
    radius = np.sqrt(found.contact.sum() * 0.02**2 / np.pi)
    assert radius == pytest.approx(np.sqrt(5.0 * 0.05), rel=0.04)
    assert found.rise_mm.min() == pytest.approx(-0.05, abs=2e-4)


@given(st.integers(0, 200), st.floats(0.03, 0.3), st.booleans())
def test_the_gel_never_stands_in_the_tool_and_is_pressed_only_where_they_touch(
    seed: int, share: float, in_view: bool
) -> None:
    x, y = grid_of(0.2, 60)
    tool = draw_tool(np.random.default_rng(seed), x, y)
    assert tool.min() == 0 and np.isfinite(tool).all()
    layer = BondedLayer(4.0, 0.47)
    if in_view:
        found = press_in_view(tool, 4.0 * share, (0.2, 0.2), layer, 1e-3)
    else:
        found = press_layer(tool, 4.0 * share, (0.2, 0.2), layer)
    gap = tool - 4.0 * share - found.rise_mm
    assert gap.min() > -2e-3 * 4.0 * share
    assert (found.pressure >= 0).all()
    assert np.abs(gap[found.contact]).max() < 2e-3 * 4.0 * share
    # Far from the tool it is nearly at rest.
    assert found.rise_mm.max() < 0.2 * 4.0 * share


def test_two_grids_agree() -> None:
    coarse, fine = grid_of(0.2, 100), grid_of(0.1, 200)
    rises = [
        press_layer(np.where(np.abs(y) < 3, np.abs(x), FAR_MM), 0.6, (s, s), BondedLayer(4.0, 0.48))
        for (x, y), s in ((coarse, 0.2), (fine, 0.1))
    ]
    means = rises[1].rise_mm.reshape(100, 2, 100, 2).mean(axis=(1, 3))
    assert np.sqrt(np.mean((means - rises[0].rise_mm) ** 2)) < 4e-3


@pytest.mark.thorough
def test_the_depth_of_a_contact_does_not_hang_on_the_grid(monkeypatch: pytest.MonkeyPatch) -> None:
    """A coarse grid's contact is wider than it should be by a part of a step, and the ball would
    come out 2 % too shallow."""
    grid, layer, depths = PixelGrid(90, 90, 0.1, 0.1), BondedLayer(4.0, 0.46), []
    for points in (8, 32):
        monkeypatch.setattr(sink_in, "POINTS_PER_RADIUS", points)
        circles = [ContactCircle(44.7, 45.2, radius) for radius in (9.0, 12.3, 16.0, 20.4)]
        depths.append([sink_in.ball_in_layer(c, 3.0, grid, layer)[0] for c in circles])
    assert np.mean(np.divide(*depths)) == pytest.approx(1.0, abs=0.007)


@pytest.mark.slow
def test_skirts_are_those_of_finite_elements() -> None:
    profile = catalogue_profile("flat_pad")
    grid = PixelGrid(160, 120, 0.1, 0.1)
    circle = ContactCircle(79.5, 59.5, 15.0)
    depth_mm, rise_mm = ball_in_layer(circle, 3.0, grid, layer_of(profile))
    radius_mm, simulated_mm = simulated_press(profile, grid, (0.0, 0.0), 3.0, depth_mm, 1.5)
    # Nodes touch up to 0.02 mm inside the contact's edge, a layer's points up to its edge.
    assert radius_mm == pytest.approx(1.5, rel=0.03)
    off = np.abs(rise_mm - simulated_mm)
    inside = circle.distance_px(grid) < 15.0
    assert off[inside].mean() < 0.06 * depth_mm
    assert off[~inside].mean() < 0.01


def test_bad_layers_and_depths_are_refused() -> None:
    with pytest.raises(InputError, match="thickness above 0 mm"):
        BondedLayer(0.0, 0.4)
    with pytest.raises(InputError, match=r"Poisson's ratio in 0\.\.0\.5"):
        BondedLayer(1.0, 0.5)
    layer = BondedLayer(2.0, 0.4)
    with pytest.raises(InputError, match="depth 2 mm must lie between 0 and the layer's 2 mm"):
        press_layer(np.zeros((8, 8)), 2.0, (0.1, 0.1), layer)
    with pytest.raises(InputError, match="does not reach the face"):
        press_in_view(np.full((8, 8), 1.0), 0.5, (0.1, 0.1), layer, 0.1)
