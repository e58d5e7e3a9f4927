# SPDX-License-Identifier: Apache-2.0
"""Whether records agree with one another and with the law, and what they say together."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np

from taccel_lab.calibration.capture import CaptureFolder
from taccel_lab.calibration.capture.schema import ToolEntry
from taccel_lab.calibration.material.flow import FlowFit
from taccel_lab.calibration.material.indentation import IndentationFit, fit_indentation
from taccel_lab.calibration.material.leaning import leaning
from taccel_lab.calibration.material.prediction import HeldOut
from taccel_lab.calibration.material.setup import Gel
from taccel_lab.calibration.material.sliding import SlideFit, combine
from taccel_lab.calibration.material.tangential import TangentialFit
from taccel_lab.calibration.result import NORMAL_95, Estimate, Remark, Severity
from taccel_lab.envs.physics import PressPhysics

MISFIT = 0.05
"""Root mean square residual, as a part of the force, that calls for a remark."""
BAD_MISFIT = 0.15
DISAGREEMENT = 0.1
"""Difference of the moduli of two records that is spoken of when it also exceeds their errors."""
FEW = 2
"""Points beyond the fitted numbers from which residuals say something."""
TOUCH_SAID_MM = 0.005
"""Shift of first touch from which it is said where presses reproduce a record."""
UNSURE = 0.25
"""Relative half width of an interval that calls for a remark."""
LEANING_ERROR = 0.02
"""Relative error of the correction of a ball's leaning: steady state and mesh."""


WANTED_SIGMA = 0.02
"""Relative standard deviation of Young's modulus that a calibration is after."""
TOGETHER = 0.9
"""Correlation of two parameters from which one is hardly told without the other."""


def together_remark(fit: IndentationFit) -> list[Remark]:
    """That E is uncertain because nu is, and which second tool would tell them apart."""
    names = fit.solution.names
    sigma = fit.solution.sigma_of("ln_e")
    if "nu" not in names or sigma <= WANTED_SIGMA:
        return []
    correlation = float(fit.solution.correlation[names.index("ln_e"), names.index("nu")])
    if abs(correlation) < TOGETHER:
        return []
    return [
        Remark(
            Severity.INFO,
            "young_with_nu",
            f"Young's modulus is told only together with Poisson's ratio (correlation "
            f"{correlation:+.3f}) and is uncertain by {sigma:.0%} for that; "
            f"{SECOND_TOOL}, or nu held with --fix nu=..., tells it to about 1 %",
        )
    ]


SECOND_TOOL = (
    "records of two tools in the same folder, a ball with a radius of at most half of the gel's "
    "thickness, and a flat punch about as wide as the gel is thick or a ball of two to four times "
    "the thickness"
)
"""What tells E and nu apart (docs/calibration_material.md)."""


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
    remarks += together_remark(fit)
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


