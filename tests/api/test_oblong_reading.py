# SPDX-License-Identifier: Apache-2.0
"""A photo of pixels that are twice as wide as high, of a ball beside the middle: places, areas and
volumes are in millimetres."""

from __future__ import annotations

import numpy as np
import pytest

import taccel_lab as tl
from taccel_lab.presses.bonded_layer import layer_force_n
from taccel_lab.reading.touch import touch_of
from tests.support.oblong_grey import (
    AT_MM,
    BALL_MM,
    DEPTH_MM,
    GRID,
    NU,
    PA,
    THICK_MM,
    ball_depth_mm,
    ball_image,
    grey_profile,
)


def test_a_ball_is_read_where_it_is_and_as_large_as_it_is() -> None:
    profile = grey_profile()
    found = tl.read(profile, ball_image(profile))
    figures, truth = found.figures(), ball_depth_mm()
    assert figures["deepest_mm"] == pytest.approx(AT_MM, abs=0.11)
    assert figures["center_mm"] == pytest.approx(AT_MM, abs=0.03)
    assert figures["depth_mm"] == pytest.approx(DEPTH_MM, rel=0.01)
    touched = truth > figures["dent_deeper_than_mm"]
    assert figures["dent_mm2"] == pytest.approx(touched.sum() * 0.1**2, rel=0.03)
    assert figures["dent_mm3"] == pytest.approx(truth[touched].sum() * 0.1**2, rel=0.03)
    force = layer_force_n("sphere", np.array(DEPTH_MM), BALL_MM, THICK_MM, NU, PA)
    assert found.force_n == pytest.approx(float(force), rel=0.03)


@pytest.mark.parametrize(("pixels", "touched"), [(2, False), (3, True)])
def test_a_spot_of_a_twentieth_of_a_square_millimetre_is_the_smallest(pixels, touched) -> None:
    """Of pixels of 0.2 x 0.1 mm."""
    rise = np.zeros((GRID.height_px, GRID.width_px))
    rise[40 : 40 + pixels, 20] = -1e-4
    assert touch_of(rise, None, GRID).any == touched
