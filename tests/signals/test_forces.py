# SPDX-License-Identifier: Apache-2.0
"""Resultant wrench of nodal forces."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from taccel_lab.errors import InputError
from taccel_lab.signals import resultant_wrench

VECTORS = arrays(np.float64, (2, 5, 3), elements=st.floats(-10, 10))


def test_a_lever():
    positions = np.array([[[2.0, 0.0, 0.0], [0.0, 3.0, 0.0]]])
    forces = np.array([[[0.0, 0.0, -1.0], [0.5, 0.0, 0.0]]])
    assert resultant_wrench(positions, forces) == pytest.approx(
        np.array([[0.5, 0, -1, 0, 2, -1.5]])
    )


@given(VECTORS, VECTORS, arrays(np.float64, 3, elements=st.floats(-5, 5)))
def test_moving_the_origin_adds_the_moment_of_the_resultant(positions, forces, shift):
    here = resultant_wrench(positions, forces)
    there = resultant_wrench(positions + shift, forces)
    assert np.allclose(there[:, :3], here[:, :3])
    assert np.allclose(there[:, 3:], here[:, 3:] + np.cross(shift, here[:, :3]), atol=1e-9)


def test_bad_input_is_refused():
    good = np.zeros((2, 4, 3))
    with pytest.raises(InputError, match="forces has shape"):
        resultant_wrench(good, np.zeros((2, 5, 3)))
    with pytest.raises(InputError, match=r"\[env, node, 3\]"):
        resultant_wrench(good[0], good[0])
    bad = good.copy()
    bad[1, 2, 0] = np.inf
    with pytest.raises(InputError, match=r"\[1\]"):
        resultant_wrench(good, bad)
