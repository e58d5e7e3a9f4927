# SPDX-License-Identifier: Apache-2.0
"""What a person has to know about a colour calibration, beyond what its captures already show."""

from __future__ import annotations

import numpy as np

from taccel_lab.calibration.color.result import ColorCalibration
from taccel_lab.calibration.color.score import mean_bare
from taccel_lab.calibration.remarks import warning
from taccel_lab.calibration.result import in_figures
from taccel_lab.calibration.shared_remarks import (
    HELDOUT_ERROR,
    NOTHING_HELD_OUT,
    TOO_FEW,
    left_out_remarks,
)
from taccel_lab.report.remark import Remark

LEAST_PRESSES = 4
"""Fewest presses: with fewer a model knows a few places and depths, and nothing tells of the
others."""
LEAST_GAIN_DB = 6.0
"""A colour model that beats the bare background by less, in the crop, explains little."""
OUTLIER_FACTOR = 2.5
"""A press that is rendered worse than the median by this factor is named."""
OUTLIER_LEVELS = 3.0
"""And by these levels at least."""

OUTLIERS = warning(
    "outliers",
    "{worse} of {count} presses are rendered much worse than the median of {median:.1f} levels: "
    "{names}; look at their images and circles (taccel-lab capture check), and leave out what is "
    "not a clean ball press",
)


def color_remarks(result: ColorCalibration) -> list[Remark]:
    """Remarks on a fit and its figures."""
    found, count = [], len(result.train_names)
    if count < LEAST_PRESSES:
        wanted = (
            "the model holds at their places and depths at best. Give 30 to 50, all over the gel"
        )
        found.append(TOO_FEW(count=count, what="presses fitted", wanted=wanted, grave=True))
    failures = {item.name: item.reason for item in in_figures(result.failures)}
    return [
        *found,
        *_against_background(result),
        *left_out_remarks(failures, result.rejected, "dB"),
        *_outliers(result),
    ]


def _against_background(result: ColorCalibration) -> list[Remark]:
    if not result.has_scores:
        return [NOTHING_HELD_OUT()]
    model = result.heldout_means()["crop_psnr_db"]
    bare = mean_bare(result.heldout, result.failures)["crop_psnr_db"]
    if model - bare >= LEAST_GAIN_DB:
        return []
    error = f"{model:.1f} dB, the bare background alone by {bare:.1f} dB"
    advice = (
        "circles, scale, ball or background are wrong, or the gel was not pressed where these are"
    )
    return [HELDOUT_ERROR(what="colours", error=error, advice=advice, grave=True)]


def _outliers(result: ColorCalibration) -> list[Remark]:
    values = {**result.fit.disc_l1_train, **result.heldout_l1()}
    if len(values) < 5:
        return []
    median = float(np.median(list(values.values())))
    limit = max(OUTLIER_FACTOR * median, median + OUTLIER_LEVELS)
    worst = sorted((name for name in values if values[name] > limit), key=lambda n: -values[n])
    if not worst:
        return []
    named = ", ".join(f"{name} ({values[name]:.1f})" for name in worst[:5])
    more = f" and {len(worst) - 5} more" if len(worst) > 5 else ""
    return [OUTLIERS(worse=len(worst), count=len(values), median=median, names=f"{named}{more}")]
