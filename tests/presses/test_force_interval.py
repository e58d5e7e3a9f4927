# SPDX-License-Identifier: Apache-2.0
"""What a press states of its force, heights and image by all that is uncertain."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import taccel_lab as tl
from taccel_lab.presses import PressOutcome, parse_indenter
from taccel_lab.presses.force_interval import (
    FRICTION_SHARE,
    Cause,
    ForceInterval,
    force_causes,
    force_power,
)
from taccel_lab.presses.measured_press import height_error_mm, image_error_levels
from tests.presses.test_measured_press import DEPTH_M, Presses, Resolution, outcome

BALL = parse_indenter("sphere:4")


@pytest.fixture(scope="module")
def pad():
    return tl.load_sensor("flat_pad")


def pressed(share: float = 0.02, force_n: float = 2.0) -> PressOutcome:
    return replace(outcome(Resolution.of(0), force_n), force_error_n=share * force_n)


def causes(pad: tl.SensorProfile, **known: float) -> dict[str, Cause]:
    found = force_causes(pad, BALL, pressed(), friction=known.pop("friction", None), **known)
    return {each.name: each for each in found}


def fitted(pad: tl.SensorProfile, pa: tuple[float, float]) -> tl.SensorProfile:
    material = pad.material
    known = material.provenance.model_copy(
        update={"kind": "measured", "interval": {"young_modulus_pa": pa}}
    )
    return pad.with_block(material.replace(provenance=known))


def test_independent_causes_add_by_squares_of_logarithms():
    one, two = Cause("a", 0.5, 2.0), Cause("b", 1 / 1.1, 1.1)
    found = ForceInterval.of(3.0, (one, two))
    off = math.hypot(math.log(2), math.log(1.1))
    assert (found.low_n, found.high_n) == pytest.approx((3 * math.exp(-off), 3 * math.exp(off)))
    assert ForceInterval.of(3.0, ()).low_n == ForceInterval.of(3.0, ()).high_n == 3.0
    nothing = ForceInterval.of(0.0, (one,))
    assert nothing.low_n == nothing.high_n == 0.0
    assert found.words().index("a x 0.5 to 2") < found.words().index("b -9.1 to +10 %")


def test_a_gel_that_nobody_tested_may_be_twice_as_stiff(pad):
    found = causes(pad)
    assert (found["Young's modulus"].low, found["Young's modulus"].high) == (0.5, 2.0)
    assert found["numerical"].high == pytest.approx(1.02)
    # A thicker pad is softer; Hayes' layer of 4 mm by 5 %.
    assert 0.95 < found["thickness"].low < 1.0 < found["thickness"].high < 1.06
    assert found["friction"].low == 1 - FRICTION_SHARE
    assert "depth" not in found and "Poisson's ratio" not in found


def test_what_is_known_makes_the_interval_smaller(pad):
    pa = pad.material.young_modulus_pa
    known = fitted(pad, (0.9 * pa, 1.2 * pa))
    found = causes(known, slippery=0.96)
    assert found["Young's modulus"].low == pytest.approx(0.9)
    assert found["Young's modulus"].high == pytest.approx(1.2)
    assert found["friction"].low == pytest.approx(0.96)
    assert found["friction"].high == pytest.approx(1.02)
    assert "friction" not in causes(known, friction=0.5)
    wide, narrow = (ForceInterval.of(2.0, tuple(causes(p).values())) for p in (pad, known))
    assert wide.low_n < narrow.low_n < 2.0 < narrow.high_n < wide.high_n


def test_a_spread_that_no_gel_has_is_no_reason_to_refuse_a_press(pad):
    material, pa = pad.material, pad.material.young_modulus_pa
    wild = {"young_modulus_pa": pa, "poisson_ratio": 0.1, "friction_coefficient": 0.1}
    known = material.provenance.model_copy(update={"kind": "measured", "spread": wild})
    found = causes(pad.with_block(material.replace(provenance=known)))
    assert found["Young's modulus"].low == 0.5, "a spread as large as its value says nothing"
    assert found["Poisson's ratio"].low < 1.0 < found["Poisson's ratio"].high
    assert 1 - FRICTION_SHARE < found["friction"].low < 1.0


def test_a_depth_that_was_read_counts_by_the_power_that_force_grows_with(pad):
    press = pressed()
    assert force_power(press) == 1.5
    steps = [
        replace(press.steps[0], depth_mm=d, wrench=2.0 * d**2 * np.eye(6)[2]) for d in (0.25, 0.5)
    ]
    press = replace(press, steps=steps, path=replace(press.path, step_mm=0.25))
    assert force_power(press) == pytest.approx(2.0)
    found = force_causes(pad, BALL, press, None, depth_sigma_mm=0.05)[-1]
    assert (found.low, found.high) == pytest.approx((0.8**2, 1.2**2))


def test_heights_and_images_hold_depth_place_and_colours(pad):
    press = replace(pressed(), height_error_m=2e-6)
    assert height_error_mm(press, 0.0).total == height_error_mm(press, 0.0).numerical == 2e-3
    read = height_error_mm(press, 0.02)
    moved_mm = 1e3 * DEPTH_M
    assert read.total == pytest.approx(math.hypot(2e-3, moved_mm * 2 * 0.02 / moved_mm), rel=1e-6)
    rgb = np.full((4, 5, 3), 100.0)
    rgb[:, 2:] = 130.0
    colours = pad.material.provenance.model_copy(update={"residuals": {}})
    plain = image_error_levels(press, rgb, rgb - 1.0, 0 * rgb + 90.0, colours, 0.0, 0.0)
    assert plain.numerical == plain.total == pytest.approx(1.0)
    seen = colours.model_copy(update={"residuals": {"heldout_crop_psnr_db": 40.0}})
    total = image_error_levels(press, rgb, rgb - 1.0, 0 * rgb + 90.0, seen, 0.0, 0.0).total
    assert total == pytest.approx(math.hypot(1.0, 2.55))
    doubted = image_error_levels(press, rgb, rgb - 1.0, 0 * rgb + 90.0, seen, 0.01, 0.5).total
    assert doubted > 5.0


def test_presses_without_anything_in_contact_have_no_share(pad):
    found = Presses(-1.0, 0.0, 0.0, 0.0).measured()
    assert found.error.factor == 1.0 and found.error.changes == (0.0, 0.0)
    names = {each.name for each in force_causes(pad, BALL, pressed(force_n=0.0), None)}
    assert "numerical" not in names
