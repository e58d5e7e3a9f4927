# SPDX-License-Identifier: Apache-2.0
"""What a user has to know of a fit to indentations: misfit, too few points, records at odds."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from taccel_lab.calibration.material.indentation import IndentationFit, fit_indentation
from taccel_lab.calibration.material.predicted_forces import HeldOut
from taccel_lab.calibration.result import Estimate, Remark, Severity

MISFIT = 0.05
"""Root mean square residual, as a part of the force, that calls for a remark."""
BAD_MISFIT = 0.15
DISAGREEMENT = 0.1
"""Difference of the moduli of two records that is spoken of when it also exceeds their errors."""
FEW = 2
"""Points beyond the fitted numbers from which residuals say something."""
TOUCH_SAID_MM = 0.005
"""Shift of first touch from which it is said where presses reproduce a record."""
UNCERTAIN = 0.25
"""Relative half width of an interval that calls for a remark."""
WANTED_SIGMA = 0.02
"""Relative standard deviation of Young's modulus that a calibration is after."""
CORRELATED = 0.9
"""Correlation of two parameters from which one is hardly known without the other."""


def young_with_nu(fit: IndentationFit) -> list[Remark]:
    """That E is uncertain because nu is, and which second tool would separate them."""
    names = fit.solution.names
    sigma = fit.solution.sigma_of("ln_e")
    if "nu" not in names or sigma <= WANTED_SIGMA:
        return []
    correlation = float(fit.solution.correlation[names.index("ln_e"), names.index("nu")])
    if abs(correlation) < CORRELATED:
        return []
    return [
        Remark(
            Severity.INFO,
            "young_with_nu",
            f"Young's modulus is known only together with Poisson's ratio (correlation "
            f"{correlation:+.3f}) and is uncertain by {sigma:.0%} for that; "
            f"{SECOND_TOOL}, or nu held with --fix nu=..., gives it to about 1 %",
        )
    ]


SECOND_TOOL = (
    "records of two tools in the same folder, a ball with a radius of at most half of the gel's "
    "thickness, and a flat punch about as wide as the gel is thick or a ball of two to four times "
    "the thickness"
)
"""What separates E and nu (docs/calibration_material.md)."""


def residual_remarks(fit: IndentationFit, predicted: Sequence[HeldOut]) -> list[Remark]:
    """Remarks on residuals (of points that were held out, where there are), noise and touch."""
    remarks = []
    for i, item in enumerate(fit.points):
        smallest = 0.1 * item.force_n.max()
        residual = fit.relative_residuals(i)[item.force_n >= smallest]
        own = [p.relative for p in predicted if p.index == i and p.force_n >= smallest]
        residual = np.array(own) if own else residual
        rms = float(np.sqrt(np.mean(residual**2)))
        if rms > MISFIT:
            remarks.append(
                Remark(
                    Severity.ERROR if rms > BAD_MISFIT else Severity.WARNING,
                    "law_misfit",
                    f"{item.name}: the simulated curve misses forces that it was not fitted to by "
                    f"{rms:.1%} (root mean square above a tenth of the largest); check the radius, "
                    "the gel's thickness and where the depth is counted from",
                )
            )
        touch = fit.touch_mm(i)
        if abs(touch) > TOUCH_SAID_MM:
            low, high = fit.touch_interval_mm(i)
            remarks.append(
                Remark(
                    Severity.INFO,
                    "press_depth",
                    f"{item.name}: a press of the profile gives its forces at depths "
                    f"{abs(touch):.3f} mm {'larger' if touch < 0 else 'smaller'} than recorded: "
                    f"first touch lies {touch:+.3f} mm from the record's zero "
                    f"({low:+.3f} to {high:+.3f})",
                )
            )
        if abs(touch) > 0.1 and abs(touch) > 3 * fit.solution.sigma_of(f"touch_{i}"):
            remarks.append(
                Remark(
                    Severity.WARNING,
                    "touch_shift",
                    f"{item.name}: first touch lies {touch:+.2f} mm from where the record counts "
                    "its depth; the fit allows for it, but look at how touch was detected",
                )
            )
    remarks += young_with_nu(fit)
    if fit.solution.misfit and fit.solution.chi2_per_dof is not None:
        remarks.append(
            Remark(
                Severity.WARNING,
                "noise_understated",
                f"residuals are {math.sqrt(fit.solution.chi2_per_dof):.1f} times the stated noise "
                "of the forces; intervals are widened to match",
            )
        )
    return remarks


def records_disagree(fit: IndentationFit, touches_mm: Sequence[float]) -> list[Remark]:
    """Whether single records give unlike moduli: a wrong radius, unit or touch point in one."""
    if len(fit.points) < 2:
        return []
    alone = [
        fit_indentation(
            [item], [table], start_pa=fit.young_modulus_pa, poisson_ratio=fit.poisson_ratio,
            mooney_ratio=fit.mooney_ratio, free_nu=False, touch_sigma_mm=touch, profiled=(),
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
                Remark(
                    Severity.WARNING,
                    "records_disagree",
                    f"{item.name} alone gives {math.exp(one):.4g} Pa, the records together "
                    f"{fit.young_modulus_pa:.4g} Pa; check the radius of {item.tool.description}, "
                    "its units and its touch point",
                )
            )
    return remarks


def few_points(fit: IndentationFit, predicted: Sequence[HeldOut]) -> list[Remark]:
    """That a fit meets few points says little; how far each is from what the others predict."""
    count = sum(len(item.depth_mm) for item in fit.points)
    if count - len(fit.solution.names) >= FEW or not predicted:
        return []
    miss = np.array([item.relative for item in predicted])
    inside = sum(a.interval_n[0] <= a.force_n <= a.interval_n[1] for a in predicted)
    return [
        Remark(
            Severity.WARNING,
            "few_points",
            f"{count} points and {len(fit.solution.names)} fitted numbers: how close the fit comes "
            f"to them says little. Predicted from the others, points are off by "
            f"{np.sqrt(np.mean(miss**2)):.1%} (root mean square; {np.abs(miss).max():.1%} at most; "
            f"{inside} of {len(predicted)} in the 95 % interval stated for them). Record eight "
            "depths or more",
        )
    ]


def young_uncertain(young: Estimate) -> list[Remark]:
    """That the interval of Young's modulus is wide."""
    low, high = young.interval95
    half = 0.5 * (high - low) / young.value
    if half <= UNCERTAIN:
        return []
    return [
        Remark(
            Severity.WARNING,
            "young_uncertain",
            f"Young's modulus is only known to {half:.0%} ({low:.3g} to {high:.3g} Pa); record "
            "more depths, and deeper ones, or a second tool",
        )
    ]


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
    return Remark(
        Severity.WARNING,
        "friction_assumed",
        f"friction is not measured: the presses fit best with a coefficient of {chosen:g}, which "
        f"is what the profile now says and what presses of it take; {text}. Record a slide",
    )


def _rms(fit: IndentationFit) -> float:
    each = [fit.relative_residuals(i) for i in range(len(fit.points))]
    return float(np.sqrt(np.mean(np.concatenate(each) ** 2)))
