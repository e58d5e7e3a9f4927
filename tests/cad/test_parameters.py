# SPDX-License-Identifier: Apache-2.0
"""Parameters check their bounds and name them."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from cad.parameters import ParameterSet, parameter, parse_overrides
from taccel_lab.errors import InputError


@dataclass(frozen=True)
class Box(ParameterSet):
    width_mm: float = parameter(
        2.0, minimum=1, maximum=3, unit="mm", description="width", source="drawing 7"
    )
    count: int = parameter(4, minimum=1, maximum=9, description="holes", source="drawing 7")
    radius_mm: float = parameter(
        0.0, minimum=5, maximum=9, unit="mm", description="r", source="none", zero_means="flat"
    )
    style: str = parameter("round", choices=("round", "square"), description="s", source="none")


def test_text_becomes_the_parameters_own_type() -> None:
    box = Box().with_values({"width_mm": "2.5", "count": "3", "radius_mm": "0", "style": "square"})
    assert box.values() == {"width_mm": 2.5, "count": 3, "radius_mm": 0.0, "style": "square"}
    assert isinstance(box.count, int)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ({"width_mm": 0.5}, ["width_mm = 0.5", "below", "1 to 3 mm"]),
        ({"width_mm": "7"}, ["width_mm = 7", "above", "1 to 3 mm"]),
        ({"width_mm": "nan"}, ["width_mm", "not a number"]),
        ({"width_mm": "wide"}, ["width_mm", "'wide'", "1 to 3 mm"]),
        ({"width_mm": True}, ["width_mm", "not a number"]),
        ({"count": 2.5}, ["count", "whole number"]),
        ({"radius_mm": 2}, ["radius_mm = 2", "0 (flat) or 5 to 9 mm"]),
        ({"style": "oval"}, ["style", "round, square"]),
        ({"depth": 1}, ["no parameter 'depth'", "width_mm, count, radius_mm, style"]),
    ],
)
def test_bad_values_name_the_bound(overrides: dict[str, object], words: list[str]) -> None:
    with pytest.raises(InputError) as error:
        Box().with_values(overrides)
    for word in words:
        assert word in str(error.value)


def test_description_tells_default_from_override() -> None:
    described = Box(width_mm=3).describe()
    assert described["width_mm"]["source"] == "set by the user"
    assert described["count"]["source"] == "drawing 7"
    assert described["width_mm"]["maximum"] == 3


@pytest.mark.parametrize("items", [["a"], ["=1"], ["a="], ["a=1", "a=2"]])
def test_overrides_of_another_form_are_refused(items: list[str]) -> None:
    with pytest.raises(InputError):
        parse_overrides(items)


def test_overrides_keep_everything_after_the_first_equals_sign() -> None:
    assert parse_overrides(["a = 1", "b=x=y"]) == {"a": "1", "b": "x=y"}
