# SPDX-License-Identifier: Apache-2.0
"""One law of colour tells presses of another ball, and whether they harm the others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from taccel_lab.calibration.check.color_law import ColorLaw
from taccel_lab.calibration.check.frames import FrameFigures, measure_presses
from tests.support.capture_sets import BALL_MM, WIDTH, CaptureMaker, press
from tests.support.synthetic_presses import GRID

BALL_PX = BALL_MM / GRID.mm_per_px_x


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> list[FrameFigures]:
    return measured(CaptureMaker(), tmp_path_factory.mktemp("law"))


def measured(maker: CaptureMaker, folder: Path) -> list[FrameFigures]:
    """Presses with the circles that they were drawn with."""
    captures = maker.load(folder)
    background = captures.require_background().image()
    found = measure_presses(captures.presses, background, captures.mask, GRID)
    return [replace(frame, contact=None) for frame in found]


def law_of(frames: list[FrameFigures]) -> ColorLaw:
    circles = [frame.circle for frame in frames if frame.circle is not None]
    assert len(circles) == len(frames)
    return ColorLaw(frames, circles, [BALL_PX] * len(frames), WIDTH)


def test_presses_of_one_ball_look_like_it(frames: list[FrameFigures]) -> None:
    law = law_of(frames)
    balls = [law.apparent_ball(i) for i in range(len(frames))]
    assert max(abs(np.log(ball.factor)) for ball in balls) < np.log(1.25)
    with_one, without = law.influence([3])
    assert 1.0 <= with_one / without < 1.02


@pytest.mark.parametrize("factor", [0.9, 1.75])
def test_a_press_of_another_ball_looks_like_that_one(tmp_path: Path, factor: float) -> None:
    maker = CaptureMaker()
    maker.images[4] = press(maker.circles[4], factor * BALL_MM)
    law = law_of(measured(maker, tmp_path))
    found = law.apparent_ball(4)
    assert found.factor == pytest.approx(factor, rel=0.12)
    assert (found.gain > 3.0) == (factor > 1.3)
    with_it, without = law.influence([4])
    others = law.influence([5])
    assert with_it / without > others[0] / others[1] or factor < 1.3
