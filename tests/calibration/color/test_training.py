# SPDX-License-Identifier: Apache-2.0
"""The colour network is fitted by Huber's loss of the stated width."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.calibration.color.fit_options import ColorFitOptions
from taccel_lab.calibration.color.frames import Samples
from taccel_lab.calibration.color.training import train
from taccel_lab.geometry import PixelGrid

SHARE, LEVELS, FAR = 0.3, 10.0, 100.0
"""Of the pixels, a share is off by so much: a hair, a glint."""


def pixels(count: int = 4000) -> Samples:
    rng = np.random.default_rng(3)
    slope = rng.uniform(0.2, 0.5, (count, 2)) * rng.choice([-1, 1], (count, 2))
    normals = np.concatenate([-slope, np.ones((count, 1))], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    change = np.full((count, 3), LEVELS)
    change[rng.uniform(size=count) < SHARE] += FAR
    return Samples(
        uv=rng.uniform(-1, 1, (count, 2)),
        normals=normals,
        rest_normals=np.tile([0.0, 0.0, 1.0], (count, 1)),
        displacement_mm=rng.uniform(-0.4, -0.1, count),
        change=change,
    )


@pytest.mark.parametrize("width", [5.0, 40.0])
def test_the_width_says_how_far_pixels_that_are_far_off_draw(width: float) -> None:
    """The answer a draws by (1 - share) (a - levels) against share * width: in closed form."""
    options = ColorFitOptions(
        steps=400, batch_pixels=1024, hidden=(8,), learning_rate=0.02, huber_levels=width
    )
    samples = pixels()
    trained = train(samples, PixelGrid(40, 30, 0.1, 0.1), options)
    index = np.arange(len(samples.uv)) % (40 * 30)
    found = trained.model.predict_pixels(
        index, samples.normals, samples.displacement_mm, samples.rest_normals
    )
    share = np.mean(samples.change[:, 0] > LEVELS)
    drawn = share / (1 - share) * width
    assert np.median(found) - LEVELS == pytest.approx(drawn, rel=0.25)
    # Slope 1 beyond the width: a mean absolute error [levels].
    near, far = drawn**2 / 2, width * (FAR - drawn - width / 2)
    loss = np.mean([loss for step, loss in trained.curve if step > 300])
    assert loss == pytest.approx(((1 - share) * near + share * far) / width, rel=0.1)
