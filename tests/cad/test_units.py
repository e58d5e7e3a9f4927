# SPDX-License-Identifier: Apache-2.0
"""Sizes that look like metres, inches or centimetres are refused, and the answer names them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.cad.step_import.units import MM_PER_UNIT, check_units
from taccel_lab.errors import InputError

MINI = np.array([[-12.6, -10.4, -4.2], [12.6, 10.4, 0.0]])


@given(st.floats(4, 120), st.floats(0.05, 1), st.floats(0.05, 1))
def test_pads_in_millimetres_pass(size: float, b: float, c: float) -> None:
    extents = np.maximum(size * np.array([1, b, c]), 0.06)
    assert check_units(np.stack([np.zeros(3), extents])) == 1.0


@pytest.mark.parametrize(
    ("unit", "word"),
    [("m", "metres"), ("in", "inches"), ("cm", "centimetres"), ("um", "micrometres")],
)
def test_other_units_are_named_and_accepted_when_said(unit: str, word: str) -> None:
    numbers = MINI / MM_PER_UNIT[unit]
    with pytest.raises(InputError, match=rf"look like .*{word} .*25\.2 mm: --unit {unit}\)"):
        check_units(numbers)
    assert check_units(numbers, unit) == MM_PER_UNIT[unit]


@given(st.floats(1e-4, 0.499))
def test_everything_below_half_a_unit_is_refused_as_another_unit(size: float) -> None:
    with pytest.raises(InputError, match="--unit"):
        check_units(np.array([[0, 0, 0], [size, size, size]]))


def test_millimetres_read_as_inches() -> None:
    with pytest.raises(InputError, match=r"read as inches, 25\.4 times too large"):
        check_units(MINI * 25.4)


def test_sheets_unknown_units_and_broken_boxes() -> None:
    with pytest.raises(InputError, match="sheet without volume"):
        check_units(MINI * [1, 1, 0.001])
    with pytest.raises(InputError, match="use one of mm, cm"):
        check_units(MINI, "furlong")
    with pytest.raises(InputError, match="bounding box"):
        check_units(MINI * np.nan)
    with pytest.raises(InputError, match=r"0\.5 to 1000 mm large.*--unit"):
        check_units(MINI, "m")
