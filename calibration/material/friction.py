# SPDX-License-Identifier: Apache-2.0
"""The coefficient of friction: of one record, fitted over its logarithm, and of all records."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from taccel_lab.calibration.capture import CaptureFolder
from taccel_lab.calibration.material.ball_slide import simulate_ball_slide
from taccel_lab.calibration.material.gel import Gel
from taccel_lab.calibration.material.likelihood import Solution, widened
from taccel_lab.calibration.material.remarks import (
    BALL_LEANS,
    FRICTION_DISAGREES,
    LEANING_UNKNOWN,
)
from taccel_lab.calibration.material.robust_statistics import combined, scatter
from taccel_lab.calibration.material.sliding import SlideFit, friction_of_slides
from taccel_lab.calibration.result import NORMAL_95, Estimate
from taccel_lab.progress import Progress
from taccel_lab.report.remark import Remark

LEANING_ERROR = 0.02
"""Relative error of the correction of a ball's leaning: steady state and mesh."""
UNCORRECTED_ERROR = 0.08
"""Relative error of friction from a sliding ball whose leaning is not corrected."""


class FrictionFit:
    """What fits with a parameter ``ln_mu`` say of friction."""

    name: str
    solution: Solution

    @property
    def table_error(self) -> float:
        """Relative error of the simulated table."""
        raise NotImplementedError

    @property
    def friction(self) -> float:
        """The coefficient."""
        return math.exp(self.solution.value("ln_mu"))

    @property
    def friction_interval(self) -> tuple[float, float]:
        """95 % interval: the profile's, widened by the error of the table."""
        profile, value = self.solution.profiles["ln_mu"], self.solution.value("ln_mu")
        low, high = widened(profile.interval, value, NORMAL_95 * self.table_error)
        return math.exp(low), math.exp(high)

    @property
    def relative_sigma(self) -> float:
        """Standard deviation of the coefficient as a part of it, the table included."""
        return math.hypot(self.solution.sigma_of("ln_mu"), self.table_error)

    @property
    def friction_determined(self) -> bool:
        """Whether the record ends the coefficient's interval on both sides."""
        return self.solution.profiles["ln_mu"].closed


def friction_of_records(
    gel: Gel,
    folder: CaptureFolder,
    slides: Sequence[SlideFit],
    others: Sequence[FrictionFit],
    young_pa: float,
    progress: Progress,
) -> tuple[Estimate | None, list[Remark]]:
    """One coefficient from slides and from shear, twist and marker flow; None where none
    determines it."""
    found: dict[str, Estimate] = {}
    remarks: list[Remark] = []
    slid = [fit for fit in slides if fit.slid]
    if slid:
        ratio, said = friction_of_slides(slid)
        remarks += said
        found["slides"], said = _without_leaning(gel, folder, slid, ratio, young_pa, progress)
        remarks += said
    for fit in others:
        if fit.friction_determined:
            found[fit.name] = Estimate(fit.friction, fit.friction * fit.relative_sigma)
    if not found:
        return None, remarks
    each = list(found.values())
    mean = combined(each)
    values = [item.value for item in each]
    if len(each) > 1 and scatter(each) > 6 and np.ptp(values) > 0.15 * mean.value:
        text = ", ".join(f"{name} {item.value:.3g}" for name, item in found.items())
        remarks.append(FRICTION_DISAGREES(each=text))
    half = NORMAL_95 * mean.sigma
    # Two digits: presses with it are simulated, and the profile says what they had.
    stated = float(f"{mean.value:.2g}")
    ends = max(mean.value - half, 0.0), mean.value + half
    return Estimate(stated, mean.sigma, "", ends), remarks


def _without_leaning(
    gel: Gel,
    folder: CaptureFolder,
    slides: Sequence[SlideFit],
    ratio: Estimate,
    young_pa: float,
    progress: Progress,
) -> tuple[Estimate, list[Remark]]:
    """The coefficient that makes the ratio of the forces of slides: a ball leans on the gel."""
    entry = next(r.entry.tool for r in folder.records if r.source == slides[0].source)
    if entry.kind != "sphere":
        return Estimate(ratio.value, ratio.sigma), []
    if entry.radius_mm is None and folder.ball_radius_mm is None:
        note = "the radius of the sliding ball is not stated"
    else:
        tool = gel.tool(entry, folder.ball_radius_mm)
        load = float(np.mean([np.mean(fit.normal_range_n) for fit in slides]))
        slide = simulate_ball_slide(gel, tool, load, ratio.value, young_pa, progress)
        if slide is not None:
            mu = slide.friction(ratio.value)
            sigma = math.hypot(ratio.sigma * mu / ratio.value, LEANING_ERROR * mu)
            remark = BALL_LEANS(ratio=ratio.value, depth_mm=slide.depth_mm, friction=mu)
            return Estimate(mu, sigma), [remark]
        note = "slides with so much friction do not converge"
    remark = LEANING_UNKNOWN(reason=note)
    return Estimate(ratio.value, math.hypot(ratio.sigma, UNCORRECTED_ERROR * ratio.value)), [remark]
