# SPDX-License-Identifier: Apache-2.0
"""Stiffness from indentations: what they tell is fitted, what they leave open is held and varied.

A held value (Poisson's ratio that the records do not tell, friction that no record told) is one
of many that fit: intervals of Young's modulus and of forces are those over all of them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.material.agreement import (
    SECOND_TOOL,
    few_points,
    friction_assumed,
    records_disagree,
    residual_remarks,
    young_unsure,
)
from taccel_lab.calibration.material.indentation import (
    GEL_NU,
    IndentationFit,
    fit_indentation,
    touch_sigma,
)
from taccel_lab.calibration.material.likelihood import Profile, Solution
from taccel_lab.calibration.material.points import IndentationPoints
from taccel_lab.calibration.material.prediction import HeldOut, force_interval_n, held_out
from taccel_lab.calibration.material.response import ForceTable
from taccel_lab.calibration.result import NORMAL_95, Estimate, Remark, Severity

USUAL_NU = (0.45, 0.495)
"""Poisson's ratios of most gels, over which an untold one is varied to say what it does to E."""
UNLIKELY = 3.84
"""Q above the least one from which a coefficient of friction is excluded by the points."""


@dataclass(frozen=True)
class Law:
    """What is known of the law before the indentations."""

    poisson_ratio: float
    mooney_ratio: float
    free_nu: bool
    free_ratio: bool
    told_nu: Estimate | None = None
    """Poisson's ratio that other records told."""


@dataclass(frozen=True)
class Stiffness:
    """What indentations say."""

    fit: IndentationFit
    """What is told is free, the rest held: the values that a profile takes."""
    profiled: IndentationFit
    """Everything free, for the profiles."""
    open_fits: tuple[IndentationFit, ...]
    """Everything free that the data leave open, one for each coefficient of friction they do."""
    friction: float
    """Coefficient in the presses of ``fit``."""
    young: Estimate
    nu: Estimate | None
    ratio: Estimate | None
    held_out: tuple[HeldOut, ...]
    remarks: tuple[Remark, ...]

    def force_interval_n(self, index: int, depth_mm: float) -> tuple[float, float]:
        """95 % interval of the force [N] of a press of tool ``index`` past first touch."""
        ends = [force_interval_n(fit, index, depth_mm, recorded=False) for fit in self.open_fits]
        return min(low for low, _ in ends), max(high for _, high in ends)

    def reading_interval_n(self, index: int, depth_mm: float) -> tuple[float, float]:
        """95 % interval of a reading [N] at a depth as record ``index`` counts it."""
        ends = [force_interval_n(fit, index, depth_mm, reading=True) for fit in self.open_fits]
        return min(low for low, _ in ends), max(high for _, high in ends)


