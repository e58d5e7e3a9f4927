# SPDX-License-Identifier: Apache-2.0
"""The light of a frame by the pixels beside its contact, which no score of the contact reaches."""

from __future__ import annotations

import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.frame_light import PRIOR_SIGMA, enough_pixels, fit_press_light
from taccel_lab.calibration.light_drift import LightDrift
from taccel_lab.calibration.response.evaluate import crop_slices
from taccel_lab.calibration.response.frame import CaptureScene, PressFrame

NEAREST_RADII = 2.0
"""No pixel nearer than this many contact radii tells the light."""


def light_beside(
    image: np.ndarray,
    scene: CaptureScene,
    circle: ContactCircle,
    background: np.ndarray | None = None,
) -> LightDrift:
    """Gain, offset and gradient of ``image`` beside its contact, against the scene's background or
    a render in its light, ``background``.

    Images are RGB levels, shape [height_px, width_px, 3]; masked pixels are left out. A contact
    that fills its frame leaves nothing to tell the light by, which then counts as unchanged.
    """
    beside = beside_pixels(circle, scene)
    if enough_pixels(beside):
        known = scene.background if background is None else background
        return fit_press_light(image, known, beside)
    unknown = np.tile(np.diag(PRIOR_SIGMA**2), (3, 1, 1))
    return LightDrift(np.ones(3), np.zeros(3), covariance=unknown)


def in_background_light(image: np.ndarray, scene: CaptureScene) -> np.ndarray:
    """A frame in the light of the background, as the model will bring new ones to it."""
    light = fit_press_light(image, scene.background, scene.mask)
    return light.remove(image).astype(np.float32)


def noise_floor_l1(frame: PressFrame, scene: CaptureScene) -> float:
    """Mean absolute difference of a frame from the background in its light beside the contact
    [levels]; NaN where the contact leaves nothing."""
    beside = beside_pixels(frame.circle, scene)
    if not beside.any():
        return float("nan")
    shown = light_beside(frame.image, scene, frame.circle).apply(scene.background)
    return float(np.abs(frame.image.astype(np.float64) - shown)[beside].mean())


def beside_pixels(circle: ContactCircle, scene: CaptureScene) -> np.ndarray:
    """Usable pixels beyond 2 contact radii and outside the crop that scores are taken in; bool,
    shape [height_px, width_px]."""
    beside = circle.distance_px(scene.grid) > NEAREST_RADII * circle.radius_px
    beside[crop_slices(circle, scene.grid)] = False
    return beside & scene.usable
