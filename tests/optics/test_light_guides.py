# SPDX-License-Identifier: Apache-2.0
"""Area lights and light guides against closed forms: rectangles, lines and rings over a plane."""

from __future__ import annotations

import math

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.optics.light_samples import sample_lights
from taccel_lab.profile.optical_design import Light
from tests.optics.flat_gel import design, model

UP, WHITE = (0.0, 0.0, 1.0), (1.0, 1.0, 1.0)


def irradiance(*lights: Light, samples: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Places [mm], [H, W, 3], and irradiance of the first channel, [H, W], of a plane in air."""
    field = model(design(*lights), refraction=False, samples=samples).light_field()
    return field.points_mm.astype(np.float64), field.irradiance()[..., 0]


def test_area_light_converges_to_its_form_factor():
    """A Lambertian rectangle parallel to the face, seen from the point under its middle: four
    quarters with a = w / h, b = l / h (Howell, "Catalog of radiation configuration factors",
    C-5)."""
    width, length, height = 8.0, 4.0, 6.0
    light = Light((0.0, 0.0, -height), UP, WHITE, size_mm=(width, length))
    a, b = width / 2 / height, length / 2 / height
    quarter = (
        a / math.hypot(1, a) * math.atan(b / math.hypot(1, a))
        + b / math.hypot(1, b) * math.atan(a / math.hypot(1, b))
    ) / (2 * math.pi)
    expected = 4 * quarter / (width * length)
    # A face larger than a quarter of its distance is cut into more cells than are asked for.
    for samples, error in ((1, 0.01), (8, 0.01), (512, 1e-3)):
        found = irradiance(light, samples=samples)[1][15, 20]
        assert found == pytest.approx(expected, rel=error)


def test_cells_of_area_lights_cover_them_evenly():
    light = Light((1.0, 2.0, -3.0), (1.0, 0.0, 0.0), (1.0, 2.0, 3.0), size_mm=(6.0, 2.0), lobe=3.0)
    samples = sample_lights((light,), 12)
    assert len(samples.positions_mm) == 12
    np.testing.assert_allclose(samples.positions_mm.mean(axis=0), light.position_mm)
    x, y, z = np.round(samples.positions_mm - light.position_mm, 6).T
    # The width lies in the xy plane, across the axis.
    assert not x.any() and np.unique(y).size == 6 and np.unique(z).size == 2
    total = samples.intensities.sum(axis=0) * 2 * math.pi / (light.lobe + 1)
    np.testing.assert_allclose(total, light.rgb)


def line(place: np.ndarray, length: float, depth: float) -> np.ndarray:
    """Irradiance by a Lambertian line along x of unit power, parallel to the plane at ``depth``.

    With l along the line, D^2 = y^2 + depth^2: (1 / (pi length)) times the integral of depth^2 /
    (l^2 + D^2)^2, which is l / (2 D^2 (l^2 + D^2)) + atan(l / D) / (2 D^3).
    """
    x, d = place[..., 0], np.hypot(place[..., 1], depth)

    def primitive(at: np.ndarray) -> np.ndarray:
        return at / (2 * d**2 * (at**2 + d**2)) + np.arctan(at / d) / (2 * d**3)

    return depth**2 / (math.pi * length) * (primitive(length / 2 - x) - primitive(-length / 2 - x))


@pytest.mark.parametrize("length", [0.5, 6.0, 24.0, 60.0])
@pytest.mark.parametrize("depth", [5.0, 12.0])
def test_a_straight_guide_is_a_line_of_light(length, depth):
    """At the default number of samples, however long the exit is."""
    guide = Light((0.0, 0.0, -depth), UP, WHITE, size_mm=(length, 0.0))
    for samples, rtol in ((4, 0.01), (256, 1e-4)):
        place, found = irradiance(guide, samples=samples)
        np.testing.assert_allclose(found, line(place, length, depth), rtol=rtol)


def test_a_ring_guide_is_even_on_its_axis_and_about_it():
    """P (n + 1) / (2 pi) cos^n(emission) cos(incidence) / r^2 on the axis, for every tilt."""
    radius, depth, tilt, lobe = 13.0, 7.0, math.radians(50), 2.0
    inward = (-math.sin(tilt), 0.0, math.cos(tilt))
    place, found = irradiance(Light((radius, 0.0, -depth), inward, WHITE, lobe=lobe, arc_deg=360.0))
    assert place[15, 20, :2] == pytest.approx([0, 0], abs=1e-6)
    away = math.hypot(radius, depth)
    emitted = (radius * math.sin(tilt) + depth * math.cos(tilt)) / away
    expected = (lobe + 1) / (2 * math.pi) * emitted**lobe * (depth / away) / away**2
    assert found[15, 20] == pytest.approx(expected, rel=1e-4)
    # The same at equal distances from the axis: pixels are square, 41 x 31 of them.
    np.testing.assert_allclose(found[15, 8:33], found[3:28, 20], rtol=2e-3)
    np.testing.assert_allclose(found, found[:, ::-1], rtol=2e-3)


def test_a_bent_guide_is_many_leds_along_its_arc():
    """Also with a height, a tilt and a turn."""
    side, turn = math.sin(math.radians(70)), math.radians(10)
    ahead = (-side * math.cos(turn), -side * math.sin(turn), math.cos(math.radians(70)))
    arc = Light((12.0, 0.0, -6.0), ahead, (0.7, 0.1, 0.1), arc_deg=120.0, lobe=1.5)
    leds = []
    for angle in np.radians((np.arange(400) + 0.5) / 400 * 120 - 60):
        c, s = math.cos(angle), math.sin(angle)
        turned = [(c * x - s * y, s * x + c * y, z) for x, y, z in (arc.position_mm, arc.direction)]
        leds.append(Light(*turned, (0.7 / 400, 0.1 / 400, 0.1 / 400), lobe=1.5))
    np.testing.assert_allclose(irradiance(arc)[1], irradiance(*leds)[1], rtol=0.01)
    power, of_leds = (
        sample_lights(lights, count).intensities.sum(axis=0)
        for lights, count in (((arc,), 64), (tuple(leds), 1))
    )
    assert power == pytest.approx(of_leds)
    tall = Light((12.0, 0.0, -6.0), ahead, WHITE, size_mm=(0.0, 2.0), arc_deg=120.0)
    points = sample_lights((tall,), 1024).positions_mm
    rows = len(np.unique(points[:, 2].round(6)))
    assert np.ptp(points[:, 2]) == pytest.approx(2.0 * side * (1 - 1 / rows), rel=0.01)
    assert points[:, 1].mean() == pytest.approx(0, abs=0.2)


@pytest.mark.parametrize(
    ("x_mm", "size_mm", "arc_deg", "words"),
    [
        (0.0, (0.0, 0.0), 90.0, "lies beside the gel's z axis"),
        (9.0, (2.0, 1.0), 90.0, "its size_mm is 0 wide"),
        (9.0, (0.0, 0.0), 400.0, r"arc_deg must lie in \[0, 360\]"),
    ],
)
def test_an_arc_has_a_middle_beside_the_axis_and_no_width(x_mm, size_mm, arc_deg, words):
    with pytest.raises(InputError, match=words):
        Light((x_mm, 0.0, -5.0), UP, WHITE, size_mm=size_mm, arc_deg=arc_deg)
