# SPDX-License-Identifier: Apache-2.0
"""The image of the untouched sensor with what is known of its quality: noise, specks of dust and
scratches that stay in place, the light of each frame."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import cv2
import numpy as np

from taccel_lab.calibration.background.perturbation import UnitSpread, perturbation_block
from taccel_lab.calibration.base_profile import on_grid
from taccel_lab.calibration.light_drift import DriftSpread
from taccel_lab.calibration.result import BlockResult, calibrated
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import BackgroundBlock, PerturbationBlock, SensorProfile
from taccel_lab.reading.light import LightDrift, smoothed
from taccel_lab.report.remark import Remark, judge
from taccel_lab.robust_fit import spread_about_median

SPECK_SHARE = 1 / 60
"""Size below which something is a speck rather than a shade, as a part of the shorter side."""
SIGMAS = 8.0
MIN_LEVELS = 6.0


@dataclass(frozen=True)
class FrameLight:
    """One frame against the background."""

    name: str
    kind: str
    """``background``, ``untouched`` or ``press``."""
    drift: LightDrift
    seen_share: float
    """Share of the image that shows untouched gel."""
    plain_l1: float
    """Mean difference of the untouched part from the one background image [levels]."""
    corrected_l1: float
    """The same from the background that was made of the other frames, in this frame's light."""

    def figures(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {
            "name": self.name,
            "kind": self.kind,
            "gain_rgb": self.drift.gain.tolist(),
            "offset_rgb": self.drift.offset.tolist(),
            "gradient_rgb": self.drift.gradient.tolist(),
            "noise_levels": self.drift.noise_levels,
            "untouched_share": self.seen_share,
            "plain_l1": self.plain_l1,
            "corrected_l1": self.corrected_l1,
        }


@dataclass(frozen=True, repr=False)
class BackgroundCalibration(BlockResult):
    """The background image with what is known of its quality."""

    image: np.ndarray
    """RGB levels, float32, shape [height_px, width_px, 3]."""
    frames: tuple[FrameLight, ...]
    spread: DriftSpread | None
    """None of a single frame."""
    noise: np.ndarray
    """Noise of each pixel between frames [levels], NaN where unknown, shape [height, width]."""
    dust: np.ndarray
    """Specks of the background, bool, shape [height_px, width_px]."""
    new_dust: np.ndarray
    """Specks that the presses show and the background image does not, likewise."""
    mask: np.ndarray | None
    """Pixels that the captures say show gel, likewise; None for all."""
    remarks: tuple[Remark, ...]
    inputs: dict[str, str]
    source: str
    mm_per_px: tuple[float, float] | None
    method: str
    units: UnitSpread | None = None
    """How other units of the design differ, where their profiles were given."""

    @property
    def clean(self) -> np.ndarray:
        """Pixels of the captures' mask without specks, bool, shape [height_px, width_px]."""
        clean = ~(self.dust | self.new_dust)
        return clean if self.mask is None else clean & self.mask

    @property
    def noise_levels(self) -> float | None:
        """Median noise of a pixel between frames [levels]; None with fewer than 3 frames."""
        known = self.noise[np.isfinite(self.noise)]
        return float(np.median(known)) if len(known) else None

    @property
    def perturbation(self) -> PerturbationBlock | None:
        """How far the light of the untouched frames differs, or of the presses where there are
        fewer than two of them, and units; None of one frame without units."""
        untouched = [frame.drift for frame in self.frames if frame.kind == "untouched"]
        presses = [frame.drift for frame in self.frames if frame.kind == "press"]
        return perturbation_block(
            untouched if len(untouched) > 1 else presses,
            self.units,
            self.noise_levels,
            self.image.astype(np.float64).mean(axis=(0, 1)),
            dict(self.inputs),
            self.source,
        )

    def figures(self) -> dict[str, Any]:
        """Everything measured, ready for JSON."""
        return {
            "verdict": judge(self.remarks),
            "plain_l1": self._mean("plain_l1"),
            "heldout_l1": self._mean("corrected_l1"),
            "noise_levels": self.noise_levels,
            "drift": None
            if self.spread is None
            else {**asdict(self.spread), "auto_white_balance": self.spread.auto_white_balance},
            "dust_specks": speck_count(self.dust),
            "dust_share": float(self.dust.mean()),
            "new_dust_specks": speck_count(self.new_dust),
            "perturbation": None
            if self.perturbation is None
            else self.perturbation.model_dump(exclude={"provenance"}, exclude_none=True),
            "unit_count": 0 if self.units is None else self.units.unit_count,
            "frames": [frame.figures() for frame in self.frames],
        }

    def _mean(self, name: str) -> float:
        return float(np.mean([getattr(frame, name) for frame in self.frames]))

    def apply_to(self, profile: SensorProfile) -> SensorProfile:
        """``profile`` with the background, and with the spread of its light where it has one."""
        profile, spread = self.image_on(profile), self.perturbation
        return profile if spread is None else profile.with_block(spread)

    def image_on(self, profile: SensorProfile) -> SensorProfile:
        """``profile`` with the background, and the image's size where the profile has another."""
        height, width = self.image.shape[:2]
        camera = profile.camera
        if (camera.width_px, camera.height_px) != (width, height):
            if self.mm_per_px is None:
                raise InputError(
                    f"the captures are {width}x{height} px, the profile's camera "
                    f"{camera.width_px}x{camera.height_px} px, and the captures state no scale; "
                    "give mm_per_px_x and mm_per_px_y, or a --base with a calibrated camera"
                )
            grid = PixelGrid(width, height, *self.mm_per_px)
            profile = on_grid(profile, grid, {"source": self.source})
        spread = {
            "heldout_untouched_l1_levels": float(np.std([f.corrected_l1 for f in self.frames]))
        }
        if self.noise_levels is not None:
            spread["pixel_levels"] = self.noise_levels
        if self.spread is not None:
            for name, value in zip(("red", "green", "blue"), self.spread.shift_levels, strict=True):
                spread[f"drift_{name}_levels"] = value
        provenance = calibrated(
            self.remarks,
            method=self.method,
            source=self.source,
            inputs=self.inputs,
            residuals={
                "heldout_untouched_l1_levels": self._mean("corrected_l1"),
                "plain_untouched_l1_levels": self._mean("plain_l1"),
            },
            spread=spread,
            valid_region={"level": (float(self.image.min()), float(self.image.max()))},
        )
        return profile.with_block(BackgroundBlock(provenance=provenance), self.image)


def dust_mask(image: np.ndarray, mask: np.ndarray | None = None) -> np.ndarray:
    """Specks of an image, bool, shape [height_px, width_px].

    ``image`` holds RGB levels, or differences of levels. A speck is smaller than a sixtieth of the
    shorter side and stands out of its surroundings by 8 robust standard deviations and 6 levels.
    """
    sigma = max(min(image.shape[:2]) * SPECK_SHARE, 1.5)
    fine = smoothed(image, mask, 0.6) - smoothed(image, mask, sigma)
    strength = np.linalg.norm(fine, axis=-1)
    usable = strength if mask is None else strength[mask]
    noise = spread_about_median(usable)
    specks = strength > max(MIN_LEVELS, float(np.median(usable)) + SIGMAS * noise)
    if mask is not None:
        # Next to masked pixels the surroundings are one-sided.
        inner = cv2.erode(mask.astype(np.uint8), np.ones((5, 5), np.uint8), borderValue=1) > 0
        specks &= inner
    _, parts, stats, _ = cv2.connectedComponentsWithStats(specks.astype(np.uint8))
    small = stats[:, cv2.CC_STAT_AREA] < (4 * sigma) ** 2
    small[0] = False
    specks = small[parts]
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (3, 3))
    return cv2.dilate(specks.astype(np.uint8), kernel) > 0


def speck_count(specks: np.ndarray) -> int:
    """Connected specks of a mask."""
    return int(cv2.connectedComponents(specks.astype(np.uint8))[0]) - 1
