# SPDX-License-Identifier: Apache-2.0
"""Depth of a grey sensor from how far its pixels darken, and the grey of a depth.

A translucent gel under a black skin looks darker where the skin comes nearer: 9DTact (Lin, Zhang,
Xu, Lin, Wu and Yang, IEEE RA-L 9(2), 2024) reads the depth of a pixel from the drop of its grey
level against the untouched image, by a table. Here the table is the profile's ``depth_response``,
straight between its entries. Pixels that brighten read as untouched; beyond the last entry the
depth stays at the last one and is marked as saturated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from taccel_lab.errors import InputError

if TYPE_CHECKING:
    from taccel_lab.profile import DepthResponseBlock, SensorProfile

Channel = Literal["grey", "red", "green", "blue"]
LUMA = np.array([0.299, 0.587, 0.114])
"""Weights of red, green and blue in OpenCV's grey."""
_INDEX = {"red": 0, "green": 1, "blue": 2}


def channel_of(image: np.ndarray, channel: Channel) -> np.ndarray:
    """One channel of an RGB image, or its luma, as float levels, shape [..., h, w]."""
    values = np.asarray(image, dtype=np.float64)
    return values @ LUMA if channel == "grey" else values[..., _INDEX[channel]]


@dataclass(frozen=True)
class DepthMap:
    """What a grey sensor shows."""

    depth_mm: np.ndarray
    """Indentation of the contact face [mm], at least 0, shape [height_px, width_px]."""
    saturated: np.ndarray
    """Pixels darker than any that was calibrated, bool, shape [height_px, width_px]."""
    sigma_mm: np.ndarray | None
    """Standard deviation of the depth [mm]; None where the calibration does not know."""
    reading_sigma_mm: np.ndarray | None
    """Standard deviation of the reading alone, without the zero and the scale that all depths
    share."""

    @property
    def height_m(self) -> np.ndarray:
        """Rise of the face over rest [m], negative in a dent."""
        return -1e-3 * self.depth_mm


