# SPDX-License-Identifier: Apache-2.0
"""Every number of a profile has bounds: none may be off by a factor of 1,000, of the other sign, 0,
huge or no number, but where ``ALLOWED`` says why it may."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.profile import (
    DepthResponseBlock,
    PerturbationBlock,
    Provenance,
    SensorProfile,
    load_profile,
)
from taccel_lab.profile.sensor_profile import ARRAY_FIELDS
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.sensors.registry import judge_parameters
from tests.fuzz.samples.profiles import with_force
from tests.support.sample_blocks import ASSUMED, CALIBRATED
from tests.support.sensor_refusals import refuses

CHANGES: dict[str, Callable[[float], float]] = {
    "x1000": lambda value: 1e3 * value,
    "/1000": lambda value: 1e-3 * value,
    "negative": lambda value: -value,
    "zero": lambda value: 0 * value,
    "nan": lambda value: math.nan,
    "inf": lambda value: math.inf,
    "1e300": lambda value: 1e300,
}
SMALL, PLACE, ANY = "/1000 zero", "/1000 zero negative", "x1000 /1000 zero negative"
ALLOWED = {
    # A name, what is allowed of it, and why no bound can say otherwise.
    r"material\.(layers\.\d\.)?poisson_ratio": SMALL,  # Of foams.
    r"material\.friction_coefficient": SMALL,  # Studies press without friction.
    r"material\.layers\.\d\.young_modulus_pa": "x1000",  # A film over the gel.
    r"camera\.center_._px": PLACE,  # An image may show a corner of the gel.
    r"optics\.c[xy]_px": SMALL,  # The lens may stand beside the image's middle.
    r"optics\.position_mm\.[01]": ANY,  # A place beside the axis, at most 1 mm or 0.5 images.
    r"optics\.rotation\.\d": "negative",  # The same turn.
    r"optics\.distortion\.\d": ANY,  # Of any sign; where the image is small it bends nothing.
    r"optics\.(focus_mm|aperture_mm)": "zero",  # Unknown; a pinhole.
    r"optics\.(falloff|ambient_rgb\.\d|gel_scattering_per_mm)": SMALL,  # Corrected, dark, clear.
    r"coating\.(albedo_rgb\.\d|specular)": SMALL,  # Coloured, matt.
    r"coating\.thickness_mm": "zero",  # None.
    r"lights\.led\.\d+\.position_mm\.[01]": ANY,  # Around the gel, where it shines on some of it.
    r"lights\.led\.\d+\.position_mm\.2": SMALL,  # At the height of the apex, beside the gel.
    r"lights\.led\.\d+\.direction\.\d": ANY,  # Of any unit vector; 1e-16 is 0.
    r"lights\.led\.\d+\.(rgb\.\d|lobe)": "x1000 /1000 zero",  # Dim, even; 1e-16 is 0.
    r"lights\.led\.\d+\.size_mm\.\d": "zero",  # A point.
    r"markers\.(offset_mm\.\d|rotation_deg|stagger)": PLACE,  # A place, a turn.
    r"housing\.(corner_radius_mm|front_z_mm)": SMALL,  # Sharp; flush with the apex.
    r"housing\.offset_mm\.\d": PLACE,
    r"depth_response\.(depth_mm|drop_levels)\.[01]": SMALL,  # The curve begins at any depth.
    r"depth_response\.(\w+_sigma_mm|depth_share)": SMALL,  # A small error.
    r"perturbation\.\w+(\.\d)?": SMALL,  # Units that are alike.
    r"(color|normals)\.architecture\.input_mean\.\d+": ANY,  # Within what the input may be.
    r"(color|normals)\.architecture\.input_scale\.\d+": "/1000",  # Fits take 0.001 for constants.
    r"color\.architecture\.output_scale": "/1000",  # Where answers stay above half a level.
    r"normals\.architecture\.scales_px\.\d": "zero",  # The pixel itself.
    r"\w+\.architecture\.(\w+_factor|depth_share|error_length_px|stiffness_relative)": SMALL,
    r"force\.architecture\.target_scale\.\d": "/1000",  # A press that has hardly any moment.
    r"\w+\.provenance\.residuals\.\w+": ANY,  # How bad a fit is, within its unit.
    r"\w+\.provenance\.spread\.\w+": "x1000 /1000 zero",  # How little is known, likewise.
    r"\w+\.provenance\.(valid_region|interval)\.\w+\.\d": ANY,  # Where it was tested, likewise.
    # A family's own bounds may span more than a factor of 1,000, and its angles have a sign.
    r"sensor\.parameters\.\w+(\.\d)?": ANY,
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
    return type(value)((*value[: path[0]], inner, *value[path[0] + 1 :]))


def arrays_of(profile: SensorProfile, key: str) -> Any:
    """Arrays that a block describes, None without."""
    return getattr(profile, ARRAY_FIELDS[key]) if key in ARRAY_FIELDS else None


def accepted(profile: SensorProfile) -> Iterator[tuple[str, float, str]]:
    """Every change of a number that the profile takes: name, value and change."""
    for key, block in profile.blocks().items():
        table = block.model_dump(mode="python")
        for (path, value), (change, by) in product(numbers(table), CHANGES.items()):
            new = by(value)
            if isinstance(value, int) and math.isfinite(new):
                new = int(new)
            if new == value:  # Of 0 there is one.
                continue
            try:
                other = type(block)(**changed(table, path, new))
                found = profile.with_block(other, arrays_of(profile, key))
            except InputError:
                continue
            if not judge_parameters(found.sensor).faults:
                yield ".".join(map(str, (key, *path))), value, change


def with_responses(profile: SensorProfile) -> SensorProfile:
    depth = DepthResponseBlock(
        drop_levels=(4.0, 10.0, 60.0), depth_mm=(0.1, 0.3, 1.5), reading_sigma_mm=0.02,
        zero_sigma_mm=0.01, depth_share=0.03, provenance=CALIBRATED,
    )  # fmt: skip
    perturbation = PerturbationBlock(
        gain_rgb=(0.05, 0.04, 0.05), pivot_rgb=(90.0, 100.0, 80.0), offset_rgb=(2.0, 2.0, 1.0),
        gradient_rgb=(1.0, 1.0, 1.0), noise_levels=1.5, mm_per_px_relative=0.01, center_px=3.0,
        young_modulus_relative=0.2, friction_coefficient=0.1, provenance=ASSUMED,
    )  # fmt: skip
    return profile.with_block(depth).with_block(perturbation)


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["digit_360", "gelsight_mini", "9dtact", "networks"])
def test_every_number_of_a_profile_has_bounds(name: str, tmp_path: Path) -> None:
    if name == "networks":
        with_force(tmp_path)
        profile = load_profile(tmp_path / "profile")
        # Parameters that no family has are kept as they are.
        profile = profile.with_block(profile.sensor.replace(parameters={}))
    else:
        profile = with_responses(catalogue_profile(name))
    assert judge_parameters(profile.sensor).faults == ()
    wrong = []
    for place, value, change in accepted(profile):
        rules = [words for rule, words in ALLOWED.items() if re.fullmatch(rule, place)]
        if not any(change in words.split() for words in rules):
            wrong.append(f"{place} = {value:g} {change}")
    assert wrong == []


@pytest.mark.parametrize(
    ("name", "value"),
    [("thickness_mm", -5.0), ("thickness_mm", 4000.0), ("young_modulus_mpa", 150.0),
     ("poisson_ratio", 0.7), ("width_px", 10**400), ("width_px", "many")],
)  # fmt: skip
def test_parameters_keep_the_bounds_of_their_family(name: str, value: Any) -> None:
    sensor = catalogue_profile("gelsight_mini").sensor
    (fault,) = judge_parameters(
        sensor.replace(parameters={**sensor.parameters, name: value})
    ).faults
    assert re.match(rf"sensor\.parameters\.{name} = .*; allowed: ", fault)
    # Those of other families are not judged.
    for changes in ({"family": "mine"}, {"parameters": {"gone_mm": -5.0}}):
        assert judge_parameters(sensor.replace(**changes)).faults == ()


def evidence(**tables: Any) -> dict[str, Provenance]:
    return {"provenance": ASSUMED.model_copy(update=tables)}


def changed_block(key: str, changes: dict[str, Any]) -> None:
    profile = with_responses(catalogue_profile("gelsight_mini"))
    profile.with_block(profile.blocks()[key].replace(**changes), arrays_of(profile, key))


test_blocks_have_to_agree = refuses(
    changed_block,
    ("camera", {"mm_per_px_x": 0.9}, "mm_per_px_x: the image is .* mm long along x, the gel"),
    ("camera", {"center_u_px": -40.0}, r"sees the gel's origin .* px from camera\.center_u_px"),
    ("optics", {"fx_px": 2500.0}, "at the gel a pixel is .* mm wide"),
    ("optics", {"rotation": (1.0, 0.0, 0.0, 0.0)}, "looks away from the gel"),
    ("optics", {"raw_width_px": 0}, "both are known or both 0"),
    ("optics", {"distortion": (-40.0, 0.0, 0.0, 0.0)}, "distortion: folds or bends"),
    ("markers", {"offset_mm": (60.0, 0.0)}, "no dot lies on the gel"),
    ("housing", {"wall_mm": 15.0}, r"wall_mm: at most 12 mm, half of the box"),
    ("perturbation", {"center_px": 900.0}, "at most 160 px, half the image"),
    ("depth_response", {"depth_mm": (0.1, 0.3, 40.0)}, "twice the gel's thickness"),
    ("depth_response", {"reading_sigma_mm": 2.0}, "the deepest touch"),
    ("window", {"outer_radius_mm": 9.0}, "a plate has no outer_radius_mm"),
    ("coating", {"thickness_mm": 4.9}, "coating.thickness_mm: at most the gel's"),
    ("gel", evidence(spread={"thickness_mm": -1.0}), "at least 0"),
    ("gel", evidence(spread={"thickness_mm": 900.0}), "the range of"),
    ("gel", evidence(interval={"thickness_mm": (0.01, 0.02)}), "a decade"),
    ("gel", evidence(residuals={"off_deg": 900.0}), "off_deg: must lie in"),
)


def test_lights_shine_on_the_gel_from_beside_it() -> None:
    profile = catalogue_profile("gelsight_mini")
    assert profile.lights is not None
    first, *others = profile.lights.led
    for changes, words in (
        ({"direction": tuple(-np.array(first.direction))}, "led.0: shines away from all"),
        ({"position_mm": (0.0, 0.0, -12.0)}, "led.0.position_mm: stands between camera and gel"),
    ):
        with pytest.raises(InputError, match=words):
            profile.with_block(profile.lights.replace(led=(first.replace(**changes), *others)))
