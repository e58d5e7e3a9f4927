# SPDX-License-Identifier: Apache-2.0
"""A calibrated scale: what each kind of capture gives, whether they agree, and what they give
together.

Estimates are compared by chi-square about their inverse-variance mean, and pair by pair. When they
agree, the mean is taken; when they do not, it is given too, widened by Birge's ratio (R. T. Birge,
Phys. Rev. 40, 1932), and a remark says which pairs contradict each other.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.stats import chi2

from taccel_lab.calibration.camera.result import tactile_size, with_camera_block
from taccel_lab.calibration.capture.folder import source_of
from taccel_lab.calibration.remarks import SCALE_DISAGREES
from taccel_lab.calibration.result import BlockResult, Estimate, calibrated
from taccel_lab.calibration.scale.remarks import CONTACTS_EXCEED_BALL
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.profile import CameraBlock, SensorProfile
from taccel_lab.report.remark import Remark

DISAGREES = 0.01
"""Probability of so large a chi-square by chance below which estimates contradict each other."""
LIMIT_SIGMAS = 2.0


@dataclass(frozen=True)
class ScaleEstimate:
    """mm/px along x and y by one method; None where it tells nothing of an axis."""

    method: str
    x: Estimate | None = None
    y: Estimate | None = None
    upper_x: float | None = None
    """95 % limit that the scale cannot exceed, where the method gives no more [mm/px]."""
    inputs: dict[str, str] = field(default_factory=dict)
    """SHA-256 of the images that were used, by name."""
    evidence: dict[str, Any] = field(default_factory=dict)
    """What it rests on, ready for JSON."""
    remarks: tuple[Remark, ...] = ()
    refused: tuple[str, ...] = ()
    """Captures that could not be used, with the reason."""

    def along(self, axis: str) -> Estimate | None:
        """The estimate of axis ``x`` or ``y``."""
        return self.x if axis == "x" else self.y

    def figures(self) -> dict[str, Any]:
        """Ready for JSON."""
        found: dict[str, Any] = {"refused": list(self.refused), **self.evidence}
        for axis in ("x", "y"):
            estimate = self.along(axis)
            if estimate is not None:
                found[f"mm_per_px_{axis}"] = estimate.figures()
        if self.upper_x is not None:
            found["mm_per_px_upper95"] = self.upper_x
        return found


@dataclass(frozen=True)
class CombinedAxis:
    """Mean of the estimates of one axis."""

    estimate: Estimate
    chi_square: float
    freedom: int
    probability: float
    """Probability of a larger chi-square by chance, if all were right."""
    pairs: dict[str, float] = field(default_factory=dict)
    """Difference of two methods over its standard deviation, by ``first*second``."""

    @property
    def agrees(self) -> bool:
        return self.probability >= DISAGREES


def combine(estimates: Sequence[ScaleEstimate]) -> dict[str, CombinedAxis]:
    """Their means along ``x`` and ``y``; without an axis that none tells anything of."""
    axes = {}
    for axis in ("x", "y"):
        named = [(e.method, one) for e in estimates if (one := e.along(axis)) is not None]
        if named:
            axes[axis] = combine_axis(named)
    return axes


def combine_axis(estimates: Sequence[tuple[str, Estimate]]) -> CombinedAxis:
    """Inverse-variance mean of named estimates, at least one."""
    values = np.array([estimate.value for _, estimate in estimates])
    sigmas = np.array([max(estimate.sigma, 1e-12) for _, estimate in estimates])
    weights = 1 / sigmas**2
    mean = float(np.sum(weights * values) / np.sum(weights))
    sigma = float(1 / np.sqrt(np.sum(weights)))
    square = float(np.sum(weights * (values - mean) ** 2))
    freedom = len(values) - 1
    probability = float(chi2.sf(square, freedom)) if freedom else 1.0
    if freedom:
        sigma *= max(1.0, float(np.sqrt(square / freedom)))
    pairs = {
        f"{a}*{b}": float((x.value - y.value) / np.hypot(max(x.sigma, 1e-12), max(y.sigma, 1e-12)))
        for (a, x), (b, y) in itertools.combinations(estimates, 2)
    }
    interval = estimates[0][1].interval if len(estimates) == 1 else None
    return CombinedAxis(
        Estimate(mean, sigma, "mm/px", interval), square, freedom, probability, pairs
    )


def agreement_remarks(
    axes: dict[str, CombinedAxis], estimates: Sequence[ScaleEstimate]
) -> list[Remark]:
    """What to say of scales that contradict each other, or a limit."""
    remarks = []
    for axis, combined in axes.items():
        if not combined.agrees:
            worst = sorted(combined.pairs.items(), key=lambda item: -abs(item[1]))
            said = ", ".join(
                f"{name.replace('*', ' against ')} {z:+.1f} sigma" for name, z in worst
            )
            each = ", ".join(
                f"{estimate.method} {found}"
                for estimate in estimates
                if (found := estimate.along(axis)) is not None
            )
            scales = f"along {axis} {each} ({said})"
            remarks.append(SCALE_DISAGREES(scales=scales, grave=True))
    combined = axes.get("x")
    for estimate in estimates:
        if estimate.upper_x is None or combined is None:
            continue
        low = combined.estimate.value - LIMIT_SIGMAS * combined.estimate.sigma
        if low > estimate.upper_x:
            remarks.append(CONTACTS_EXCEED_BALL(scale=combined.estimate, limit=estimate.upper_x))
    return remarks


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
