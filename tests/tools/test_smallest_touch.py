# SPDX-License-Identifier: Apache-2.0
"""The smallest touch of a sensor, beside its untouched frames."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.support.pressed_mini import PressedMini, ball
from tools.bench import smallest_touch
from tools.bench.smallest_touch import NOISE_PX, touch_figures, untouched_frames


@pytest.fixture(scope="module")
def mini() -> PressedMini:
    return PressedMini()


def presses(mini: PressedMini) -> list[np.ndarray]:
    """A press in two lights."""
    levels = mini.levels(mini.pressed(ball(4.0, 0.4, -3.0))[0])
    return [mini.noisy(gain * levels, seed=seed) for gain, seed in ((1.0, 1), (1.03, 2))]


@pytest.mark.thorough
def test_untouched_frames_have_light_and_noise_of_presses(mini: PressedMini) -> None:
    background = mini.seen(mini.still)
    frames = untouched_frames(background, presses(mini), mini.reader)
    assert len(frames) == 2
    for frame, gain in zip(frames, (1.0, 1.03), strict=True):
        off = frame.levels - gain * background
        smooth = cv2.GaussianBlur(off, (0, 0), NOISE_PX)
        # Nothing of the press is left; its own noise and the background's is.
        assert np.abs(smooth).max() < 3.0
        assert (off - smooth).std() == pytest.approx(np.hypot(0.58, 0.58), rel=0.15)


@pytest.mark.thorough
def test_the_smallest_touch_stands_beside_the_zero(
    mini: PressedMini, monkeypatch: pytest.MonkeyPatch
) -> None:
    depths = np.geomspace(0.02, 0.16, 7)
    monkeypatch.setattr(smallest_touch, "DEPTHS_MM", depths)
    background = mini.seen(mini.still)
    found = touch_figures(mini.sensor, background, presses(mini), count=2)
    low, high = found["smallest_mm"]["interval"]
    assert depths[0] < low <= found["smallest_mm"]["value"] < 0.08
    # So few touches leave the upper end open.
    assert high == depths[-1]
    assert found["untouched"]["frames"] == 2 and found["untouched"]["share"]["value"] == 0.0
    assert found["untouched"]["most_n"] < 0.2
