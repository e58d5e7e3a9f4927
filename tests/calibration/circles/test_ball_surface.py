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
from taccel_lab.calibration.normals.synthetic_presses import draw_tool
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.reading import bonded_layer
from taccel_lab.reading.bonded_layer import BondedLayer, press_in_view, press_layer
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.signals.normals import normals_from_height
from tests.support.analytic_surface import analytic_surface
from tests.support.finite_element_press import simulated_press

FINE = PixelGrid(200, 160, 0.05, 0.05)
CIRCLE = ContactCircle(100.0, 80.0, 20.0)


@pytest.mark.parametrize("decay_mm", [math.inf, 1.0])
def test_normals_belong_to_the_heights(decay_mm: float) -> None:
    surface = analytic_surface(CIRCLE, FINE, 2.0, decay_mm=decay_mm)
    numeric = normals_from_height(surface.height_m, FINE)
    ring = np.abs(CIRCLE.distance_px(FINE) - 20) > 2  # the slope has a kink at the rim
    assert np.abs(numeric - surface.normals)[ring].max() < 5e-3


def compliance_by_equations(k: float, thickness: float, nu: float) -> float:
    """Sinking over pressure of one wave, from Navier's equations in plane strain.

    Displacements ``u_x = U(z) sin(kx)``, ``u_z = W(z) cos(kx)`` with U, W of the general solution
    (a + b z) e^(+-kz); none at the base z = -t, no shear and unit pressure at the face z = 0.
    """
    mu, kappa = 1.0, 3 - 4 * nu
    lame = 2 * mu * nu / (1 - 2 * nu)
    # Columns: U = W = e^kz; U = z e^kz, W = (z - kappa / k) e^kz; the same for -k. At the base:
    z = -thickness
    up, down = np.exp(k * z), np.exp(-k * z)
    base_u = [up, z * up, down, z * down]
    base_w = [-up, -(z - kappa / k) * up, down, (z + kappa / k) * down]
    # At the face, with derivatives:
    u, w = np.array([1.0, 0.0, 1.0, 0.0]), np.array([-1.0, kappa / k, 1.0, kappa / k])
    du, dw = np.array([k, 1.0, -k, 1.0]), np.array([-k, kappa - 1, -k, 1 - kappa])
    shear, normal = mu * (du - k * w), (lame + 2 * mu) * dw + lame * k * u
    solved = np.linalg.solve(np.stack([base_u, base_w, shear, normal]), [0.0, 0.0, 0.0, -1.0])
    return float(-(w @ solved) * 2 * mu * (1 + nu) / (2 * (1 - nu**2)))


@given(st.floats(0.05, 8.0), st.floats(0.5, 6.0), st.floats(0.0, 0.49))
def test_waves_sink_as_the_equations_of_elasticity_say(k: float, t: float, nu: float) -> None:
    found = BondedLayer(t, nu).compliance_mm(np.array([k]))[0]
    assert found == pytest.approx(compliance_by_equations(k, t, nu), rel=1e-5)


def test_limits_are_the_half_space_and_the_thin_layer() -> None:
    found = BondedLayer(3.0, 0.4).compliance_mm(np.array([0.0, 1e-4, 50.0]))
    # A thin bonded layer sinks by p t (1 - 2 nu) (1 + nu) / (E (1 - nu)).
    thin = 3.0 * (1 - 0.8) * 1.4 / 0.6 / (2 * (1 - 0.16))
    assert found[:2] == pytest.approx(thin, rel=1e-3)
    assert found[2] == pytest.approx(1 / 50.0)


def grid_of(step: float, count: int) -> tuple[np.ndarray, ...]:
    values = (np.arange(count) - (count - 1) / 2) * step
    return tuple(np.meshgrid(values, values))


@pytest.mark.thorough
def test_a_ball_in_a_thick_layer_is_hertz() -> None:
    x, y = grid_of(0.02, 128)
    ball = 5.0 - np.sqrt(25.0 - np.minimum(x**2 + y**2, 24.0))
    found = press_layer(ball, 0.05, (0.02, 0.02), BondedLayer(20.0, 0.3))  # 40 contact radii
    radius = np.sqrt(found.contact.sum() * 0.02**2 / np.pi)
    assert radius == pytest.approx(np.sqrt(5.0 * 0.05), rel=0.04)
    assert found.rise_mm.min() == pytest.approx(-0.05, abs=2e-4)


@given(st.integers(0, 200), st.floats(0.03, 0.3), st.booleans())
def test_the_gel_never_stands_in_the_tool(seed: int, share: float, in_view: bool) -> None:
    tool = draw_tool(np.random.default_rng(seed), *grid_of(0.2, 60))
    assert tool.min() == 0 and np.isfinite(tool).all()
    layer, depth_mm = BondedLayer(4.0, 0.47), 4.0 * share
    if in_view:
        found = press_in_view(tool, depth_mm, (0.2, 0.2), layer, 1e-3)
    else:
        found = press_layer(tool, depth_mm, (0.2, 0.2), layer)
    gap = tool - depth_mm - found.rise_mm
    assert gap.min() > -2e-3 * depth_mm and np.abs(gap[found.contact]).max() < 2e-3 * depth_mm
    assert (found.pressure >= 0).all()
    # Far from the tool it is nearly at rest.
    assert found.rise_mm.max() < 0.2 * depth_mm


def test_two_grids_agree() -> None:
    rises = []
    for step, count in ((0.2, 100), (0.1, 200)):
        x, y = grid_of(step, count)
        wedge = np.where(np.abs(y) < 3, np.abs(x), bonded_layer.FAR_MM)
        rises.append(press_layer(wedge, 0.6, (step, step), BondedLayer(4.0, 0.48)).rise_mm)
    means = rises[1].reshape(100, 2, 100, 2).mean(axis=(1, 3))
    assert np.sqrt(np.mean((means - rises[0]) ** 2)) < 4e-3


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
    profile, grid = catalogue_profile("flat_pad"), PixelGrid(160, 120, 0.1, 0.1)
    circle = ContactCircle(79.5, 59.5, 15.0)
    depth_mm, rise_mm = sink_in.ball_in_layer(circle, 3.0, grid, sink_in.layer_of(profile))
    radius_mm, simulated_mm = simulated_press(profile, grid, (0.0, 0.0), 3.0, depth_mm, 1.5)
    # Nodes touch up to 0.02 mm inside the contact's edge, a layer's points up to its edge.
    assert radius_mm == pytest.approx(1.5, rel=0.03)
    off, inside = np.abs(rise_mm - simulated_mm), circle.distance_px(grid) < 15.0
    assert off[inside].mean() < 0.06 * depth_mm and off[~inside].mean() < 0.01


def test_bad_layers_and_depths_are_refused() -> None:
    with pytest.raises(InputError, match="thickness above 0 mm"):
        BondedLayer(0.0, 0.4)
    with pytest.raises(InputError, match=r"Poisson's ratio in 0\.\.0\.5"):
        BondedLayer(1.0, 0.5)
    with pytest.raises(InputError, match="depth 2 mm must lie between 0 and the layer's 2 mm"):
        press_layer(np.zeros((8, 8)), 2.0, (0.1, 0.1), BondedLayer(2.0, 0.4))
    with pytest.raises(InputError, match="does not reach the face"):
        press_in_view(np.full((8, 8), 1.0), 0.5, (0.1, 0.1), BondedLayer(2.0, 0.4), 0.1)
