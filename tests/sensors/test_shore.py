# SPDX-License-Identifier: Apache-2.0
"""Shore hardness as the stiffness of a gel: formulas, agreement of the scales, refusals."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.errors import InputError
from taccel_lab.sensors.parameter_groups.material import FACTOR, READINGS, Scale, modulus_of_shore
from taccel_lab.sensors.registry import sensor_family

A_AND_00 = {20: 70, 25: 76, 30: 80, 35: 83}
"""Readings of one rubber on both scales, from suppliers' tables."""
STRETCHED_TO_TWICE = {
    ("00", 30): 0.069, ("00", 50): 0.083, ("A", 10): 0.151, ("A", 20): 0.338, ("A", 30): 0.593,
}  # fmt: skip
"""Stress [MPa] of casting silicones (Ecoflex 00-30, 00-50; Dragon Skin 10, 20, 30) at 100 % strain,
by their maker's data sheets; neo-Hookean, E is 12/7 of it."""


def test_gent_at_shore_a_10() -> None:
    assert modulus_of_shore("A", 10).pa == pytest.approx(0.413e6, rel=2e-3)


@pytest.mark.parametrize(("a", "double_o"), A_AND_00.items())
def test_both_scales_agree_where_they_overlap(a: float, double_o: float) -> None:
    ratio = modulus_of_shore("00", double_o).pa / modulus_of_shore("A", a).pa
    assert 1 / 1.4 < ratio < 1.4


@pytest.mark.parametrize(("reading", "stress"), STRETCHED_TO_TWICE.items())
def test_silicones_of_known_stress_lie_within_the_interval(
    reading: tuple[Scale, float], stress: float
) -> None:
    found = modulus_of_shore(*reading)
    assert found.low_pa <= 12 / 7 * stress * 1e6 <= found.high_pa


@given(scale=st.sampled_from(["00", "A"]), data=st.data())
def test_harder_is_stiffer(scale: Scale, data: st.DataObject) -> None:
    low, high = READINGS[scale]
    one, other = sorted(data.draw(st.tuples(*2 * [st.floats(low, high)])))
    soft, hard = modulus_of_shore(scale, one), modulus_of_shore(scale, other)
    assert 1e4 < soft.pa <= hard.pa < 5e7
    assert soft.low_pa * FACTOR < soft.pa < soft.high_pa / FACTOR


def test_hardness_is_a_parameter_of_every_family() -> None:
    gel = sensor_family("digit").parameters({"shore_00": 40}).material()
    assert gel.young_modulus_pa == modulus_of_shore("00", 40).pa
    assert gel.young_interval_pa is not None
    core, skin = sensor_family("9dtact").parameters({"shore_a": 15}).layer_materials()
    assert skin.young_modulus_pa == core.young_modulus_pa
    assert sensor_family("digit").parameters().material().young_interval_pa is None


def test_a_gel_of_a_hardness_is_incompressible_unless_something_else_is_given() -> None:
    family = sensor_family("9dtact")
    found = family.parameters({"shore_00": 40})
    assert [m.poisson_ratio for m in found.layer_materials()] == [0.499, 0.499]
    assert "hardness" in found.describe()["poisson_ratio"]["source"]
    given = family.parameters({"shore_a": 15, "poisson_ratio": 0.46})
    assert [m.poisson_ratio for m in given.layer_materials()] == [0.46, 0.499]
    assert given.describe()["poisson_ratio"]["value"] == 0.46
    for values in ({}, {"shore_00": 0.0}, {"young_modulus_mpa": 0.2}):
        assert family.parameters(values).material().poisson_ratio == 0.46
    digit = sensor_family("digit").parameters({"shore_00": 40})
    assert digit.material().poisson_ratio == 0.499 and "skin_poisson_ratio" not in digit.values()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"shore_00": 30, "shore_a": 10}, "shore_00 and shore_a are given"),
        ({"shore_00": 30, "young_modulus_mpa": 0.3}, "young_modulus_mpa and shore_00 are given"),
        ({"shore_00": 120}, "above its bound; allowed: 0 .not given. or 5 to 90"),
        ({"shore_a": math.nan}, "is not a number"),
        ({"shore_00": "55 OO"}, "is not a number"),
    ],
)
def test_what_is_no_hardness_is_refused(values: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        sensor_family("digit").parameters(values)
