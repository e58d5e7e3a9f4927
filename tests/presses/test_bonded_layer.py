# SPDX-License-Identifier: Apache-2.0
"""Closed forms of bonded layers against their limits, one another and published numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from taccel_lab.errors import InputError
from taccel_lab.presses.bonded_layer import layer_force_n, layer_young_modulus_pa
from tests.calibration.material.layer_series import sphere_force_series_n

DEPTH = np.array([0.1])


def test_a_thick_layer_is_a_half_space():
    depth, plane = np.array([0.002, 0.01]), 1e5 / (1 - 0.4**2) * 1e-6
    hertz = 4 / 3 * plane * math.sqrt(2.0) * depth**1.5
    series = sphere_force_series_n(depth, 2.0, 2000.0, 0.4, 1e5)
    np.testing.assert_allclose(series, hertz, rtol=1e-3)
    found = layer_force_n("sphere", depth, 2.0, 2000.0, 0.4, 1e5)
    np.testing.assert_allclose(found, hertz, rtol=2e-3)
    punch = layer_force_n("cylinder", depth, 1.0, 2000.0, 0.4, 1e5)
    np.testing.assert_allclose(punch, 2 * plane * depth, rtol=1e-3)


@pytest.mark.parametrize(
    ("ratio", "factor"), [(0.2, 1.281), (0.4, 1.683), (0.6, 2.211), (0.8, 2.855), (1.0, 3.609)]
)
def test_flat_punches_on_incompressible_layers(ratio, factor):
    """Hayes, Keer, Herrmann and Mockros (1972), table 1, nu = 0.5."""
    punch = layer_force_n("cylinder", DEPTH, ratio, 1.0, 0.5)
    assert punch[0] / (2 * ratio * 0.1 / 0.75 * 1e-6) == pytest.approx(factor, rel=4e-3)


def test_a_wide_punch_squeezes_a_confined_layer():
    wide, plate = (layer_force_n(kind, DEPTH, 100.0, 1.0, 0.3) for kind in ("cylinder", "flat"))
    assert wide[0] / plate[0] == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("poisson", [0.3, 0.45, 0.5])
def test_series_and_integral_equation_agree_on_moderate_layers(poisson):
    depth = np.array([0.02, 0.05, 0.1])  # chi 0.04 to 0.22
    series = sphere_force_series_n(depth, 7.5, 4.0, poisson)
    exact = layer_force_n("sphere", depth, 7.5, 4.0, poisson)
    np.testing.assert_allclose(series, exact, rtol=0.02)


@settings(max_examples=15, deadline=None)
@given(
    st.floats(2e4, 2e6), st.floats(1.0, 10.0), st.floats(1.0, 6.0), st.floats(0.3, 0.499),
    st.sampled_from(["sphere", "cylinder"]),
)  # fmt: skip
def test_the_inverse_finds_the_modulus(modulus, radius, thickness, poisson, kind):
    depth = np.linspace(0.01, 0.1, 4) * min(thickness, radius)
    force = layer_force_n(kind, depth, radius, thickness, poisson, modulus)
    found = layer_young_modulus_pa(kind, depth, force, radius, thickness, poisson)
    assert found == pytest.approx(modulus, rel=1e-9)


@pytest.mark.parametrize(
    ("depth", "radius", "thickness", "poisson", "words"),
    [
        (0.1, 1.0, 1.0, 0.6, "Poisson"),
        (0.1, 1.0, 0.0, 0.4, "thickness"),
        (-0.1, 1.0, 1.0, 0.4, "not negative"),
        (2.0, 1.0, 4.0, 0.4, "equator"),
    ],
)
def test_what_is_no_layer_is_refused(depth, radius, thickness, poisson, words):
    with pytest.raises(InputError, match=words):
        layer_force_n("sphere", np.array([depth]), radius, thickness, poisson)


def test_a_series_before_first_touch_has_no_modulus():
    with pytest.raises(InputError, match="first touch"):
        layer_young_modulus_pa("sphere", np.zeros(2), np.ones(2), 1.0, 1.0, 0.4)