def fit_stiffness(
    points: Sequence[IndentationPoints],
    tables: Mapping[float, Sequence[ForceTable]],
    law: Law,
    *,
    start_pa: float,
    touch_sigma_mm: float | None = None,
) -> Stiffness:
    """Fit Young's modulus and what else of the law the points tell.

    Args:
        points: Presses.
        tables: Simulated forces of each press, by the coefficient of friction in them; where there
            are several, the points choose, and those that they do not exclude widen intervals.
        law: What is known of the law.
        start_pa: Young's modulus to begin with [Pa].
        touch_sigma_mm: How well first touch is known; by the number of points when None.
    """
    touches = [touch_sigma(item, touch_sigma_mm) for item in points]

    def fit(
        mu: float,
        nu: bool,
        ratio: bool,
        at: float = law.poisson_ratio,
        within: tuple[float, float] | None = None,
        keep: Sequence[np.ndarray] | None = None,
        profiled: Sequence[str] | None = (),
        drawn: bool = False,
    ) -> IndentationFit:
        kept = points if keep is None else [p.only(k) for p, k in zip(points, keep, strict=True)]
        return fit_indentation(
            kept, tables[mu], start_pa=start_pa, poisson_ratio=at, mooney_ratio=law.mooney_ratio,
            free_nu=nu, free_ratio=ratio, nu_range=within, touch_sigma_mm=touches,
            profiled=profiled, drawn=drawn,
        )  # fmt: skip

    remarks: list[Remark] = []
    likeliest = min(tables, key=lambda mu: fit(mu, law.free_nu, law.free_ratio).misfit)
    free = fit(likeliest, law.free_nu, law.free_ratio, profiled=None, drawn=True)
    profiles = free.solution.profiles
    tells_nu = law.free_nu and not _untold(profiles["nu"])
    tells_ratio = law.free_ratio and not _untold(profiles["mooney_ratio"])
    held = law.poisson_ratio
    if law.free_nu and not tells_nu:
        remarks.append(_untold_remark(profiles["nu"], "nu", free.tables[0].nu_range))
        held, said = _held_nu(profiles["nu"], held)
        remarks += said
    if law.free_ratio and not tells_ratio:
        remarks.append(_untold_remark(profiles["mooney_ratio"], "mooney_ratio", (0.0, 1.0)))
    if not tells_nu:
        # What the profile will hold decides which friction goes with it.
        likeliest = min(tables, key=lambda mu: fit(mu, False, tells_ratio, held).misfit)
    found = fit(likeliest, tells_nu, tells_ratio, held, profiled=None)
    # Gels have no other Poisson's ratio, unless the base profile or other records say so.
    within = (min(GEL_NU[0], held), max(GEL_NU[1], held))
    if law.told_nu is not None:
        within = law.told_nu.interval95
    if tells_nu:
        within = None
    vary = law.free_nu or law.told_nu is not None

    def open_fit(mu: float, keep: Sequence[np.ndarray] | None = None) -> IndentationFit:
        only = ("ln_e",) if keep is None else ()
        return fit(mu, vary, law.free_ratio, held, within, keep, only)

    candidates = {mu: open_fit(mu) for mu in tables}
    least = min(item.misfit for item in candidates.values())
    left = {mu: item for mu, item in candidates.items() if item.misfit <= least + UNLIKELY}
    left[likeliest] = candidates[likeliest]

    def refit(keep: Sequence[np.ndarray]) -> tuple[IndentationFit, list[IndentationFit]]:
        return (
            fit(likeliest, tells_nu, tells_ratio, held, keep=keep),
            [open_fit(mu, keep) for mu in left],
        )

    predicted = held_out(found, refit)
    remarks += residual_remarks(found, predicted)
    remarks += few_points(found, predicted)
    remarks += records_disagree(found, touches)
    if law.free_nu and not tells_nu:
        low, high = (fit(likeliest, False, tells_ratio, nu).young_modulus_pa for nu in USUAL_NU)
        remarks.append(_young_given_nu(found, low, high))
    young = _young(found, list(left.values()))
    remarks += young_unsure(young)
    if len(tables) > 1:
        remarks.append(
            friction_assumed(
                {mu: fit(mu, tells_nu, tells_ratio, held) for mu in tables}, likeliest, set(left)
            )
        )
    solution = found.solution
    return Stiffness(
        fit=found,
        profiled=free,
        open_fits=tuple(left.values()),
        friction=likeliest,
        young=young,
        nu=_told(found.poisson_ratio, "nu", solution) if tells_nu else None,
        ratio=_told(found.mooney_ratio, "mooney_ratio", solution) if tells_ratio else None,
        held_out=predicted,
        remarks=tuple(remarks),
    )


def _told(value: float, name: str, solution: Solution) -> Estimate:
    return Estimate(value, solution.sigma_of(name), "", solution.profiles[name].interval)


def _untold(profile: Profile) -> bool:
    return profile.open_low or profile.open_high


def _young(found: IndentationFit, left: Sequence[IndentationFit]) -> Estimate:
    """Young's modulus with the interval over all that is left open [Pa]."""
    ends = [found.young_interval_pa, *(item.young_interval_pa for item in left)]
    low, high = min(a for a, _ in ends), max(b for _, b in ends)
    value = found.young_modulus_pa
    return Estimate(value, value * math.log(high / low) / (2 * NORMAL_95), "Pa", (low, high))


def _untold_remark(profile: Profile, name: str, bounds: tuple[float, float]) -> Remark:
    low, high = profile.interval
    title = {"nu": "Poisson's ratio", "mooney_ratio": "the Mooney ratio"}[name]
    if profile.open_low and profile.open_high:
        text = f"the records do not tell {title} (any from {bounds[0]:g} to {bounds[1]:g} fits)"
    elif profile.open_high:
        text = f"the records only tell that {title} is above {low:.3g}"
    else:
        text = f"the records only tell that {title} is below {high:.3g}"
    return Remark(Severity.INFO, f"{name}_untold", f"{text}; it is held, not calibrated")


def _held_nu(profile: Profile, base: float) -> tuple[float, list[Remark]]:
    """The base's Poisson's ratio, moved into the interval where the data exclude it."""
    low, high = profile.interval
    held = min(max(base, low), high)
    if held == base:
        return base, []
    return held, [
        Remark(
            Severity.WARNING,
            "nu_excluded",
            f"nu = {base:g} of the base profile lies outside the interval {low:.3g} to "
            f"{high:.3g} that the records leave; {held:.3g} is used",
        )
    ]


def _young_given_nu(found: IndentationFit, low: float, high: float) -> Remark:
    return Remark(
        Severity.INFO,
        "young_given_nu",
        f"Young's modulus holds for nu = {found.poisson_ratio:g}: it is {low:.4g} Pa for "
        f"{USUAL_NU[0]:g} and {high:.4g} Pa for {USUAL_NU[1]:g}; its interval is over nu from "
        f"{GEL_NU[0]:g} to {GEL_NU[1]:g}. Nu is told by {SECOND_TOOL}",
    )
