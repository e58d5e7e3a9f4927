# SPDX-License-Identifier: Apache-2.0
"""What a user has to know of a material: units that no gel can have, misfit, too few points,
records at odds."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from taccel_lab.calibration.capture.records import FORCE_UNITS
from taccel_lab.calibration.material.gel import IndentationPoints
from taccel_lab.calibration.material.indentation import HeldOut, IndentationFit, fit_indentation
from taccel_lab.calibration.remarks import HELDOUT_ERROR, TOO_FEW, info, warning
from taccel_lab.calibration.result import Estimate
from taccel_lab.errors import InputError
from taccel_lab.presses.bonded_layer import layer_young_modulus_pa
from taccel_lab.printable import counted
from taccel_lab.report.remark import Remark

PLAUSIBLE_PA = (1e4, 1e7)
"""Young's moduli of gels; a fit outside is a fault of units."""
USUAL_PA = (2e4, 2.5e6)
"""Young's moduli that gels of tactile sensors have; used to guess which unit was meant."""
DEPTH_UNITS = {"m": 1e3, "cm": 10.0, "um": 1e-3}
"""Millimetres in one of a unit that depths are recorded in by mistake."""


_SECOND_TOOL = (
    "records of two tools in the same folder, a ball with a radius of at most half of the gel's "
    "thickness, and a flat punch about as wide as the gel is thick or a ball of two to four times "
    "the thickness"
)
"""What separates E and nu (docs/calibration_material.md)."""

# Indentation records.
UNUSUAL_MODULUS = warning(
    "unusual_modulus",
    "{name}: about {modulus_pa:.3g} Pa is unusual for a gel of a tactile sensor ({low_pa:g} to "
    "{high_pa:g} Pa); check units and tool. {guess}",
)

# The fit to indentations.
TOUCH_SHIFT = warning(
    "touch_shift",
    "{name}: first touch lies {touch_mm:+.2f} mm from where the record counts its depth; the fit "
    "allows for it, but look at how touch was detected",
)
RECORDS_DISAGREE = warning(
    "records_disagree",
    "{name} alone gives {own_pa:.4g} Pa, the records together {young_pa:.4g} Pa; check the radius "
    "of {tool}, its units and its touch point",
)
YOUNG_GIVEN_NU = info(
    "young_given_nu",
    "Young's modulus holds for nu = {nu:g}: it is {low_pa:.4g} Pa for {low_nu:g} and "
    "{high_pa:.4g} Pa for {high_nu:g}; its interval is over nu from {least_nu:g} to {most_nu:g}. "
    + _SECOND_TOOL[0].upper()
    + _SECOND_TOOL[1:]
    + " determine nu",
)
YOUNG_UNCERTAIN = warning(
    "young_uncertain",
    "Young's modulus is only known to {half:.0%} ({low_pa:.3g} to {high_pa:.3g} Pa); record more "
    "depths, and deeper ones, or a second tool",
)
FRICTION_ASSUMED = warning(
    "friction_assumed",
    "friction is not measured: the presses fit best with a coefficient of {friction:g}, which is "
    "what the profile now says and what presses of it take; {others}. Give it with --fix friction=",
)

MISFIT = 0.05
"""Root mean square residual, as a part of the force, that calls for a remark."""
BAD_MISFIT = 0.15
DISAGREEMENT = 0.1
"""Difference of the moduli of two records that is spoken of when it also exceeds their errors."""
FEW = 2
"""Points beyond the fitted numbers from which residuals say something."""
UNCERTAIN = 0.25
"""Relative half width of an interval that calls for a remark."""


def require_plausible(
    points: Sequence[IndentationPoints], thickness_mm: float, poisson_ratio: float
) -> tuple[float, list[Remark]]:
    """Young's modulus of all points by the closed form [Pa]; refuses what no gel can be.

    Raises:
        InputError: A modulus outside 1e4 to 1e7 Pa, with the unit that would fit.
    """
    moduli, remarks = [], []
    for item in points:
        modulus = _linear_modulus_pa(item, 1.0, thickness_mm, poisson_ratio)
        low, high = PLAUSIBLE_PA
        if not low <= modulus <= high:
            raise InputError(
                f"{item.source}: forces and depths give Young's modulus of {modulus:.3g} Pa; gels "
                f"have {low:g} to {high:g} Pa. {_guess(item, thickness_mm, poisson_ratio)}"
            )
        if not USUAL_PA[0] <= modulus <= USUAL_PA[1]:
            remarks.append(
                UNUSUAL_MODULUS(
                    name=item.name,
                    modulus_pa=modulus,
                    low_pa=USUAL_PA[0],
                    high_pa=USUAL_PA[1],
                    guess=_guess(item, thickness_mm, poisson_ratio),
                )
            )
        moduli.append(modulus)
    return float(np.exp(np.mean(np.log(moduli)))), remarks


def _linear_modulus_pa(
    item: IndentationPoints, depth_factor: float, thickness_mm: float, poisson_ratio: float
) -> float:
    tool = item.tool
    depth = item.depth_mm * depth_factor
    if tool.kind == "sphere":
        depth = np.minimum(depth, 0.9 * tool.radius_mm)
    return layer_young_modulus_pa(
        tool.kind, depth, item.force_n, tool.radius_mm, thickness_mm, poisson_ratio
    )


def _guess(item: IndentationPoints, thickness_mm: float, poisson_ratio: float) -> str:
    """Which units would give a usual gel, in words."""
    modulus = _linear_modulus_pa(item, 1.0, thickness_mm, poisson_ratio)
    fits = [
        f"force in {unit} ({modulus * factor:.2g} Pa)"
        for unit, factor in FORCE_UNITS.items()
        if USUAL_PA[0] <= modulus * factor <= USUAL_PA[1]
    ]
    for unit, factor in DEPTH_UNITS.items():
        if item.deepest_mm * factor <= 0.75 * thickness_mm:
            changed = _linear_modulus_pa(item, factor, thickness_mm, poisson_ratio)
            if USUAL_PA[0] <= changed <= USUAL_PA[1]:
                fits.append(f"depth in {unit} ({changed:.2g} Pa)")
    if not fits:
        return "No common mistake of units explains it; check the tool's radius and the thickness"
    return f"What would fit: {', or '.join(fits)}"


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
            found=f"{counted(count, 'point')} and "
            f"{counted(len(fit.solution.names), 'fitted number')}",
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
