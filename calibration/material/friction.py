# SPDX-License-Identifier: Apache-2.0
"""The coefficient of friction of all slides, without what a ball leans on the gel before it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from taccel_lab.calibration.capture import CaptureFolder
from taccel_lab.calibration.material.ball_slide import simulate_ball_slide
from taccel_lab.calibration.material.gel import Gel
from taccel_lab.calibration.material.remarks import LEANING_UNKNOWN
from taccel_lab.calibration.material.robust_statistics import combined
from taccel_lab.calibration.material.sliding import SlideFit
from taccel_lab.calibration.result import NORMAL_95, Estimate
from taccel_lab.progress import Progress
from taccel_lab.report.remark import Remark

LEANING_ERROR = 0.02
"""Relative error of the correction of a ball's leaning: steady state and mesh."""
UNCORRECTED_ERROR = 0.08
"""Relative error of friction from a sliding ball whose leaning is not corrected."""


def friction_of_records(
    gel: Gel,
    folder: CaptureFolder,
    slides: Sequence[SlideFit],
    young_pa: float,
    progress: Progress,
) -> tuple[Estimate | None, list[Remark]]:
    """One coefficient of all slides; None where the tool slid in none."""
    slid = [fit for fit in slides if fit.slid]
    if not slid:
        return None, []
    ratio = combined([fit.friction for fit in slid])
    mean, remarks = _without_leaning(gel, folder, slid, ratio, young_pa, progress)
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
        return ratio, []
    if entry.radius_mm is None and folder.ball_radius_mm is None:
        note = "the radius of the sliding ball is not stated"
    else:
        tool = gel.tool(entry, folder.ball_radius_mm)
        load = float(np.mean([np.mean(fit.normal_range_n) for fit in slides]))
        slide = simulate_ball_slide(gel, tool, load, ratio.value, young_pa, progress)
        if slide is not None:
            mu = slide.friction(ratio.value)
            return Estimate(mu, math.hypot(ratio.sigma * mu / ratio.value, LEANING_ERROR * mu)), []
        note = "slides with so much friction do not converge"
    sigma = math.hypot(ratio.sigma, UNCORRECTED_ERROR * ratio.value)
    return Estimate(ratio.value, sigma), [LEANING_UNKNOWN(reason=note)]
