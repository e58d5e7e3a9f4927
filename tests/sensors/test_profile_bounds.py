# SPDX-License-Identifier: Apache-2.0
"""No figure of a profile may be off by a factor of 1,000, of the other sign or no number, but where
its own range allows that."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest

from taccel_lab.errors import InputError
from taccel_lab.profile import DepthResponseBlock, PerturbationBlock, SensorProfile
from taccel_lab.profile.sensor_profile import ARRAY_FIELDS
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.sensors.registry import parameter_faults
from tests.support.sample_blocks import ASSUMED, CALIBRATED

CHANGES = {"x1000": 1e3, "/1000": 1e-3, "negative": -1.0, "nan": float("nan")}
ALLOWED = {
    # A name, what is allowed of it, and why no bound can say otherwise.
    r"material\.(layers\.\d\.)?(poisson_ratio|friction_coefficient)": "/1000",  # may be 0
    r"material\.layers\.\d\.young_modulus_pa": "x1000",  # A film over the gel.
    r"camera\.center_._px|optics\.c[xy]_px": "/1000",  # The image may begin at the axis.
    r"optics\.position_mm\.[01]": "x1000 /1000 negative",  # A place beside the axis.
    r"optics\.rotation\.\d": "x1000 /1000 negative",  # Of any unit quaternion; -1 is the same turn.
    r"optics\.distortion\.\d": "x1000 /1000 negative",  # Coefficients of any sign, up to some tens.
    r"optics\.(falloff|ambient_rgb\.\d|gel_scattering_per_mm)": "/1000",  # may be 0
    r"optics\.raw_\w+_px": "/1000",  # 480 // 1000 is 0: unknown.
    r"coating\.(albedo_rgb\.\d|specular|roughness)": "/1000",  # Black, matt.
    r"lights\.led\.\d+\.position_mm\.[01]": "x1000 /1000 negative",  # 1e-16 is 0
    r"lights\.led\.\d+\.position_mm\.2": "/1000",
    r"lights\.led\.\d+\.direction\.\d": "x1000 /1000 negative",  # Of any unit vector.
    r"lights\.led\.\d+\.(rgb\.\d|lobe)": "x1000 /1000",  # may be 0, and 1e-16 is 0
    r"markers\.(offset_mm\.\d|rotation_deg|stagger)": "/1000 negative",  # A place, a turn.
    r"housing\.(corner_radius_mm|front_z_mm)": "/1000",  # may be 0
    r"housing\.offset_mm\.\d": "/1000 negative",  # A place.
    r"depth_response\.(depth_mm|drop_levels)\.0": "/1000",  # may be 0
    r"depth_response\.(\w+_sigma_mm|depth_share)": "x1000 /1000",  # Of 1 um 1 mm is made.
    r"perturbation\.\w+(\.\d)?": "x1000 /1000",  # A spread may be small.
}


def numbers(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], float]]:
    """Places and values of the numbers in a table."""
    if isinstance(value, dict | list | tuple):
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            yield from numbers(inner, (*path, key))
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield path, value


def changed(value: Any, path: tuple[Any, ...], new: float) -> Any:
    if not path:
        return new
    inner = changed(value[path[0]], path[1:], new)
    if isinstance(value, dict):
        return {**value, path[0]: inner}
    return (*value[: path[0]], inner, *value[path[0] + 1 :])


def accepted(profile: SensorProfile) -> Iterator[tuple[str, float, str]]:
    """Every change of a number that the profile takes: name, value and change."""
    for key, block in profile.blocks().items():
        table = block.model_dump(mode="python")
        provenance = table.pop("provenance")
        arrays = getattr(profile, ARRAY_FIELDS[key]) if key in ARRAY_FIELDS else None
        for path, value in numbers(table):
            for change, factor in CHANGES.items():
                new = type(value)(value * factor) if change != "nan" else value * factor
                if new == value:  # Of 0 there is one.
                    continue
                try:
                    other = type(block)(**changed(table, path, new), provenance=provenance)
                    found = profile.with_block(other, arrays)
                except InputError:
                    continue
                if not parameter_faults(found):
                    yield ".".join(map(str, (key, *path))), value, change


def with_responses(profile: SensorProfile) -> SensorProfile:
    blocks = (
        DepthResponseBlock(
            drop_levels=(4.0, 10.0, 60.0), depth_mm=(0.1, 0.3, 1.5), reading_sigma_mm=0.02,
            zero_sigma_mm=0.01, depth_share=0.03, provenance=CALIBRATED,
        ),
        PerturbationBlock(
            gain_rgb=(0.05, 0.04, 0.05), pivot_rgb=(90.0, 100.0, 80.0), offset_rgb=(2.0, 2.0, 1.0),
            gradient_rgb=(1.0, 1.0, 1.0), noise_levels=1.5, mm_per_px_relative=0.01, center_px=3.0,
            young_modulus_relative=0.2, friction_coefficient=0.1, provenance=ASSUMED,
        ),
    )  # fmt: skip
    for block in blocks:
        profile = profile.with_block(block)
    return profile


@pytest.mark.parametrize(
    "name", ["digit", "digit_360", "gelsight_mini", "gelsight_wedge", "9dtact", "rtac"]
)
def test_a_figure_that_is_far_off_is_refused(name: str) -> None:
    profile = with_responses(catalogue_profile(name))
    assert parameter_faults(profile) == []
    wrong = []
    for place, value, change in accepted(profile):
        family = place.startswith("sensor.parameters.")
        rules = [words for rule, words in ALLOWED.items() if re.fullmatch(rule, place)]
        if not family and not any(change in words.split() for words in rules):
            wrong.append(f"{place} = {value:g} {change}")
        # A family's own bounds may span more than a factor of 1,000, and its angles have a sign.
        if family and change == "nan":
            wrong.append(f"{place} = {value:g} {change}")
    assert wrong == []


@pytest.mark.parametrize(
    ("name", "value"),
    [("thickness_mm", -5.0), ("thickness_mm", 4000.0), ("young_modulus_mpa", 150.0),
     ("poisson_ratio", 0.7), ("width_px", 10**400), ("width_px", "many")],
)  # fmt: skip
def test_parameters_keep_the_bounds_of_their_family(name: str, value: Any) -> None:
    profile = catalogue_profile("gelsight_mini")
    sensor = profile.sensor
    parameters = {**sensor.parameters, name: value}
    (fault,) = parameter_faults(profile.with_block(sensor.replace(parameters=parameters)))
    assert re.match(rf"sensor\.parameters\.{name} = .*; allowed: ", fault)


def test_parameters_of_other_families_are_not_judged() -> None:
    profile = catalogue_profile("gelsight_mini")
    for changes in ({"family": "mine"}, {"parameters": {"gone_mm": -5.0}}):
        assert parameter_faults(profile.with_block(profile.sensor.replace(**changes))) == []
