# SPDX-License-Identifier: Apache-2.0
"""What practice presses take over from captures."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.calibration.color.fit_options import ColorFitOptions
from taccel_lab.calibration.color.frames import ColorFrame
from taccel_lab.calibration.color.network_fit import fit_color_model
from taccel_lab.calibration.normals.practice import ImageNoise
from taccel_lab.calibration.normals.samples import InverseFrame, Scene
from tests.support.synthetic_presses import synthetic_captures


def test_noise_is_that_of_the_captures_where_contacts_fill_the_picture() -> None:
    """No pixel lies beyond 2.5 radii of any of these; a level of noise was made up for them."""
    captures, surfaces = synthetic_captures(6, noise=3.0, radii_px=(44.0, 48.0), ball_mm=6.0)
    frames = [
        InverseFrame(p.name, p.image().astype(np.float32), p.circle, p.sha256, surface)
        for p, surface in zip(captures.presses, surfaces, strict=True)
        if p.circle is not None and not p.circle.untouched(captures.grid).any()
    ]
    assert len(frames) > 1
    scene = Scene(captures.background.astype(np.float32), captures.grid, 6.0, None, None)
    shown = [
        ColorFrame(f.name, f.image, f.circle, f.surface, f.sha256) for f in frames if f.surface
    ]
    options = ColorFitOptions(steps=5)
    colors = fit_color_model(shown, scene.background, scene.grid, options).model
    noise = ImageNoise.of(frames, scene, colors)
    assert noise.white_levels == pytest.approx(3.0, rel=0.15)
