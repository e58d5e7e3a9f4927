# SPDX-License-Identifier: Apache-2.0
"""The pad's formulas against geometry worked out otherwise."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from pad_strategies import gel_pads

from taccel_lab.cad.parts.gel_pad import GelPad
from taccel_lab.errors import InputError

DOME = {"crown_radius_x_mm": 50.0, "crown_radius_y_mm": 50.0, "thickness_mm": 5.0}


def test_equal_radii_give_a_sphere() -> None:
    xy = np.random.default_rng(1).uniform(-10, 10, (200, 2))
    z = GelPad(**DOME).height_mm(xy)
    centered = np.concatenate([xy, (z + 50)[:, None]], axis=1)
    np.testing.assert_allclose(np.linalg.norm(centered, axis=1), 50, rtol=1e-14)


def test_crown_slope_matches_finite_differences() -> None:
    pad = GelPad(crown_radius_x_mm=60, crown_radius_y_mm=90, thickness_mm=5)
    xy = np.random.default_rng(2).uniform(-9, 9, (50, 2))
    step = 1e-5
    for axis in range(2):
        shift = step * np.eye(2)[axis]
        numeric = (pad.crown_mm(xy + shift) - pad.crown_mm(xy - shift)) / (2 * step)
        np.testing.assert_allclose(pad.crown_slope(xy)[:, axis], numeric, atol=1e-9)


def test_inside_distance_and_normal_on_sides_and_corner() -> None:
    pad = GelPad(length_x_mm=24, length_y_mm=20, corner_radius_mm=2)
    corner = np.array([10.0, 8.0])
    diagonal = np.array([np.sqrt(0.5), np.sqrt(0.5)])
    points = np.array([[11.0, 0.0], [0.0, -9.5], corner + 1.5 * diagonal, [13.0, 0.0]])
    np.testing.assert_allclose(pad.inside_distance_mm(points), [1.0, 0.5, 0.5, -1.0], atol=1e-12)
    normals = pad.outward_normal(points)
    np.testing.assert_allclose(normals, [[1, 0], [0, -1], diagonal, [1, 0]], atol=1e-12)


@given(gel_pads())
@settings(max_examples=30, deadline=None)
def test_outline_points_lie_on_the_outline(pad: GelPad) -> None:
    outline = pad.outline_mm(8)
    np.testing.assert_allclose(pad.inside_distance_mm(outline), 0, atol=1e-12)
    inner = outline - 0.3 * pad.outward_normal(outline)
    np.testing.assert_allclose(pad.inside_distance_mm(inner), 0.3, atol=1e-9)


def test_chamfer_is_45_degrees_on_a_flat_pad() -> None:
    pad = GelPad(rim="chamfer", rim_mm=0.8)
    x = np.array([12 - 0.8, 12 - 0.3, 12.0])
    z = pad.height_mm(np.stack([x, np.zeros(3)], axis=1))
    np.testing.assert_allclose(z, [0, -0.5, -0.8], atol=1e-12)


def test_fillet_is_a_circle_that_touches_wall_and_crown() -> None:
    pad = GelPad(rim="fillet", rim_mm=1.0, **DOME)
    d = np.linspace(0, 1, 400)
    xy = np.stack([12 - d, np.zeros_like(d)], axis=1)
    z, crown = pad.height_mm(xy), pad.crown_mm(xy)
    assert (z <= crown + 1e-12).all() and z[-1] == pytest.approx(crown[-1], abs=1e-6)
    arc = z < crown - 1e-4
    radius = np.hypot(12 - d[arc] - 11, z[arc] - z[0])
    # Exact for a plane crown; the dome bends by about r^2 / 2R over the band.
    np.testing.assert_allclose(radius, 1.0, atol=0.012)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"thickness_mm": -1}, ["thickness_mm = -1", "0.5 to 40 mm"]),
        ({"corner_radius_mm": 11}, ["corner_radius_mm = 11", "up to 9.95 mm"]),
        ({"rim": "fillet", "rim_mm": 1.9}, ["rim_mm = 1.9", "up to 1.8 mm"]),
        ({"thickness_mm": 2, "crown_radius_x_mm": 30.0}, ["of wall", "thickness_mm must be"]),
        ({"thickness_mm": 40, "crown_radius_x_mm": 14.0}, ["crown radii", "up to 0.8"]),
        ({"window_x_mm": 23.9}, ["window_x_mm", "at least 0.2 mm"]),
        ({"rim": "bevel"}, ["rim", "none, chamfer, fillet"]),
        ({"length_x_mm": float("nan")}, ["length_x_mm", "4 to 100 mm"]),
    ],
)
def test_what_cannot_be_built_is_refused(values: dict[str, object], words: list[str]) -> None:
    with pytest.raises(InputError) as error:
        GelPad(**values)  # type: ignore[arg-type]
    for word in words:
        assert word in str(error.value)


def test_thickness_named_in_the_error_is_enough() -> None:
    with pytest.raises(InputError) as error:
        GelPad(thickness_mm=1.0, crown_radius_x_mm=50, crown_radius_y_mm=50)
    needed = float(str(error.value).split("at least ")[1].split(" mm")[0])
    assert GelPad(thickness_mm=needed + 1e-3, crown_radius_x_mm=50, crown_radius_y_mm=50)
