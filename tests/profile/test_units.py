# SPDX-License-Identifier: Apache-2.0
"""Conversions are exact where they can be and invert one another."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.profile import units


@pytest.mark.parametrize("millimetres", [2.0, 0.1, 4.23, 17.0, 0.0295])
def test_millimetres_become_the_nearest_double(millimetres: float) -> None:
    assert units.m_from_mm(millimetres) == float(f"{millimetres}e-3")


@given(st.floats(-1e6, 1e6))
def test_conversions_invert(value: float) -> None:
    assert units.m_from_mm(value) * 1000.0 == pytest.approx(value, rel=1e-15, abs=1e-300)
    assert units.deg_from_rad(units.rad_from_deg(value)) == pytest.approx(
        value, rel=1e-15, abs=1e-300
    )


def test_known_angles_and_arrays() -> None:
    assert units.rad_from_deg(180.0) == math.pi
    np.testing.assert_allclose(units.deg_from_rad(np.array([math.pi / 2])), [90.0])
    np.testing.assert_array_equal(units.m_from_mm(np.array([1.0, 2.0])), [0.001, 0.002])
