# SPDX-License-Identifier: Apache-2.0
"""Values are printed to the digits that their errors leave."""

from __future__ import annotations

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.with_error import to_error, with_error


@pytest.mark.parametrize(
    ("value", "error", "shown"),
    [
        (2.9151, 0.0932, "2.915 +- 0.093"),
        (2.9151, 0.0996, "2.92 +- 0.10"),
        (0.00012, 0.031, "0.000 +- 0.031"),
        (-0.00012, 0.031, "0.000 +- 0.031"),
        (-0.0, 0.5, "0.00 +- 0.50"),
        (1234.5, 123.0, "1230 +- 120"),
        (1234.5, 12.3, "1234 +- 12"),
        (-3.1234, 1.0, "-3.1 +- 1.0"),
        (2.9151, math.nan, "2.915"),
        (2.9151, None, "2.915"),
        (2.9151, 0.0, "2.915"),
        (-0.0, None, "0"),
    ],
)
def test_error_sets_the_digits(value: float, error: float | None, shown: str) -> None:
    assert with_error(value, error) == shown
    assert to_error(value, error) == shown.partition(" +- ")[0]


@given(st.floats(-1e6, 1e6), st.floats(1e-9, 1e6))
def test_what_is_shown_is_within_a_twentieth_of_the_error(value: float, error: float) -> None:
    said, _, stated = with_error(value, error).partition(" +- ")
    assert abs(float(said) - value) <= 0.051 * error + 1e-15 * abs(value)
    assert float(stated) == pytest.approx(error, rel=0.051)
    assert len(said.partition(".")[2]) == len(stated.partition(".")[2])
    assert not re.fullmatch(r"-0(\.0*)?", said)
