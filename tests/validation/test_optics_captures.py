# SPDX-License-Identifier: Apache-2.0
"""The optical model of catalogue sensors beside their captures.

The catalogue's lights were placed by such presses, so these are no predictions: they hold that the
model can look like the sensor, which a wrong side, a flipped axis, lost refraction or a wrong slope
of the shading would end.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from tests.optics.compare import compare_press
from tests.validation import optics_captures, optics_comparison
from tests.validation.optics_captures import RealSensor


@cache
def compared(read: Callable[[], RealSensor]) -> optics_comparison.Comparison:
    return optics_comparison.compare(read())


@pytest.mark.parametrize(
    ("read", "cosine", "contrast", "correlation"),
    [
        (optics_captures.classic_gelsight, 0.9, (0.7, 1.4), (0.9, 0.9, 0.85)),
        (optics_captures.gelsight_mini, 0.85, (0.6, 1.5), (0.85, 0.85, 0.85)),
        (optics_captures.ninedtact, 0.95, (0.3, 2.0), (0.9, 0.9, 0.9)),
    ],
)
def test_ball_presses_turn_the_colours_of_the_real_ones(
    read: Callable[[], RealSensor],
    cosine: float,
    contrast: tuple[float, float],
    correlation: tuple[float, float, float],
) -> None:
    found = compared(read)
    assert np.mean([press.mean_cosine for press in found.presses]) > cosine
    strength = np.mean([press.contrast for press in found.presses])
    assert contrast[0] < strength < contrast[1]
    means = np.mean([press.correlation for press in found.presses], axis=0)
    assert (means > correlation).all()


def test_the_score_would_notice_lights_on_the_wrong_side() -> None:
    found = compared(optics_captures.classic_gelsight)
    press = found.sensor.presses[0]
    assert found.model_press is not None
    assert found.real_press is not None
    scale = found.real_press.shape[1] / press.image.shape[1]
    center = (scale * press.center_px[0], scale * press.center_px[1])
    real = (found.real_background, found.real_press)
    model = (found.model_background, found.model_press)
    radius = scale * press.radius_px
    right = compare_press(real, model, center, radius).mean_cosine
    # Red and green in each other's place.
    swapped = compare_press(
        real, (model[0][..., [1, 0, 2]], model[1][..., [1, 0, 2]]), center, radius
    )
    assert swapped.mean_cosine < right - 0.5


@pytest.mark.parametrize("read", [optics_captures.classic_gelsight, optics_captures.gelsight_mini])
def test_backgrounds_beat_one_colour(read: Callable[[], RealSensor]) -> None:
    background = compared(read).background
    assert background.psnr_db > background.flat_psnr_db + 0.5
    assert min(background.correlation) > 0.3
