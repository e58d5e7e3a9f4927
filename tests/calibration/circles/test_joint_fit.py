# SPDX-License-Identifier: Apache-2.0
"""The joint fit of circles and colour map: its rates, and how soon it ends."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from taccel_lab.calibration.capture import ContactCircle
from taccel_lab.calibration.circles.color_change import color_change
from taccel_lab.calibration.circles.joint_fit import fit_contacts, sample_rings
from taccel_lab.calibration.circles.labels import circle_array
from taccel_lab.calibration.circles.press_model import PLAIN, WIDER_PX, MapTerms, slope_law
from tests.calibration.circles.presses import BALL_PX, GRID, gel, pressed, scattered


@pytest.mark.parametrize("presses", [1, 4, 12])
def test_rates_of_the_map_are_its_differences(presses: int) -> None:
    terms, step = MapTerms.for_presses(presses).finer(), 1e-6
    factors = np.random.default_rng(0).uniform(-1, 1, (5, 40))
    rows = terms.rows(*factors)
    assert len(rows) == PLAIN + terms.count
    for move, rates in zip(step * np.eye(5)[..., None], terms.rates, strict=False):
        change = terms.rows(*(factors + move)) - terms.rows(*(factors - move))
        assert rates @ rows == pytest.approx(change / (2 * step), abs=1e-7)


def test_a_finer_map_starts_as_the_coarser_one() -> None:
    terms = MapTerms.for_presses(12)
    rng = np.random.default_rng(1)
    factors, coefficients = rng.uniform(-1, 1, (5, 30)), rng.normal(size=(3, terms.count))
    taken = terms.finer().taken_over(coefficients, terms)
    coarse = coefficients @ terms.rows(*factors)[PLAIN:]
    assert taken @ terms.finer().rows(*factors)[PLAIN:] == pytest.approx(coarse)


def test_rates_of_the_slope_law_are_its_differences() -> None:
    distance = np.linspace(3.0, 60.0, 50)

    def law(radius: float = 22.0, blur_px: float = 3.0, moved: float = 0.0) -> np.ndarray:
        return slope_law(distance + moved, radius, 30.0, blur_px, 120.0)[0]

    _, away, by_radius, by_blur = slope_law(distance, 22.0, 30.0, 3.0, 120.0)
    assert away == pytest.approx((law(moved=0.4) - law(moved=-0.4)) / 0.8, abs=2e-3)
    assert by_radius == pytest.approx((law(22.0 + WIDER_PX) - law()) / WIDER_PX, abs=1e-9)
    assert by_blur == pytest.approx((law(blur_px=3.1) - law(blur_px=2.9)) / 0.2, abs=2e-3)


@pytest.mark.parametrize("count", [1, 5])
def test_a_few_rounds_reach_the_optimum(count: int) -> None:
    """Circles, blur and map step together, so that none waits for another to follow."""
    circles = scattered(count, seed=3)
    starts = [ContactCircle(c.u_px + 3.0, c.v_px - 2.0, 0.9 * c.radius_px) for c in circles]
    changes = [color_change(pressed(c, blur_px=3.0), gel(), GRID) for c in circles]
    samples = [sample_rings(one.change, c) for one, c in zip(changes, starts, strict=True)]
    fits: list[Any] = [starts]
    for iterations in (6, 6, 60):
        fits.append(fit_contacts(samples, fits[-1], [BALL_PX] * count, iterations, blur_px=1.5))
    found, wanted = (circle_array([c.circle for c in fit.contacts]) for fit in fits[2:])
    assert np.abs(found - wanted).max() < 0.03
    assert np.abs(wanted - circle_array(circles)).max() < 0.3


def test_a_channel_without_light_has_no_say() -> None:
    circle = scattered(1, seed=5)[0]
    samples = sample_rings(color_change(pressed(circle), gel(), GRID).change, circle)
    dark = replace(samples, change=samples.change * np.array([1.0, 0.0, 1.0]))
    found = fit_contacts([dark], [circle], [BALL_PX], blur_px=1.5, iterations=14)
    assert not found.map[1].any()
    shown, wanted = circle_array([found.contacts[0].circle]), circle_array([circle])
    assert shown == pytest.approx(wanted, abs=0.3)
