# SPDX-License-Identifier: Apache-2.0
"""Arrows add up to the force, colour bars say their unit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.viewer.arrows import Forces, arrow_lines, patch_forces, round_length
from taccel_lab.viewer.painting import bar_html, map_rgb, painted, shares
from taccel_lab.viewer.section import Surface


@given(seed=st.integers(0, 2**32 - 1), patches=st.integers(1, 40))
def test_forces_of_patches_add_up_to_those_of_the_nodes(seed: int, patches: int) -> None:
    rng = np.random.default_rng(seed)
    at, forces = rng.uniform(-10, 10, (60, 3)), rng.normal(size=(60, 3))
    forces[rng.random(60) < 0.5] = 0.0
    found = patch_forces(at, forces, patches)
    np.testing.assert_allclose(found.forces_n.sum(axis=0), forces.sum(axis=0), atol=1e-12)
    assert len(found.at_mm) <= patches**2 + 2 * patches + 1
    if patches == 1 and len(found.at_mm) == 1:
        weights = np.linalg.norm(forces, axis=1)
        np.testing.assert_allclose(found.at_mm[0], weights @ at / weights.sum(), atol=1e-9)


def test_arrows_end_where_a_tool_pushes() -> None:
    forces = Forces(np.array([[1.0, 2.0, 3.0], [0.0, 0.0, 0.0]]), np.array([[0, 0, -2.0], [0] * 3]))
    np.testing.assert_allclose(
        arrow_lines(forces, 5.0, onto=True), [[[1, 2, 13], [1, 2, 3]]]
    )  # the force of zero has none
    np.testing.assert_allclose(arrow_lines(forces, 5.0, onto=False)[0, 1], [1, 2, -7])
    assert forces.largest_n() == 2.0


@given(st.floats(1e-9, 1e9))
def test_round_lengths_are_round_and_not_longer(value: float) -> None:
    found = round_length(value)
    assert value / 2.5 < found * (1 + 1e-6) and found <= value * (1 + 1e-6)
    lead = found / 10.0 ** np.floor(np.log10(found) + 1e-9)
    assert np.isclose(lead, [1, 2, 5]).any()


def test_values_meet_the_ends_of_the_colour_map() -> None:
    np.testing.assert_allclose(
        shares(np.array([-1.0, 0, 1, 2, 9, np.nan]), (0, 2)), [0, 0, 0.5, 1, 1, 0]
    )
    surface = Surface(np.eye(3), np.array([[0, 1, 2]]), np.array([0.0, 1.0, 2.0]))
    mesh = painted(surface, (0, 2), map_rgb("viridis"))
    np.testing.assert_allclose(mesh.visual.uv[:, 0], [0.5 / 256, 0.5, 255.5 / 256])


def test_the_bar_names_field_and_unit_and_takes_no_markup() -> None:
    text = bar_html("<b>pressure", "kPa", (0.0, 200.0), map_rgb("magma"))
    assert "&lt;b&gt;pressure" in text and "[kPa]" in text
    assert ">0<" in text and ">100<" in text and ">200<" in text


def test_an_unknown_colour_map_is_an_error() -> None:
    with pytest.raises(KeyError):
        map_rgb("no such map")
