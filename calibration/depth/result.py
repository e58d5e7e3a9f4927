# SPDX-License-Identifier: Apache-2.0
"""What a depth calibration found: the curve, its errors, and the block that it becomes."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from taccel_lab.calibration.ball_presses import with_captured_background, with_doubtful_ball
from taccel_lab.calibration.base_profile import on_grid
from taccel_lab.calibration.capture.captures import CaptureSet
from taccel_lab.calibration.capture.folder import source_of
from taccel_lab.calibration.depth.curve import ContactPixels
from taccel_lab.calibration.result import BlockResult, calibrated
from taccel_lab.profile import DepthResponseBlock, SensorProfile
from taccel_lab.report.remark import Remark, judge
from taccel_lab.signals.depth_response import DepthResponse


@dataclass(frozen=True)
class PressFigures:
    """One press against the curve."""

    name: str
    u_px: float
    v_px: float
    radius_px: float
    radius_sigma_px: float
    given: bool
    """Whether the circle was given with the press."""
    rim_depth_mm: float
    """Depth of the contact's rim below the zero; negative where the zero lies deeper."""
    depth_mm: float
    """Depth of the ball's lowest point below the untouched face."""
    mae_mm: float
    bias_mm: float
    plane_mm: float
    """Rise of the residuals' plane across the contact: a wrong centre, a tilt, or uneven light."""


@dataclass(frozen=True, repr=False)
class DepthCalibration(BlockResult):
    """Result of ``calibrate_depth``."""

    response: DepthResponse
    spread_mm: np.ndarray
    """Standard deviation of the curve at its drops."""
    offset_sigma_mm: float
    """Standard deviation of its zero: what the uncertain rim makes of it."""
    zero_gap_mm: float
    """How far the zero lies from the farther of the two that images show: the contact's rim, and
    where the grey is that of untouched gel."""
    left_out_mm: np.ndarray
    left_out: str
    presses: tuple[PressFigures, ...]
    parts: tuple[ContactPixels, ...]
    zero: str
    """What depths are counted from (``DepthOptions``)."""
    captures: CaptureSet
    """The presses; their images are read on demand."""
    ball_share: float = 0.0
    """Standard deviation of depths, as a share of them, by a ball whose radius may be its diameter;
    0 where that is known."""
    remarks: tuple[Remark, ...] = ()

    @property
    def zero_sigma_mm(self) -> float:
        """Standard deviation of the zero: of the rim, and of what images say besides."""
        return math.hypot(self.offset_sigma_mm, self.zero_gap_mm)

    @property
    def absolute_mm(self) -> float:
        """Expected error of a depth: that of left-out pixels, and the zero's, which is common to
        all of them."""
        return math.hypot(float(self.left_out_mm.mean()), self.zero_sigma_mm)

    def headline(self) -> str:
        """The error in one sentence, the absolute one first."""
        return (
            f"absolute depths are off by {self.absolute_mm:.2f} mm, as their zero is "
            f"known to {self.zero_sigma_mm:.2f} mm; apart from that common offset pixels of a "
            f"left-out {self.left_out} are off by {self.left_out_mm.mean():.3f} mm"
        )

    def figures(self) -> dict[str, Any]:
        """Everything measured, ready for JSON."""
        return {
            "verdict": judge(self.remarks),
            "remarks": [str(remark) for remark in self.remarks],
            "absolute_mm": self.absolute_mm,
            "zero_sigma_mm": self.zero_sigma_mm,
            "zero_gap_mm": self.zero_gap_mm,
            "channel": self.response.channel,
            "zero": self.zero,
            "left_out_mae_mm": float(self.left_out_mm.mean()),
            "left_out_p90_mm": float(np.percentile(self.left_out_mm, 90)),
            "left_out": self.left_out,
            "reading_sigma_mm": self.response.reading_sigma_mm,
            "curve_sigma_mm": float(self.spread_mm[1:].mean()),
            "offset_sigma_mm": self.offset_sigma_mm,
            "presses": [asdict(p) for p in sorted(self.presses, key=lambda p: -p.mae_mm)],
            "drop_levels": self.response.drop_levels.tolist(),
            "depth_mm": self.response.depth_mm.tolist(),
        }

    def residuals(self) -> dict[str, float]:
        """What the fit left over."""
        return {
            "absolute_depth_mm": self.absolute_mm,
            "left_out_depth_mm": float(self.left_out_mm.mean()),
            "left_out_p90_depth_mm": float(np.percentile(self.left_out_mm, 90)),
        }

    def apply_to(self, profile: SensorProfile) -> SensorProfile:
        """``profile`` on the captures' grid, with the block depth_response, and a background where
        it has none."""
        captures = self.captures
        profile = on_grid(profile, captures.grid, captures.provenance)
        inputs, source = captures.hashes(), source_of(captures.provenance, captures.source)
        profile = with_captured_background(
            profile, captures.background, source, inputs["background"]
        )
        response = self.response
        return with_doubtful_ball(profile, self.ball_share).with_block(
            DepthResponseBlock(
                channel=response.channel,
                drop_levels=tuple(response.drop_levels.tolist()),
                depth_mm=tuple(response.depth_mm.tolist()),
                reading_sigma_mm=response.reading_sigma_mm,
                zero_sigma_mm=response.zero_sigma_mm,
                depth_share=math.hypot(response.depth_share, self.ball_share),
                provenance=calibrated(
                    self.remarks,
                    method=f"isotonic regression of depth on grey drop inside {len(self.presses)} "
                    f"ball contacts; depth zero: {self.zero}",
                    source=source,
                    inputs=inputs,
                    residuals=self.residuals(),
                    spread={
                        "curve_mm": float(self.spread_mm[1:].mean()),
                        "zero_mm": self.zero_sigma_mm,
                    },
                    valid_region={
                        "drop_levels": tuple(response.drop_levels[[1, -1]].tolist()),
                        "depth_mm": tuple(response.depth_mm[[1, -1]].tolist()),
                    },
                ),
            )
        )