def young_unsure(young: Estimate) -> list[Remark]:
    """That the interval of Young's modulus is wide."""
    low, high = young.interval95
    half = 0.5 * (high - low) / young.value
    if half <= UNSURE:
        return []
    return [
        Remark(
            Severity.WARNING,
            "young_unsure",
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


def friction_of(
    gel: Gel,
    folder: CaptureFolder,
    slides: Sequence[SlideFit],
    tangential: Sequence[TangentialFit],
    flows: Sequence[FlowFit],
    young: Estimate | None,
    poisson_ratio: float,
    mooney_ratio: float,
    physics: PressPhysics,
    progress: Callable[[int, int], None] | None,
) -> tuple[Estimate | None, list[Remark]]:
    """One coefficient from slides, shear, twist and marker flow; None where none tells it."""
    found: list[tuple[str, float, float]] = []
    remarks: list[Remark] = []
    slid = [fit for fit in slides if fit.slid]
    if slid:
        ratio, said = combine(slid)
        remarks += said
        entry = next(r.entry.tool for r in folder.records if r.source == slid[0].source)
        mean, sigma, said = _of_slide(
            gel, folder, entry, slid, ratio, young, poisson_ratio, mooney_ratio, physics, progress
        )
        remarks += said
        found.append(("slides", mean, sigma))
    for fit in tangential:
        if fit.friction_told:
            found.append((fit.name, fit.friction, fit.friction * fit.relative_sigma))
    for fit in flows:
        if fit.friction_told:
            found.append((fit.name, fit.friction, fit.friction * fit.relative_sigma))
    if not found:
        return None, remarks
    value = np.array([item[1] for item in found])
    sigma = np.array([max(item[2], 1e-6) for item in found])
    weight = sigma**-2
    mean = float(weight @ value / weight.sum())
    error = float(weight.sum() ** -0.5)
    if len(found) > 1:
        scatter = float(weight @ (value - mean) ** 2 / (len(found) - 1))
        error *= math.sqrt(max(scatter, 1.0))
        if scatter > 6 and np.ptp(value) > 0.15 * mean:
            each = ", ".join(f"{name} {v:.3g}" for name, v, _ in found)
            remarks.append(
                Remark(
                    Severity.WARNING,
                    "friction_disagrees",
                    f"records disagree on friction ({each}); speed, load or a coating that wears "
                    "may differ. Their weighted mean is used, its error widened",
                )
            )
    half = NORMAL_95 * error
    # Two digits: presses with it are simulated, and the profile says what they had.
    stated = float(f"{mean:.2g}")
    return Estimate(stated, error, "", (max(mean - half, 0.0), mean + half)), remarks


def _of_slide(
    gel: Gel,
    folder: CaptureFolder,
    entry: ToolEntry,
    slides: Sequence[SlideFit],
    ratio: Estimate,
    young: Estimate | None,
    poisson_ratio: float,
    mooney_ratio: float,
    physics: PressPhysics,
    progress: Callable[[int, int], None] | None,
) -> tuple[float, float, list[Remark]]:
    """Coefficient and error of slides, freed of the ball's leaning on the gel."""
    if entry.kind != "sphere":
        return ratio.value, ratio.sigma, []
    if entry.radius_mm is None and folder.ball_radius_mm is None:
        note = "the radius of the sliding ball is not stated"
    else:
        tool = gel.tool(entry, folder.ball_radius_mm)
        load = float(np.mean([np.mean(fit.normal_range_n) for fit in slides]))
        modulus = young.value if young is not None else gel.material.young_modulus_pa
        lean = leaning(
            gel, tool, load, ratio.value, modulus, poisson_ratio, mooney_ratio, physics=physics,
            progress=progress,
        )  # fmt: skip
        if lean is not None:
            mu = lean.friction(ratio.value)
            sigma = math.hypot(ratio.sigma * mu / ratio.value, LEANING_ERROR * mu)
            return (
                mu,
                sigma,
                [
                    Remark(
                        Severity.INFO,
                        "ball_leans",
                        f"tangential over normal force is {ratio.value:.3g} while the ball slides; "
                        f"simulated at {lean.depth_mm:.2g} mm depth, a coefficient of {mu:.3g} "
                        "makes it, since the ball leans on the gel before it",
                    )
                ],
            )
        note = "slides with so much friction do not converge"
    return (
        ratio.value,
        math.hypot(ratio.sigma, 0.08 * ratio.value),
        [
            Remark(
                Severity.WARNING,
                "leaning_unknown",
                f"{note}, so what the ball leans on the gel is not taken off; friction may be up "
                "to 15 % lower than the ratio of the forces. A flat punch does not lean",
            )
        ],
    )


def weighted_mean(estimates: Sequence[Estimate]) -> Estimate | None:
    """Weighted mean; the scatter of the estimates counts where it exceeds their errors."""
    if not estimates:
        return None
    value = np.array([item.value for item in estimates])
    weight = np.array([max(item.sigma, 1e-12) ** -2.0 for item in estimates])
    mean = float(weight @ value / weight.sum())
    sigma = float(weight.sum() ** -0.5)
    if len(value) > 1:
        scatter = float(weight @ (value - mean) ** 2 / (len(value) - 1))
        sigma *= math.sqrt(max(scatter, 1.0))
    low = max(mean - NORMAL_95 * sigma, 0.0)
    return Estimate(mean, sigma, estimates[0].unit, (low, mean + NORMAL_95 * sigma))
