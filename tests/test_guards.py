# SPDX-License-Identifier: Apache-2.0
"""Guards refuse what they say, and name what is allowed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.guards import (
    nearest,
    require_known,
    require_positive,
    require_range,
    require_shape,
    unknown,
)

PARAMETERS = [f"length_{k}_mm" for k in range(20)]


@pytest.mark.parametrize(
    ("value", "low", "high", "says"),
    [
        (2.0, 0, 1, r"^depth must lie in \[0, 1\] mm, got 2$"),
        (math.nan, 0, 1, "got nan"),
        (math.inf, 0, math.inf, "must be finite, got inf"),
        (-1, 0, math.inf, "must be at least 0 mm, got -1"),
        (-math.inf, -math.inf, math.inf, "must be finite, got -inf"),
        ((0.5, -1.0), 0, 1, "got -1"),
    ],
)
def test_a_number_out_of_bounds_is_refused_with_them(value, low, high, says):
    with pytest.raises(InputError, match=says):
        require_range("depth", value, low, high, "mm")


def test_bounds_themselves_are_allowed():
    require_range("depth", (0.0, 1.0), 0, 1)
    require_range("depth", 1e300, 0, math.inf)


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_only_positive_numbers_pass(value):
    require_positive("mass", 1e-12)
    with pytest.raises(InputError, match=r"mass must be positive and finite, got .* kg$"):
        require_positive("mass", value, "kg")


@pytest.mark.parametrize(
    ("name", "known", "says"),
    [
        (
            "rgbb",
            ("rgb", "depth"),
            r"^no channel 'rgbb' \(did you mean rgb\?\); known: rgb, depth$",
        ),
        ("x", ("rgb", "depth"), "^no channel 'x'; known: rgb, depth$"),
        ("x", (), "^no channel 'x'; there are none$"),
        ("lenght_3_mm", PARAMETERS, r"^no channel 'lenght_3_mm' \(did you mean length_3_mm\?\)$"),
        ("x", PARAMETERS, "known: length_0_mm, "),
    ],
)
def test_an_unknown_name_is_answered_by_the_nearest(name, known, says):
    with pytest.raises(InputError, match=says):
        require_known("channel", name, known)


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("mini", "gelsight_mini"),
        ("GelSight Mini", "gelsight_mini"),
        ("gelsight-mini", "gelsight_mini"),
        ("digit360", "digit_360"),
        ("didgit", "digit"),
        ("zz", None),
        ("it", None),
    ],
)
def test_parts_and_other_spellings_of_a_name_are_understood(name, meant):
    sensors = ("9dtact", "digit", "digit_360", "gelsight", "gelsight_mini", "rtac")
    assert nearest(name, sensors) == (f" (did you mean {meant}?)" if meant else "")


def test_a_command_stands_in_place_of_the_list():
    assert unknown("x", PARAMETERS, "show") == "; show lists all 20"
    assert unknown("lengt_3_mm", PARAMETERS, "show").endswith("length_3_mm?); show lists all 20")
    assert unknown("rgbb", ("rgb",), "show") == " (did you mean rgb?); show lists all 1"
    assert unknown("x", ("rgb",), "show", they_are="allowed") == "; allowed: rgb"


def test_a_shape_is_one_of_those_allowed_and_finite():
    require_shape("pose", np.zeros(7), (7,), ("env", 7))
    require_shape("pose", np.zeros((4, 7)), (7,), ("env", 7))
    with pytest.raises(InputError, match=r"must have shape \[7\] or \[env, 7\], got \[6\]"):
        require_shape("pose", np.zeros(6), (7,), ("env", 7))
    with pytest.raises(InputError, match="pose holds NaN or infinite values"):
        require_shape("pose", np.full(7, np.nan), (7,))
    require_shape("image", np.full(7, np.nan), (7,), finite=False)
