# SPDX-License-Identifier: Apache-2.0
"""A scale that one kind of capture gives; several of one image: do they agree, and what do they
give together?

Estimates are compared by chi-square about their inverse-variance mean, and pair by pair. When they
agree, the mean is taken; when they do not, it is given too, widened by Birge's ratio (R. T. Birge,
Phys. Rev. 40, 1932), and a remark says which pairs contradict each other.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.stats import chi2

from taccel_lab.calibration.remarks import SCALE_DISAGREES
from taccel_lab.calibration.result import Estimate
from taccel_lab.calibration.scale.remarks import CONTACTS_EXCEED_BALL
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
