# SPDX-License-Identifier: Apache-2.0
"""How far tools slide over the gel."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.geometry.contact_sweep import AT_REST, ContactSweep
from taccel_lab.presses import PressPath, parse_indenter
from taccel_lab.presses.sweep import press_sweep


def slip(friction: float, shear_mm: float, depth_mm: float = 0.3, radius_mm: float = 1.1) -> float:
    path = PressPath(depth_mm, (shear_mm, 0.0))
    return press_sweep(path, radius_mm, friction, 4.0, 0.46).slip


def test_a_ball_slides_what_friction_does_not_hold():
    assert slip(0.0, 1.0) == 1.0
    assert slip(0.5, 0.05) == 0.0 < slip(0.5, 0.6) < slip(0.5, 2.0) < slip(0.1, 2.0) < 1.0
    # The gel is dragged along by as much, however far the ball goes.
    assert (1 - slip(0.5, 1.0)) == pytest.approx(2 * (1 - slip(0.5, 2.0)))
    assert press_sweep(PressPath(0.3), 1.1, 0.5, 4.0, 0.46) == AT_REST


def test_rims_stay_on_their_rows_while_they_rub():
    punch, path = parse_indenter("cylinder:2").contact(0.3), PressPath(0.3, (1.0, 0.0), 5.0)
    assert press_sweep(path, punch, 0.5, 4.0, 0.46).slip == 0.0
    assert press_sweep(path, punch, 0.0, 4.0, 0.46).slip == 1.0


def test_points_of_a_tool_turn_about_its_origin_and_go_along():
    moved = ContactSweep((1.0, 2.0), 90.0).moved(np.array([[1.0, 0.0], [0.0, 0.0]]))
    assert moved == pytest.approx(np.array([[1.0, 3.0], [1.0, 2.0]]))
    half = ContactSweep((1.0, 0.0), 180.0, slip=0.5)
    assert half.moved(np.array([[1.0, 0.0]])) == pytest.approx(np.array([[0.5, 1.0]]))
    assert half.length_mm == 0.5 and AT_REST.length_mm == 0.0