class DepthResponse:
    """The monotone curve between grey drop and depth."""

    def __init__(
        self,
        channel: Channel,
        drop_levels: np.ndarray,
        depth_mm: np.ndarray,
        *,
        reading_sigma_mm: float | None = None,
        zero_sigma_mm: float = 0.0,
        depth_share: float = 0.0,
    ) -> None:
        """The curve through drops and depths; standard deviations as in ``DepthResponseBlock``."""
        self.channel: Channel = channel
        self.reading_sigma_mm, self.zero_sigma_mm = reading_sigma_mm, zero_sigma_mm
        self.depth_share = depth_share
        self.drop_levels = np.asarray(drop_levels, dtype=np.float64)
        self.depth_mm = np.asarray(depth_mm, dtype=np.float64)
        if self.drop_levels.shape != self.depth_mm.shape or self.drop_levels.ndim != 1:
            raise InputError(
                f"drop_levels {self.drop_levels.shape} and depth_mm {self.depth_mm.shape} must be "
                "two lists of one length"
            )
        if len(self.drop_levels) < 2 or (np.diff(self.drop_levels) <= 0).any():
            raise InputError("drop_levels must hold at least two rising levels")
        if (np.diff(self.depth_mm) < 0).any() or self.depth_mm[0] < 0:
            raise InputError("depth_mm must not fall and start at 0 or above")

    @classmethod
    def from_block(cls, block: DepthResponseBlock) -> DepthResponse:
        return cls(
            block.channel,
            np.array(block.drop_levels),
            np.array(block.depth_mm),
            reading_sigma_mm=block.reading_sigma_mm,
            zero_sigma_mm=block.zero_sigma_mm,
            depth_share=block.depth_share,
        )

    @classmethod
    def from_profile(cls, profile: SensorProfile) -> DepthResponse:
        """The response of a profile; InputError when it has none."""
        if profile.depth_response is None:
            raise InputError(
                f"the profile of {profile.sensor.name} has no depth_response block; fit one with "
                "taccel-lab calibrate depth"
            )
        return cls.from_block(profile.depth_response)

    def depth_of(self, drop_levels: np.ndarray) -> np.ndarray:
        """Depth [mm] of grey drops [levels], any shape."""
        return np.interp(drop_levels, self.drop_levels, self.depth_mm)

    @property
    def mm_per_level(self) -> float:
        """Slope of the curve's first entries, which noise at rest, and gel that rises, are read
        by."""
        at = min(3, len(self.drop_levels) - 1)
        return float(self.depth_mm[at] / (self.drop_levels[at] - self.drop_levels[0]))

    def signed_depth_of(self, drop_levels: np.ndarray) -> np.ndarray:
        """``depth_of``, and below 0 how far gel has risen that is brighter than at rest [mm]."""
        above = np.minimum(drop_levels - self.drop_levels[0], 0.0)
        return self.depth_of(drop_levels) + self.mm_per_level * above

    def sigma_of(self, drop_levels: np.ndarray) -> np.ndarray | None:
        """Standard deviation of these depths [mm], same shape; None where it is not known."""
        return self._sigma_mm(drop_levels, self.depth_of(drop_levels))

    def _sigma_mm(self, drop_levels: np.ndarray, depth_mm: np.ndarray) -> np.ndarray | None:
        if self.reading_sigma_mm is None:
            return None
        zero_mm = np.interp(drop_levels, self.drop_levels[:2], [0.0, self.zero_sigma_mm])
        share_mm = self.depth_share * depth_mm
        return np.sqrt(self.reading_sigma_mm**2 + zero_mm**2 + share_mm**2)

    def drop_of(self, depth_mm: np.ndarray) -> np.ndarray:
        """Grey drop [levels] of depths [mm], any shape; the smallest one where the curve is level.

        Depths beyond the curve give its last drop.
        """
        depth, first = np.unique(self.depth_mm, return_index=True)
        return np.interp(depth_mm, depth, self.drop_levels[first])

    def read(
        self, image: np.ndarray, background: np.ndarray, mask: np.ndarray | None = None
    ) -> DepthMap:
        """Depth of every pixel of an image, RGB levels, shape [height_px, width_px, 3].

        Masked pixels read as untouched.
        """
        return self.of_drop(self.drop(image, background), mask)

    def drop(self, image: np.ndarray, background: np.ndarray) -> np.ndarray:
        """Drop of the channel [levels], shape [h, w], of two RGB images."""
        if image.shape != background.shape or image.ndim != 3 or image.shape[-1] != 3:
            raise InputError(
                f"image {image.shape} and background {background.shape} must be two RGB images of "
                "one size"
            )
        return channel_of(background, self.channel) - channel_of(image, self.channel)

    def of_drop(self, drop: np.ndarray, mask: np.ndarray | None = None) -> DepthMap:
        """Depths of drops [levels], [h, w]; masked pixels read as untouched."""
        if mask is not None:
            drop = np.where(mask, drop, self.drop_levels[0])
        alone, depth_mm = self.reading_sigma_mm, self.depth_of(drop)
        return DepthMap(
            depth_mm=depth_mm,
            saturated=drop > self.drop_levels[-1],
            sigma_mm=self._sigma_mm(drop, depth_mm),
            reading_sigma_mm=None if alone is None else np.full(drop.shape, alone),
        )

    def render(self, depth_mm: np.ndarray, background: np.ndarray) -> np.ndarray:
        """Image of a depth map [mm] on a background (RGB levels): all channels darken alike.

        Gel that rises beside a contact, of a depth below 0, is brighter, by the curve's first
        slope. Float levels in 0..255, shape [..., height_px, width_px, 3].
        """
        depth_mm = np.asarray(depth_mm)
        if depth_mm.shape[-2:] != background.shape[:2]:
            raise InputError(
                f"depth of shape {depth_mm.shape} does not fit the background {background.shape}"
            )
        drop = self.drop_of(depth_mm)
        if self.mm_per_level > 0:
            drop = drop + np.minimum(depth_mm, 0.0) / self.mm_per_level
        return np.clip(background - drop[..., None], 0.0, 255.0)
