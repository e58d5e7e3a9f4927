# SPDX-License-Identifier: Apache-2.0
"""One press off the image's centre, as every renderer should show it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from taccel_lab.calibration.capture import ContactCircle
from taccel_lab.calibration.circles.ball_surface import BallSurface
from taccel_lab.networks.color_settings import ColorModelConfig
from taccel_lab.profile import SensorProfile
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.normals import normals_from_slopes
from taccel_lab.signals.rest_surface import rest_surface
from taccel_lab.signals.tactile_image import tactile_image
from tests.support.analytic_surface import analytic_surface

CIRCLE = ContactCircle(220.0, 90.0, 30.0)
"""Right of and above the middle of 320 x 240 px."""
BALL_RADIUS_MM = 4.0


def press_over_rest(profile: SensorProfile) -> BallSurface:
    """A ball's dent in a flat gel: height and slopes over the surface at rest."""
    return analytic_surface(CIRCLE, profile.grid(), BALL_RADIUS_MM, decay_mm=4.0)


def our_image(profile: SensorProfile, press: BallSurface) -> np.ndarray:
    """What the profile's own colour model shows of that press."""
    assert profile.color is not None and profile.color_weights is not None
    assert profile.background_rgb is not None
    model = ColorModel(
        ColorModelConfig.from_dict(profile.color.architecture), profile.color_weights
    )
    rest = rest_surface(profile.mesh, profile.grid()).normals
    slope = -press.normals[..., :2] / press.normals[..., 2:] - rest[..., :2] / rest[..., 2:]
    over_rest = replace(
        press,
        normals=normals_from_slopes(slope),
        rest_normals=rest,
    )
    return tactile_image(model, profile.background_rgb, over_rest)


def psnr(image: np.ndarray, truth: np.ndarray) -> float:
    return float(20 * np.log10(255 / np.sqrt(((image - truth) ** 2).mean())))


def require_upright(image: np.ndarray, truth: np.ndarray, least_db: float) -> None:
    """The image is near the truth, and its mirror images and swapped colours are far off."""
    assert psnr(image, truth) > least_db
    for wrong in (image[:, ::-1], image[::-1], image[::-1, ::-1], image[..., ::-1]):
        assert psnr(wrong, truth) < least_db - 10
