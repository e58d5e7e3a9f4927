# SPDX-License-Identifier: Apache-2.0
"""What a press states of its force, heights and image by all that is uncertain, and the ranges of
parameters that a profile gives for it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import taccel_lab as tl
from taccel_lab.errors import InputError
from taccel_lab.presses import (
    PressOutcome,
    PressSetup,
    SeenFrom,
    parse_indenter,
    simulate_press,
)
from taccel_lab.presses.bonded_layer import layer_force_n
from taccel_lab.presses.force_interval import (
    FASTER,
    FRICTION_SHARE,
    SLOWER,
    Cause,
    ForceInterval,
    force_causes,
    force_power,
    relaxing_factor,
)
from taccel_lab.presses.path import SPEED_MM_S
from taccel_lab.profile import PerturbationBlock, Provenance
from taccel_lab.profile.assumed import POISSON_RATIOS
from taccel_lab.profile.measured_range import measured_ranges
from taccel_lab.scene import MaxwellBranch
from tests.presses.formula_presses import Presses, Resolution, outcome
from tests.support.blocks import block_mesh
from tests.support.coarse_pads import GEL, LINEAR

BALL = parse_indenter("sphere:4")


@pytest.fixture(scope="module")
def pad():
    return tl.load_sensor("flat_pad")


def pressed(force_n: float = 2.0) -> PressOutcome:
    return replace(outcome(Resolution.of(0), force_n), force_error_n=0.02 * force_n)


def causes(pad: tl.SensorProfile, **known: Any) -> dict[str, Cause]:
    found = force_causes(pad, BALL, pressed(), friction=known.pop("friction", None), **known)
    return {each.name: each for each in found}


def of_measured(pad: tl.SensorProfile, **tables: Any) -> tl.SensorProfile:
    known = pad.material.provenance.model_copy(update={"kind": "measured", **tables})
    return pad.with_block(pad.material.replace(provenance=known))


def test_independent_causes_add_by_squares_of_logarithms():
    one, two = Cause("a", 0.5, 2.0), Cause("b", 1 / 1.1, 1.1)
    found = ForceInterval.of(3.0, (one, two))
    off = math.hypot(math.log(2), math.log(1.1))
    assert (found.low_n, found.high_n) == pytest.approx((3 * math.exp(-off), 3 * math.exp(off)))
    assert ForceInterval.of(3.0, ()).low_n == ForceInterval.of(3.0, ()).high_n == 3.0
    nothing = ForceInterval.of(0.0, (one,))
    assert nothing.low_n == nothing.high_n == 0.0
    assert found.words().index("a x 0.5 to 2") < found.words().index("b -9.1 to +10 %")


def test_what_is_left_after_a_way_back_is_told_from_nothing_by_the_error_in_newtons(pad):
    """4.5e-6 N after unloading had an interval that excluded 0."""
    after = replace(pressed(4.5e-6), force_error_n=1e-3)
    assert "numerical" not in {each.name for each in force_causes(pad, BALL, after, None)}
    found = ForceInterval.of(4.5e-6, (Cause("a", 0.5, 2.0),), 1e-3)
    assert found.low_n == pytest.approx(-1e-3, rel=0.01) and found.high_n > 1e-3
    assert ForceInterval.of(1.0, (), 0.1).low_n == 1.0


def test_a_ratio_that_nobody_measured_is_one_of_silicone(pad):
    """0.46 to 0.49 is +5.5 % of a force, and was in no interval."""
    found = causes(pad)["Poisson's ratio"]
    layer = [
        layer_force_n("sphere", np.array(0.5), 4.0, pad.gel.thickness_mm, ratio)
        for ratio in (*POISSON_RATIOS, pad.material.poisson_ratio)
    ]
    assert (found.low, found.high) == pytest.approx((layer[0] / layer[2], layer[1] / layer[2]))
    assert 1.0 - found.low < 0.02 and 1.05 < found.high < 1.25
    fitted = of_measured(
        pad,
        kind="calibrated",
        inputs={"a": "0" * 64},
        residuals={"n": 1.0},
        valid_region={"n": (0.0, 1.0)},
    )
    assert "Poisson's ratio" not in causes(fitted), "a modulus is fitted with it"


RELAXING = (MaxwellBranch(0.4, 0.5), MaxwellBranch(0.3, 5.0))


@pytest.mark.thorough
def test_a_press_of_unknown_speed_may_be_ten_times_as_fast_or_slow(pad):
    """Forces of a gel that relaxes, simulated at three speeds, and after a hold."""
    mesh, gel = block_mesh((6, 6, 3), (8e-3, 8e-3, 3e-3)), replace(GEL, branches=RELAXING)

    def simulated(**path: float) -> PressOutcome:
        setup = PressSetup(mesh, gel, parse_indenter("sphere:3"), physics=LINEAR)
        seen = SeenFrom(tl.PixelGrid(16, 16, 0.4, 0.4))
        way = tl.PressPath(0.5, **path).bounded(RELAXING, 0.0)
        return simulate_press(setup, (0.0, 0.0), way, seen)

    usual = simulated()
    rest = relaxing_factor(RELAXING, usual)
    for faster in (SLOWER, FASTER):
        other = simulated(speed_mm_s=SPEED_MM_S * faster)
        told = relaxing_factor(RELAXING, usual, faster) / rest
        assert told == pytest.approx(other.force_n / usual.force_n, rel=0.015)
    held = simulated(hold_s=2.0)
    told = relaxing_factor(RELAXING, held) / rest
    assert told == pytest.approx(held.force_n / usual.force_n, rel=0.015)

    entries = [{"relative_modulus": b.relative_modulus, "time_s": b.time_s} for b in RELAXING]
    relaxing = pad.with_block(pad.material.replace(branches=entries))
    found = {each.name: each for each in force_causes(relaxing, BALL, usual, None, is_timed=False)}
    assert found["speed"].low == pytest.approx(relaxing_factor(RELAXING, usual, SLOWER) / rest)
    assert found["speed"].high == pytest.approx(relaxing_factor(RELAXING, usual, FASTER) / rest)
    assert found["speed"].low < 0.9 and found["speed"].high > 1.05
    timed = force_causes(relaxing, BALL, usual, None)
    assert "speed" not in {each.name for each in timed}


def test_a_gel_that_nobody_tested_may_be_twice_as_stiff(pad):
    found = causes(pad)
    assert (found["Young's modulus"].low, found["Young's modulus"].high) == (0.5, 2.0)
    assert found["numerical"].high == pytest.approx(1.02)
    # A thicker pad is softer; Hayes' layer of 4 mm by 5 %.
    assert 0.95 < found["thickness"].low < 1.0 < found["thickness"].high < 1.06
    assert found["friction"].low == 1 - FRICTION_SHARE
    assert "depth" not in found and "speed" not in found


def test_what_is_known_makes_the_interval_smaller(pad):
    pa = pad.material.young_modulus_pa
    known = of_measured(pad, interval={"young_modulus_pa": (0.9 * pa, 1.2 * pa)})
    found = causes(known, slippery=0.96)
    for name, ends in (("Young's modulus", (0.9, 1.2)), ("friction", (0.96, 1.02))):
        assert (found[name].low, found[name].high) == pytest.approx(ends)
    assert "friction" not in causes(known, friction=0.5)
    wide, narrow = (ForceInterval.of(2.0, tuple(causes(p).values())) for p in (pad, known))
    assert wide.low_n < narrow.low_n < 2.0 < narrow.high_n < wide.high_n


def test_a_spread_that_no_gel_has_is_no_reason_to_refuse_a_press(pad):
    wild = {"young_modulus_pa": pad.material.young_modulus_pa, "poisson_ratio": 0.1}
    found = causes(of_measured(pad, spread={**wild, "friction_coefficient": 0.1}))
    assert found["Young's modulus"].low == 0.5, "a spread as large as its value says nothing"
    assert found["Poisson's ratio"].low < 1.0 < found["Poisson's ratio"].high
    assert 1 - FRICTION_SHARE < found["friction"].low < 1.0


def test_a_depth_that_was_read_counts_by_the_power_that_force_grows_with(pad):
    press = pressed()
    assert force_power(press) == 1.5
    (step,) = press.steps
    steps = [replace(step, depth_mm=d, wrench=2.0 * d**2 * np.eye(6)[2]) for d in (0.25, 0.5)]
    press = replace(press, steps=steps, path=replace(press.path, step_mm=0.25))
    assert force_power(press) == pytest.approx(2.0)
    found = force_causes(pad, BALL, press, None, depth_sigma_mm=0.05)[-1]
    assert (found.low, found.high) == pytest.approx((0.8**2, 1.2**2))


def test_presses_without_anything_in_contact_have_no_share(pad):
    found = Presses(-1.0, order=0.0).measured(BALL.shape)
    assert found.error.factor == 1.0 and found.error.changes == (0.0, 0.0)
    assert "numerical" not in {each.name for each in force_causes(pad, BALL, pressed(0.0), None)}


def calibrated(**tables: Any) -> Provenance:
    return Provenance(
        kind="calibrated", method="a test", source="a test", inputs={"file": "0" * 64},
        residuals={"force_n": 0.1}, valid_region={"depth_mm": (0.0, 1.0)}, **tables,
    )  # fmt: skip


def with_fit(pad: tl.SensorProfile, between: dict | None = None, **tables: Any) -> tl.SensorProfile:
    """With a material of 100 kPa, 0.45 and 0.8 that was fitted, and a spread between units."""
    values = {"young_modulus_pa": 1e5, "poisson_ratio": 0.45, "friction_coefficient": 0.8}
    profile = pad.with_block(pad.material.replace(**values, provenance=calibrated(**tables)))
    block = PerturbationBlock(**(between or {}), provenance=calibrated())
    return profile.with_block(block) if between else profile


def ends(profile: tl.SensorProfile) -> dict[str, tuple[float, float]]:
    return {name: (item.low, item.high) for name, item in measured_ranges(profile).items()}


def test_an_interval_is_taken_as_it_is(pad):
    interval = {"young_modulus_pa": (9e4, 1.3e5), "poisson_ratio": (0.44, 0.47)}
    profile = with_fit(pad, interval=interval, spread={"young_modulus_pa": 1.0})
    assert ends(profile) == {
        name: pytest.approx(each, rel=1e-12) for name, each in interval.items()
    }
    said = {item.rests_on for item in measured_ranges(profile).values()}
    assert said == {"the calibration's 95 % interval"}


def test_two_standard_deviations_stand_in_for_an_interval(pad):
    profile = with_fit(pad, spread={"friction_coefficient": 0.05, "density_kg_m3": 1.0})
    assert ends(profile) == {"friction_coefficient": pytest.approx((0.7, 0.9))}
    assert measured_ranges(profile)["friction_coefficient"].sigma == pytest.approx(0.05)


def test_the_spread_between_units_counts_beside_that_of_the_fit(pad):
    """3 and 4 make 5, below the value; 12 and 5 make 13 above it."""
    units = {"young_modulus_relative": 0.02, "friction_coefficient": 0.1}
    profile = with_fit(pad, units, interval={"young_modulus_pa": (9.7e4, 1e5 + 4800)})
    found = ends(profile)
    assert found["young_modulus_pa"] == pytest.approx((9.5e4, 1e5 + np.hypot(4800, 4000)))
    assert found["friction_coefficient"] == pytest.approx((0.6, 1.0))
    assert "between units" in measured_ranges(profile)["young_modulus_pa"].rests_on
    # Friction cannot be negative; 0 is a gel that slips.
    slippery = ends(with_fit(pad, {"friction_coefficient": 0.6}))
    assert slippery["friction_coefficient"] == pytest.approx((0.0, 2.0))


def test_what_was_not_measured_has_no_spread(pad):
    assert ends(pad) == {}
    guessed = Provenance(kind="assumed", method="a guess", source="none")
    block = PerturbationBlock(young_modulus_relative=0.2, provenance=guessed)
    assert ends(pad.with_block(block)) == {}
    spread = guessed.model_copy(update={"spread": {"young_modulus_pa": 1e4}})
    assert ends(pad.with_block(pad.material.replace(provenance=spread))) == {}


def test_ranges_that_no_gel_has_are_refused(pad):
    for profile, words in (
        (with_fit(pad, {"young_modulus_relative": 1.0}), "reaches from -100000 to 300000"),
        (with_fit(pad, spread={"poisson_ratio": 0.03}), r"spread of poisson_ratio .* to 0.51"),
    ):
        with pytest.raises(InputError, match=f"{words}, which no gel has"):
            measured_ranges(profile)
