# SPDX-License-Identifier: Apache-2.0
"""Surfaces of presses: closed forms, and read off those of a few others."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from taccel_lab.calibration.capture import ContactCircle
from taccel_lab.calibration.surfaces import PressSurface
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.signals.normals import normals_from_height
from tests.support.analytic_surface import analytic_surface

GRID = PixelGrid(200, 160, 0.05, 0.05)
CIRCLE = ContactCircle(100.0, 80.0, 20.0)


def test_in_contact_it_is_the_sphere_and_beyond_the_skirt_flat() -> None:
    surface = analytic_surface(CIRCLE, GRID, 2.0, decay_mm=1e-4)
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
    surface = analytic_surface(CIRCLE, GRID, 2.0, decay_mm=decay_mm)
    numeric = normals_from_height(surface.height_m, GRID)
    ring = np.abs(CIRCLE.distance_px(GRID) - 20) > 2  # the slope has a kink at the rim
    assert np.abs(numeric - surface.normals)[ring].max() < 5e-3


def test_skirt_follows_johnson() -> None:
    surface = analytic_surface(CIRCLE, GRID, 2.0)
    r = 0.05 * np.arange(22, 90)
    rim = 1.0
    johnson = (2 * rim**2 - r**2) * np.arcsin(rim / r) + rim * np.sqrt(r**2 - rim**2)
    height = surface.height_m[80, 122:190] * 1e3
    slope = (1.0 / math.sqrt(3.0)) / (math.pi * rim)
    assert np.diff(height) == pytest.approx(-slope * np.diff(johnson), rel=0.01)


def test_refuses_a_rim_beyond_the_ball() -> None:
    with pytest.raises(InputError, match="not below the ball's radius"):
        analytic_surface(ContactCircle(100.0, 80.0, 41.0), GRID, 2.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"height_m": np.zeros((3, 3))}, "rest_height_m has shape"),
        ({"contact_radius_px": math.nan}, "contact_radius_px"),
        ({"rest_height_m": np.full((160, 200), np.nan)}, "rest_height_m holds NaN"),
    ],
)
def test_surface_checks_itself(change: dict[str, object], message: str) -> None:
    surface: PressSurface = analytic_surface(CIRCLE, GRID, 2.0)
    with pytest.raises(InputError, match=message):
        dataclasses.replace(surface, **change)  # type: ignore[arg-type]
