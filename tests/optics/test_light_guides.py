# SPDX-License-Identifier: Apache-2.0
"""Light guides against closed forms: a line and a ring of light over a plane."""

from __future__ import annotations

import math

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.optics.light_samples import sample_lights
from taccel_lab.profile.optical_design import Light
from tests.optics.flat_gel import design, model

UP = (0.0, 0.0, 1.0)
WHITE = (1.0, 1.0, 1.0)


def irradiance(*lights: Light, samples: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Places [mm], [H, W, 3], and irradiance of the first channel, [H, W], of a plane in air."""
    field = model(design(*lights), refraction=False, samples=samples).light_field()
    return field.points_mm.astype(np.float64), field.irradiance()[..., 0]


def line(place: np.ndarray, length: float, depth: float) -> np.ndarray:
    """Irradiance by a Lambertian line along x of unit power, parallel to the plane at ``depth``.

    With l along the line, D^2 = y^2 + depth^2: (1 / (pi length)) times the integral of depth^2 /
    (l^2 + D^2)^2, which is l / (2 D^2 (l^2 + D^2)) + atan(l / D) / (2 D^3).
    """
    x, y = place[..., 0], place[..., 1]
    d = np.hypot(y, depth)

    def primitive(at: np.ndarray) -> np.ndarray:
        return at / (2 * d**2 * (at**2 + d**2)) + np.arctan(at / d) / (2 * d**3)

    return depth**2 / (math.pi * length) * (primitive(length / 2 - x) - primitive(-length / 2 - x))


@pytest.mark.parametrize("length", [0.5, 6.0, 24.0, 60.0])
@pytest.mark.parametrize("depth", [5.0, 12.0])
def test_a_straight_guide_is_a_line_of_light(length, depth):
    """At the default number of samples, however long the exit is."""
    guide = Light((0.0, 0.0, -depth), UP, WHITE, size_mm=(length, 0.0))
    place, found = irradiance(guide)
    np.testing.assert_allclose(found, line(place, length, depth), rtol=0.01)
    _, finer = irradiance(guide, samples=256)
    np.testing.assert_allclose(finer, line(place, length, depth), rtol=1e-4)


def test_a_ring_guide_is_even_on_its_axis_and_about_it():
    """P (n + 1) / (2 pi) cos^n(emission) cos(incidence) / r^2 on the axis, for every tilt."""
    radius, depth, tilt, lobe = 13.0, 7.0, math.radians(50), 2.0
    inward = (-math.sin(tilt), 0.0, math.cos(tilt))
    ring = Light((radius, 0.0, -depth), inward, WHITE, lobe=lobe, arc_deg=360.0)
    place, found = irradiance(ring)
    middle = found[15, 20]
    assert place[15, 20, :2] == pytest.approx([0, 0], abs=1e-6)
    away = math.hypot(radius, depth)
    emitted = (radius * math.sin(tilt) + depth * math.cos(tilt)) / away
    expected = (lobe + 1) / (2 * math.pi) * emitted**lobe * (depth / away) / away**2
    assert middle == pytest.approx(expected, rel=1e-4)
    # The same at equal distances from the axis: pixels are square, 41 x 31 of them.
    np.testing.assert_allclose(found[15, 8:33], found[3:28, 20], rtol=2e-3)
    np.testing.assert_allclose(found, found[:, ::-1], rtol=2e-3)


def test_a_bent_guide_is_many_leds_along_its_arc():
    """Also with a height, a tilt and a turn."""
    tilt, turn = math.radians(70), math.radians(10)
    side = math.sin(tilt)
    ahead = (-side * math.cos(turn), -side * math.sin(turn), math.cos(tilt))
    arc = Light((12.0, 0.0, -6.0), ahead, (0.7, 0.1, 0.1), arc_deg=120.0, lobe=1.5)
    leds = []
    for angle in np.radians((np.arange(400) + 0.5) / 400 * 120 - 60):
        c, s = math.cos(angle), math.sin(angle)
        turned = [(c * x - s * y, s * x + c * y, z) for x, y, z in (arc.position_mm, arc.direction)]
        leds.append(Light(turned[0], turned[1], (0.7 / 400, 0.1 / 400, 0.1 / 400), lobe=1.5))
    np.testing.assert_allclose(irradiance(arc)[1], irradiance(*leds)[1], rtol=0.01)
    samples = sample_lights((arc,), 64)
    assert samples.intensities.sum(axis=0) == pytest.approx(
        sample_lights(tuple(leds), 1).intensities.sum(axis=0)
    )
    tall = Light((12.0, 0.0, -6.0), ahead, WHITE, size_mm=(0.0, 2.0), arc_deg=120.0)
    points = sample_lights((tall,), 1024).positions_mm
    rows = len(np.unique(points[:, 2].round(6)))
    assert np.ptp(points[:, 2]) == pytest.approx(2.0 * side * (1 - 1 / rows), rel=0.01)
    assert points[:, :2].mean(axis=0)[1] == pytest.approx(0, abs=0.2)


def test_an_arc_has_a_middle_beside_the_axis_and_no_width():
    with pytest.raises(InputError, match="lies beside the gel's z axis"):
        Light((0.0, 0.0, -5.0), UP, WHITE, arc_deg=90.0)
    with pytest.raises(InputError, match="its size_mm is 0 wide"):
        Light((9.0, 0.0, -5.0), UP, WHITE, size_mm=(2.0, 1.0), arc_deg=90.0)
    with pytest.raises(InputError, match=r"arc_deg must lie in \[0, 360\]"):
        Light((9.0, 0.0, -5.0), UP, WHITE, arc_deg=400.0)
