# SPDX-License-Identifier: Apache-2.0
"""What the uncertain light of an image does to heights.

Gain, offset and gradient of each channel are known to a covariance. Each of them, off by a little,
changes colours all over the image, and with them slopes and their integral. That is linear in small
errors and hardly depends on what is pressed, so that it is found once for each sensor, at rest.
"""

from __future__ import annotations

import numpy as np

from taccel_lab.calibration.light.light import LightDrift
from taccel_lab.geometry import PixelGrid
from taccel_lab.signals.depth_response import LUMA, DepthResponse
from taccel_lab.signals.normal_model import NormalModel
from taccel_lab.signals.slope_integration import resting_height

COARSE_PX = 48
"""Of the shorter side of the maps that errors are integrated on: they are smooth."""
PROBE_LEVELS = 2.0
"""Change of colour that slopes are found for; small beside what they are linear in."""


class LightErrors:
    """Heights' standard deviations by the light, for images of one sensor."""

    def __init__(
        self,
        model: NormalModel,
        background: np.ndarray,
        grid: PixelGrid,
        mask: np.ndarray | None = None,
        rest_normals: np.ndarray | None = None,
    ) -> None:
        """
        Args:
            model: From colours to normals.
            background: The untouched sensor, RGB levels, shape [height_px, width_px, 3].
            grid: Pixel grid of the images.
            mask: Pixels that count, bool, shape [height_px, width_px].
            rest_normals: Of the face at rest, shape [h, w, 3]; flat when None.
        """
        every = max(1, min(background.shape[:2]) // COARSE_PX)
        self._part = np.s_[::every, ::every]
        self._grid, self._size = grid.thinned(every), background.shape[1::-1]
        self._level = background.reshape(-1, 3).mean(axis=0)
        terms = LightDrift(np.ones(3), np.zeros(3), level=self._level).terms(background)
        self._weights = None if mask is None else mask[self._part].astype(float)
        rest = 0.0
        if rest_normals is not None:
            thin = rest_normals[self._part]
            rest = thin[..., :2] / thin[..., 2:]
        self._slopes = np.empty((3, 4, self._grid.height_px, self._grid.width_px, 2))
        for channel in range(3):
            for k, term in enumerate(terms):
                probe = PROBE_LEVELS / max(float(np.abs(term[..., channel]).max()), 1e-9)
                image = background.astype(np.float32)
                image[..., channel] += probe * term[..., channel]
                read = model.predict(
                    image, background, mask=mask, rest_normals=rest_normals, every=every
                )
                self._slopes[channel, k] = (read.slopes() + rest) / probe

    def sigma_m(self, light: LightDrift, zero: np.ndarray | None) -> np.ndarray:
        """Standard deviation of the heights [m], shape [height_px, width_px].

        Args:
            light: Of the image against the background.
            zero: Pixels that its heights are counted from, as of ``ReadHeights``.
        """
        import cv2

        part = None if zero is None else zero[self._part]
        if part is not None and not part.any():
            part = None
        variance = np.zeros((self._grid.height_px, self._grid.width_px))
        for slopes, covariance in zip(self._slopes, light.covariance_at(self._level), strict=True):
            heights = np.array(
                [
                    resting_height(slope, self._grid, weights=self._weights, zero=part)
                    for slope in slopes
                ]
            )
            variance += np.einsum("khw,kl,lhw->hw", heights, covariance, heights)
        whole = cv2.resize(variance, self._size, interpolation=cv2.INTER_LINEAR)
        return np.sqrt(np.maximum(whole, 0.0))


def grey_light_sigma_mm(
    response: DepthResponse, light: LightDrift, background: np.ndarray, depth_mm: np.ndarray
) -> np.ndarray:
    """The same of a grey sensor, whose depths follow the curve ``response`` pixel by pixel [mm].

    ``background``: untouched sensor, RGB levels, shape [h, w, 3]; ``depth_mm``: what is read, shape
    [h, w].
    """
    names = ("red", "green", "blue")
    shares = (
        LUMA
        if response.channel == "grey"
        else np.array([float(name == response.channel) for name in names])
    )
    terms = light.terms(background)
    variance = sum(
        share**2 * np.einsum("khw,kl,lhw->hw", terms[..., c], light.covariance[c], terms[..., c])
        for c, share in enumerate(shares)
    )
    drop = response.drop_of(depth_mm)
    per_level = response.depth_of(drop + 1.0) - response.depth_of(drop)
    return per_level * np.sqrt(np.maximum(variance, 0.0))
