# SPDX-License-Identifier: Apache-2.0
"""What a user has to know of a fit to indentations: misfit, too few points, records at odds."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from taccel_lab.calibration.material.indentation import IndentationFit, fit_indentation
from taccel_lab.calibration.material.predicted_forces import HeldOut
from taccel_lab.calibration.material.remarks import (
    FRICTION_ASSUMED,
    RECORDS_DISAGREE,
    TOUCH_SHIFT,
    YOUNG_UNCERTAIN,
)
from taccel_lab.calibration.result import Estimate
from taccel_lab.calibration.shared_remarks import HELDOUT_ERROR, TOO_FEW
from taccel_lab.report.remark import Remark

MISFIT = 0.05
"""Root mean square residual, as a part of the force, that calls for a remark."""
BAD_MISFIT = 0.15
DISAGREEMENT = 0.1
"""Difference of the moduli of two records that is spoken of when it also exceeds their errors."""
FEW = 2
"""Points beyond the fitted numbers from which residuals say something."""
UNCERTAIN = 0.25
"""Relative half width of an interval that calls for a remark."""


def residual_remarks(fit: IndentationFit, predicted: Sequence[HeldOut]) -> list[Remark]:
    """Remarks on residuals (of points that were held out, where there are) and touch."""
    remarks = []
    for i, item in enumerate(fit.points):
        smallest = 0.1 * item.force_n.max()
        residual = fit.relative_residuals(i)[item.force_n >= smallest]
        own = [p.relative for p in predicted if p.index == i and p.force_n >= smallest]
        residual = np.array(own) if own else residual
        rms = float(np.sqrt(np.mean(residual**2)))
        if rms > MISFIT:
            error = f"{rms:.1%} (root mean square above a tenth of the largest)"
            advice = "check the radius, the gel's thickness and where the depth is counted from"
            what, grave = f"forces of {item.name}", rms > BAD_MISFIT
            remarks.append(HELDOUT_ERROR(what=what, error=error, advice=advice, grave=grave))
        touch = fit.touch_mm(i)
        if abs(touch) > 0.1 and abs(touch) > 3 * fit.solution.sigma_of(f"touch_{i}"):
            remarks.append(TOUCH_SHIFT(name=item.name, touch_mm=touch))
    return remarks


def records_disagree(fit: IndentationFit, touches_mm: Sequence[float]) -> list[Remark]:
    """Whether single records give unlike moduli: a wrong radius, unit or touch point in one."""
    if len(fit.points) < 2:
        return []
    alone = [
        fit_indentation(
            [item], [table], start_pa=fit.young_modulus_pa, poisson_ratio=fit.poisson_ratio,
            free_nu=False, touch_sigma_mm=touch, profiled=(),
        )
        for item, table, touch in zip(fit.points, fit.tables, touches_mm, strict=True)
    ]  # fmt: skip
    value = np.array([item.solution.value("ln_e") for item in alone])
    sigma = np.array([item.relative_sigma for item in alone])
    middle = float(np.median(value))
    remarks = []
    for item, one, own in zip(fit.points, value, sigma, strict=True):
        others = float(np.min(sigma))
        if abs(one - middle) > max(math.log1p(DISAGREEMENT), 3 * math.hypot(own, others)):
            remarks.append(
                RECORDS_DISAGREE(
                    name=item.name,
                    own_pa=math.exp(one),
                    young_pa=fit.young_modulus_pa,
                    tool=item.tool.description,
                )
            )
    return remarks


def few_degrees_of_freedom(fit: IndentationFit, predicted: Sequence[HeldOut]) -> list[Remark]:
    """Remark that a fit to few points says little, with how far each is from what the
    others predict."""
    count = sum(len(item.depth_mm) for item in fit.points)
    if count - len(fit.solution.names) >= FEW or not predicted:
        return []
    miss = np.array([item.relative for item in predicted])
    inside = sum(a.interval_n[0] <= a.force_n <= a.interval_n[1] for a in predicted)
    return [
        TOO_FEW(
            count=count,
            what=f"points and {len(fit.solution.names)} fitted numbers",
            wanted=f"predicted from the others they are off by {np.sqrt(np.mean(miss**2)):.1%} "
            f"(root mean square; {np.abs(miss).max():.1%} at most; {inside} of {len(predicted)} in "
            "the 95 % interval stated for them). Record eight depths or more",
        )
    ]


def young_uncertain(young: Estimate) -> list[Remark]:
    """Remark that the interval of Young's modulus is wide."""
    low, high = young.interval95
    half = 0.5 * (high - low) / young.value
    if half <= UNCERTAIN:
        return []
    return [YOUNG_UNCERTAIN(half=half, low_pa=low, high_pa=high)]


def friction_assumed(
    fits: Mapping[float, IndentationFit], chosen: float, left: Collection[float]
) -> Remark:
    """Which coefficient of friction the presses were taken to have, and what others would do."""
    found = fits[chosen]
    others = [
        f"with {mu:g}, Young's modulus would be "
        f"{item.young_modulus_pa / found.young_modulus_pa - 1:+.1%} and the residual "
        f"{_rms(item):.1%} instead of {_rms(found):.1%}"
        for mu, item in fits.items()
        if mu != chosen
    ]
    excluded = sorted(set(fits) - set(left))
    text = "; ".join(others)
    if excluded:
        text += f" (the points exclude {', '.join(f'{mu:g}' for mu in excluded)})"
    else:
        text += "; the points do not tell which, so intervals hold for both"
    return FRICTION_ASSUMED(friction=chosen, others=text)


def _rms(fit: IndentationFit) -> float:
    each = [fit.relative_residuals(i) for i in range(len(fit.points))]
    return float(np.sqrt(np.mean(np.concatenate(each) ** 2)))
