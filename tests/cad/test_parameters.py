# SPDX-License-Identifier: Apache-2.0
"""Parameters check their bounds and name them; sizes in another unit are refused and named."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.cad.gel_import.gel_checks import check_units
from taccel_lab.cad.parameters import ParameterSet, parameter, parse_overrides, restated, value_text
from taccel_lab.errors import InputError
from tests.support.sensor_refusals import refuses


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


@dataclass(frozen=True)
class WideBox(Box):
    parameter_group = "boxes"
    width_mm: float = restated(5.0, maximum=8, source="drawing 9")
    depth_mm: float = parameter(
        1.0, minimum=0.5, maximum=2, unit="mm", description="depth", source="drawing 9"
    )


@dataclass(frozen=True)
class Cupboard(ParameterSet):
    """A box in a frame."""

    groups = (Box,)
    parameter_group = "frame"
    count: int = restated(6, maximum=20, source="drawing 11")
    frame_mm: float = parameter(
        9.0, minimum=1, maximum=20, unit="mm", description="frame", source="drawing 11"
    )


@dataclass(frozen=True)
class Shelf(ParameterSet):
    depth_mm: float | tuple[float, ...] = parameter(
        (2.0, 3.0), minimum=1, maximum=4, unit="mm", description="d", source="none", each="board",
    )  # fmt: skip
    color: str | tuple[str, ...] = parameter(
        "red", choices=("red", "blue"), pattern=("#[0-9a-f]{6}", "#rrggbb"), description="c",
        source="none", each="board",
    )  # fmt: skip


def test_a_value_for_each_is_written_with_commas() -> None:
    shelf = Shelf.of(parse_overrides(["depth_mm=1.5, 2,4", "color=red,#00ff00"]))
    assert (shelf.depth_mm, shelf.color) == ((1.5, 2.0, 4.0), ("red", "#00ff00"))
    assert shelf.values() == {"depth_mm": [1.5, 2.0, 4.0], "color": ["red", "#00ff00"]}
    assert Shelf.of(shelf.values()) == shelf
    text = [f"{name}={value_text(value)}" for name, value in shelf.values().items()]
    assert Shelf.of(parse_overrides(text)) == shelf
    assert Shelf.of({"depth_mm": [2.5]}).depth_mm == 2.5
    assert Shelf().describe()["depth_mm"]["source"] == "none"
    depth, color = Shelf.parameters()["depth_mm"], Shelf.parameters()["color"]
    assert depth.allowed() == "1 to 4 mm; one for each board with commas"
    assert color.allowed() == "one of red, blue, or #rrggbb; one for each board with commas"
    assert depth.worded((1.5, 2.0)) == "depth 1.5,2 mm"


def test_words_become_the_parameters_own_type() -> None:
    box = Box.of(parse_overrides(["width_mm=2.5", "count=3", "radius_mm=0", "style=square"]))
    assert box.values() == {"width_mm": 2.5, "count": 3, "radius_mm": 0.0, "style": "square"}
    assert isinstance(box.count, int)
    # Everything after the first equals sign is kept.
    assert parse_overrides(["a = 1", "b=x=y", "c=1_0"]) == {"a": 1, "b": "x=y", "c": "1_0"}


test_bad_values_name_the_bound = refuses(
    lambda kind, overrides: kind.of(overrides),
    (Box, {"width_mm": 0.5}, "width_mm = 0.5 is below .* 1 to 3 mm"),
    (Box, {"width_mm": 7}, "width_mm = 7 is above .* 1 to 3 mm"),
    (Box, {"width_mm": "2.5"}, "width_mm = '2.5' is not a number"),
    (Box, {"width_mm": math.nan}, "width_mm .*not a number"),
    (Box, {"width_mm": 10**400}, "width_mm = 1000.* not a number"),
    (Box, {"width_mm": "wide"}, "width_mm .*'wide'.* 1 to 3 mm"),
    (Box, {"width_mm": True}, "width_mm .*not a number"),
    (Box, {"count": 2.5}, "count .*whole number"),
    (Box, {"radius_mm": 2}, r"radius_mm = 2 .*0 \(flat\) or 5 to 9 mm"),
    (Box, {"style": "oval"}, "style .*round, square"),
    (Box, {"depth": 1}, "no parameter 'depth'.*width_mm, count, radius_mm, style"),
    (WideBox, {"width_mm": 9}, "width_mm = 9 is above its bound; allowed: 1 to 8 mm"),
    (Cupboard, {"width_mm": 9}, "width_mm = 9 is above its bound"),
    (Cupboard, {"count": 21}, "count = 21"),
    (Shelf, {"depth_mm": []}, "depth_mm"),
    (Shelf, {"depth_mm": [2.0, 5.0]}, "depth_mm"),
    (Shelf, {"depth_mm": [2.0, [3.0]]}, "depth_mm"),
    (Shelf, {"depth_mm": [2.0, True]}, "depth_mm"),
)


test_overrides_of_another_form_are_refused = refuses(
    parse_overrides, (["a"], "a"), (["=1"], "=1"), (["a="], "a="), (["a=1", "a=2"], "a")
)


def test_description_tells_default_from_override_and_group() -> None:
    described = WideBox(width_mm=3).describe()
    assert described["width_mm"]["source"] == "set by the user"
    assert described["count"]["source"] == "drawing 7"
    assert described["width_mm"]["maximum"] == 8
    # Groups are those of the declaring class.
    groups = {name: item["group"] for name, item in described.items()}
    assert groups == {**dict.fromkeys(Box.parameters(), ""), "depth_mm": "boxes"}
    # A set has the parameters of its groups and hands them out.
    assert set(Cupboard.parameters()) == {*Box.parameters(), "frame_mm"}
    found = Cupboard.of({"count": 15, "width_mm": 1.5})
    assert found.group(Box).values() == {**Box().values(), "count": 15, "width_mm": 1.5}


def test_a_restated_parameter_keeps_what_it_does_not_state() -> None:
    spec = WideBox.parameters()["width_mm"]
    assert (spec.default, spec.source, spec.minimum, spec.maximum) == (5.0, "drawing 9", 1, 8)
    assert (spec.unit, spec.description) == ("mm", "width")
    assert WideBox().width_mm == 5.0 and WideBox().count == 4
    assert Box.parameters()["width_mm"].default == 2.0
    with pytest.raises(TypeError, match="height_mm is restated, but no base class has"):

        @dataclass(frozen=True)
        class Tall(Box):
            height_mm: float = restated(3.0, source="none")

    # A part hands its parameter on.
    @dataclass(frozen=True)
    class Rack(ParameterSet):
        parameter_group = "rack"
        width_mm: float = restated(2.5, of=Box, maximum=2.8, source="joiner")

    found, declared = Rack.parameters()["width_mm"], Box.parameters()["width_mm"]
    assert (found.default, found.maximum, found.source) == (2.5, 2.8, "joiner")
    assert (found.minimum, found.unit, found.group) == (declared.minimum, declared.unit, "rack")
    assert found.description == declared.description
    for name, wrong, words in (
        ("width_mm", restated(2.5, of=Box), "needs a source"),
        ("width_mm", restated(of=Box, maximum=1e9), "wider than those of Box"),
        ("board_mm", restated(of=Box), "Box has that parameter"),
    ):
        with pytest.raises(TypeError, match=words):
            type("Wrong", (ParameterSet,), {name: wrong})


def test_a_value_that_others_leave_no_room_for_is_refused_with_the_bound() -> None:
    box = Box(width_mm=2.0)
    box.require("width_mm", "is too wide", low=2.0, high=2.0)
    with pytest.raises(InputError, match=r"^width_mm = 2 is too wide; allowed: up to 1.5 mm$"):
        box.require("width_mm", "is too wide", high=1.5)
    with pytest.raises(InputError, match=r"allowed: at least 3 mm, or another box$"):
        box.require("width_mm", "is too narrow", low=3.0, also=", or another box")


MINI = np.array([[-12.6, -10.4, -4.2], [12.6, 10.4, 0.0]])
UNITS = {"m": (1e3, "metres"), "in": (25.4, "inches"), "cm": (10, "cent"), "um": (1e-3, "micro")}
"""Millimetres of a metre, an inch, ..."""


@given(st.floats(4, 120), st.floats(0.05, 1), st.floats(0.05, 1), st.floats(1e-4, 0.499))
def test_millimetres_pass_or_are_asked_about(size: float, b: float, c: float, small: float) -> None:
    extents = np.maximum(size * np.array([1, b, c]), 0.06)
    assert check_units(np.stack([np.zeros(3), extents])) == 1.0
    with pytest.raises(InputError, match="--unit"):
        check_units(np.array([3 * [0], 3 * [small]]))


@pytest.mark.parametrize("unit", UNITS)
def test_other_units_are_named_and_accepted_when_said(unit: str) -> None:
    scale, word = UNITS[unit]
    numbers = MINI / scale
    with pytest.raises(InputError, match=rf"look like .*{word}.* .*25\.2 mm: --unit {unit}\)"):
        check_units(numbers)
    assert check_units(numbers, unit) == pytest.approx(scale, rel=1e-15)


test_sizes_that_no_gel_has_are_refused = refuses(
    check_units,
    (MINI * 25.4, None, "read as inches, 25.4 times too large"),
    (MINI * [1, 1, 0.001], None, "sheet without volume"),
    (MINI, "furlong", "known: mm, cm"),
    (MINI * np.nan, None, "bounding box"),
    (MINI, "m", "0.5 to 1000 mm large; name its real unit with --unit"),
)
