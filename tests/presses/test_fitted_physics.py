# SPDX-License-Identifier: Apache-2.0
"""What a profile states of its fit: physics that a press should share, ranges of parameters."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import to_jsonable
from taccel_lab.presses import PHYSICS, Accuracy, physics_difference
from taccel_lab.presses.force_interval import measured_ranges
from taccel_lab.profile import (
    FittedWith,
    MaterialBlock,
    PerturbationBlock,
    Provenance,
    SensorProfile,
)
from taccel_lab.sensors.profile import catalogue_profile

DEFAULT = PHYSICS[Accuracy.DEFAULT]


def block(fitted: FittedWith | None, **provenance: Any) -> MaterialBlock:
    told = {"kind": "assumed", "method": "test", "source": "test", **provenance}
    return MaterialBlock(
        young_modulus_pa=2e5,
        poisson_ratio=0.47,
        density_kg_m3=1000.0,
        friction_coefficient=0.3,
        fitted_with=fitted,
        provenance=Provenance(**told),
    )


def fitted(friction: float = 0.3) -> FittedWith:
    return FittedWith(
        physics=to_jsonable(DEFAULT.record()),
        friction_coefficient=friction,
        friction_measured=False,
        indenters=("sphere:7.5",),
        touch_shift_mm={"press.csv": -0.02},
    )


def test_a_press_like_those_of_the_fit_says_nothing():
    assert physics_difference(block(fitted()), DEFAULT, 0.3) is None
    assert physics_difference(block(None), DEFAULT, 0.3) is None


@pytest.mark.parametrize(
    ("physics", "friction", "words"),
    [
        (DEFAULT, 0.8, "friction 0.3 (this press: 0.8)"),
        (PHYSICS[Accuracy.FAST], 0.3, "accuracy default (this press: fast)"),
        (
            dataclasses.replace(DEFAULT, dhat_m=2e-5),
            0.3,
            "contact range in metres 1e-05 (this press: 2e-05)",
        ),
        (
            dataclasses.replace(DEFAULT, mesh=dataclasses.replace(DEFAULT.mesh, rings=7)),
            0.3,
            f"mesh.rings {DEFAULT.mesh.rings} (this press: 7)",
        ),
    ],
)
def test_what_differs_is_named(physics, friction, words):
    said = physics_difference(block(fitted()), physics, friction)
    assert said is not None and words in said
    assert said.count("this press:") == 1


def test_an_older_calibration_is_said_to_be_unknown():
    old = block(
        None,
        kind="calibrated",
        inputs={"press.csv": "ab" * 32},
        residuals={"indentation_worst_relative": 0.01},
        spread={"young_modulus_pa": 1e3},
        valid_region={"depth_mm": (0.1, 1.0)},
    )
    said = physics_difference(old, DEFAULT, 0.3)
    assert said is not None and "not recorded" in said
    friction_only = old.replace(
        provenance=old.provenance.replace(spread={"friction_coefficient": 0.01})
    )
    assert physics_difference(friction_only, DEFAULT, 0.3) is None


def calibrated(**tables: Any) -> Provenance:
    return Provenance(
        kind="calibrated",
        method="a test",
        source="a test",
        inputs={"file": "0" * 64},
        residuals={"force_n": 0.1},
        valid_region={"depth_mm": (0.0, 1.0)},
        **tables,
    )


@pytest.fixture(scope="module")
def mini():
    return catalogue_profile("gelsight_mini")


def with_fit(profile: SensorProfile, **tables: Any) -> SensorProfile:
    """With a material of 100 kPa, 0.45 and 0.8, with_fit."""
    block = profile.material.replace(
        young_modulus_pa=1e5,
        poisson_ratio=0.45,
        friction_coefficient=0.8,
        provenance=calibrated(**tables),
    )
    return profile.with_block(block)


def between_units(profile: SensorProfile, **values: float) -> SensorProfile:
    return profile.with_block(PerturbationBlock(**values, provenance=calibrated()))


def ends(profile: SensorProfile) -> dict[str, tuple[float, float]]:
    return {name: (item.low, item.high) for name, item in measured_ranges(profile).items()}


def test_an_interval_is_taken_as_it_is(mini):
    interval = {"young_modulus_pa": (9e4, 1.3e5), "poisson_ratio": (0.44, 0.47)}
    profile = with_fit(mini, interval=interval, spread={"young_modulus_pa": 1.0})
    found = measured_ranges(profile)
    assert set(found) == set(interval)
    for name, wanted in interval.items():
        np.testing.assert_allclose((found[name].low, found[name].high), wanted, rtol=1e-12)
        assert found[name].rests_on == "the calibration's 95 % interval"


def test_two_standard_deviations_stand_in_for_an_interval(mini):
    found = ends(with_fit(mini, spread={"friction_coefficient": 0.05, "density_kg_m3": 1.0}))
    assert found == {"friction_coefficient": pytest.approx((0.7, 0.9))}


def test_the_spread_between_units_counts_beside_that_of_the_fit(mini):
    """3 and 4 make 5, below the value; 12 and 5 make 13 above it."""
    profile = with_fit(mini, interval={"young_modulus_pa": (9.7e4, 1e5 + 4800)})
    profile = between_units(profile, young_modulus_relative=0.02, friction_coefficient=0.1)
    found = ends(profile)
    high = 1e5 + np.hypot(4800, 4000)
    assert found["young_modulus_pa"] == pytest.approx((9.5e4, high))
    assert found["friction_coefficient"] == pytest.approx((0.6, 1.0))
    assert "between units" in measured_ranges(profile)["young_modulus_pa"].rests_on


def test_what_was_not_measured_has_no_spread(mini):
    assert ends(mini) == {}
    guessed = Provenance(kind="assumed", method="a guess", source="none")
    block = PerturbationBlock(young_modulus_relative=0.2, provenance=guessed)
    assert ends(mini.with_block(block)) == {}
    told = guessed.model_copy(update={"spread": {"young_modulus_pa": 1e4}})
    assert ends(mini.with_block(mini.material.replace(provenance=told))) == {}


def test_ranges_that_no_gel_has_are_refused(mini):
    with pytest.raises(InputError, match="reaches from -100000 to 300000, which no gel has"):
        measured_ranges(between_units(with_fit(mini), young_modulus_relative=1.0))
    with pytest.raises(InputError, match=r"spread of poisson_ratio .* to 0.51, which no gel has"):
        measured_ranges(with_fit(mini, spread={"poisson_ratio": 0.03}))
    # Friction cannot be negative; 0 is a gel that slips.
    found = ends(between_units(with_fit(mini), friction_coefficient=0.6))
    assert found["friction_coefficient"] == pytest.approx((0.0, 2.0))
