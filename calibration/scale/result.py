# SPDX-License-Identifier: Apache-2.0
"""A calibrated scale: what each kind of capture gives, and what they give together."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from taccel_lab.calibration.camera.pixel_grid import tactile_size, with_camera_block
from taccel_lab.calibration.capture.folder import source_of
from taccel_lab.calibration.result import BlockResult, calibrated
from taccel_lab.calibration.scale.estimate import CombinedAxis, ScaleEstimate
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import CameraBlock, SensorProfile
from taccel_lab.report.remark import Remark

STATED = "stated"
"""Method of a scale that is not measured: the captures say it."""


@dataclass(frozen=True, repr=False)
class ScaleCalibration(BlockResult):
    """Scales by method, and what they give together."""

    source: str
    size_px: tuple[int, int]
    estimates: tuple[ScaleEstimate, ...]
    axes: dict[str, CombinedAxis]
    """``x`` and ``y``; an axis that nothing was measured along is missing."""
    failures: dict[str, str]
    """Methods whose captures are there but gave nothing, with the reason."""
    provenance: dict[str, str]
    remarks: tuple[Remark, ...]
    rectified: bool = False
    """Whether the images were."""

    @property
    def scale(self) -> tuple[float, float]:
        """mm/px along x and y; InputError where only a limit is known."""
        if "x" not in self.axes and "y" not in self.axes:
            raise InputError(_only_limits(self.source, self.estimates))
        x = self.axes.get("x") or self.axes["y"]
        y = self.axes.get("y") or self.axes["x"]
        return x.estimate.value, y.estimate.value

    def inputs(self) -> dict[str, str]:
        """SHA-256 of the images used, by method and name."""
        return {
            f"{estimate.method}/{name}": value
            for estimate in self.estimates
            for name, value in estimate.inputs.items()
        }

    def figures(self) -> dict[str, Any]:
        """Everything measured, ready for JSON."""
        return {
            "methods": {estimate.method: estimate.figures() for estimate in self.estimates},
            "failed_methods": dict(self.failures),
            "combined": {
                axis: found.estimate.figures()
                | {
                    "chi_square": found.chi_square,
                    "freedom": found.freedom,
                    "probability": found.probability,
                    "agrees": found.agrees,
                    "pair_z": found.pairs,
                }
                for axis, found in self.axes.items()
            },
        }

    def apply_to(self, profile: SensorProfile) -> SensorProfile:
        """``profile`` with its pixel grid at the calibrated scale."""
        scale = self.scale
        camera = profile.camera
        size = tactile_size(profile, self.size_px) or self.size_px
        grid = PixelGrid(*size, *scale)
        if (camera.width_px, camera.height_px) == size:
            grid = replace(grid, center_u_px=camera.center_u_px, center_v_px=camera.center_v_px)
        means = {f"mm_per_px_{axis}": found.estimate for axis, found in self.axes.items()}
        methods = [estimate.method for estimate in self.estimates if estimate.x or estimate.y]
        residuals = {
            f"{estimate.method}_minus_mean_{axis}_mm_per_px": one.value - found.estimate.value
            for estimate in self.estimates
            for axis, found in self.axes.items()
            if (one := estimate.along(axis)) is not None
        }
        x_mm, y_mm = grid.x_mm(), grid.y_mm()
        block = CameraBlock.from_grid(
            grid,
            calibrated(
                self.remarks,
                kind="stated" if STATED in methods else "calibrated",
                method=f"mm/px from {', '.join(methods)}, weighed by inverse variance; the gel "
                "frame's origin as before, else in the middle of the image",
                source=source_of(self.provenance, self.source),
                inputs=self.inputs(),
                residuals=residuals,
                spread={name: mean.sigma for name, mean in means.items()},
                interval={name: mean.interval95 for name, mean in means.items()},
                valid_region={
                    "x_mm": (float(x_mm[0]), float(x_mm[-1])),
                    "y_mm": (float(y_mm[0]), float(y_mm[-1])),
                },
            ),
            self.rectified,
        )
        return with_camera_block(profile, block)


def _only_limits(source: str, estimates: tuple[ScaleEstimate, ...]) -> str:
    limits = [e.upper_x for e in estimates if e.upper_x is not None]
    bound = f"; ball presses only limit it to {min(limits):.5f} mm/px" if limits else ""
    return (
        f"{source}: the captures do not determine the scale{bound}. Add a board on the gel, "
        "presses of an edge, markers of known pitch, or stage_mm of ball presses"
    )
