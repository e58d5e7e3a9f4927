# SPDX-License-Identifier: Apache-2.0
"""What the uncertain light of an image does to heights.

Gain, offset and gradient of each channel are known to a covariance. Each of them, off by a little,
changes colours all over the image, and with them slopes and their integral. That is linear in small
errors and hardly depends on what is pressed, so that it is found once for each sensor, at rest.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from taccel_lab.calibration.light_drift import LightDrift
from taccel_lab.geometry import PixelGrid
from taccel_lab.signals.depth_response import LUMA, DepthResponse
from taccel_lab.signals.normal_model import NormalModel
from taccel_lab.signals.slope_integration import resting_height

COARSE_PX = 48
"""Pixels of the shorter side of the maps that errors are integrated on: they are smooth."""
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
        self.every = every = max(1, min(background.shape[:2]) // COARSE_PX)
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

    def sigma_m(
        self, lights: Sequence[LightDrift], zero: np.ndarray | None, every: int = 1
    ) -> list[np.ndarray]:
        """Standard deviations of the heights [m] for each light of one image, [height, width].

        Args:
            lights: Of the image against the background.
            zero: Pixels that its heights are counted from, as of ``ReadHeights``.
            every: Rows and columns apart that these are of: 1, or ``self.every``.
        """
        import cv2

        part = zero if zero is None or every > 1 else zero[self._part]
        if part is not None and not part.any():
            part = None
        heights = resting_height(self._slopes, self._grid, weights=self._weights, zero=part)
        found = []
        for light in lights:
            covariance = light.covariance_at(self._level)
            variance = np.einsum("ckhw,ckl,clhw->hw", heights, covariance, heights)
            if every == 1:
                variance = cv2.resize(variance, self._size, interpolation=cv2.INTER_LINEAR)
            found.append(np.sqrt(np.maximum(variance, 0.0)))
        return found


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
