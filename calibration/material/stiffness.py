# SPDX-License-Identifier: Apache-2.0
"""Stiffness from indentations: what they determine is fitted, the rest is held and varied.

A held value (Poisson's ratio that the records do not determine, unmeasured friction) is one
of many that fit: intervals of Young's modulus and of forces are those over all of them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from taccel_lab.calibration.material.force_table import ForceTable
from taccel_lab.calibration.material.gel import IndentationPoints
from taccel_lab.calibration.material.indentation import (
    GEL_NU,
    LAW_NAMES,
    HeldOut,
    IndentationFit,
    fit_indentation,
    force_interval_n,
    held_out,
    touch_sigma,
)
from taccel_lab.calibration.material.likelihood import hull
from taccel_lab.calibration.material.remarks import (
    YOUNG_GIVEN_NU,
    few_degrees_of_freedom,
    friction_assumed,
    records_disagree,
    residual_remarks,
    young_uncertain,
)
from taccel_lab.calibration.result import Estimate
from taccel_lab.report.remark import Remark
from taccel_lab.with_error import NORMAL_95

USUAL_NU = (0.45, 0.495)
"""Poisson's ratios of most gels, over which an unknown one is varied to say what it does to E."""
PREDICTED = 5
"""Depths of each tool at which a predicted force is reported."""
UNLIKELY = 3.84
"""Q above the least one from which a coefficient of friction is excluded by the points."""


@dataclass(frozen=True)
class Predicted:
    """What a tool is predicted to feel at a depth."""

    depth_mm: float
    press_n: float
    """Force of a press of the profile so far past first touch."""
    press_interval95_n: tuple[float, float]
    reading_n: float
    """Force of a reading where the record, whose zero may be off, calls the depth this."""
    reading_interval95_n: tuple[float, float]


@dataclass(frozen=True)
class Stiffness:
    """What indentations say."""

    fit: IndentationFit
    """What the records determine is free, the rest held: the values that a profile takes."""
    profiled: IndentationFit
    """Everything free, for the profiles."""
    open_fits: tuple[IndentationFit, ...]
    """Everything free that the data leave open, one for each coefficient of friction they do."""
    friction: float
    """Coefficient in the presses of ``fit``."""
    young: Estimate
    nu: Estimate | None
    held_out: tuple[HeldOut, ...]
    remarks: tuple[Remark, ...]

    def figures(self) -> dict[str, Any]:
        """Everything measured, ready for JSON."""
        fit = self.fit
        return {
            "indentation": [
                {
                    "name": item.name,
                    "tool": item.tool.description,
                    "depth_mm": item.depth_mm,
                    "force_n": item.force_n,
                    "fitted_n": fit.predicted_n(i, item.depth_mm),
                    "relative_residual": fit.relative_residuals(i),
                    "touch_mm": fit.touch_mm(i),
                    "touch_interval95_mm": fit.touch_interval_mm(i),
                    "predicted": [vars(item) for item in self.predicted(i)],
                }
                for i, item in enumerate(fit.points)
            ],
            "held_out": [
                {
                    "name": fit.points[item.index].name,
                    "depth_mm": item.depth_mm,
                    "force_n": item.force_n,
                    "predicted_n": item.predicted_n,
                    "interval95_n": item.interval_n,
                    "relative": item.relative,
                }
                for item in self.held_out
            ],
            "noise": {
                "kind": fit.noise,
                "scale": fit.solution.noise,
                "chi2_per_dof": fit.solution.chi2_per_dof,
                "model_relative": fit.model_errors["ln_e"],
            },
            "simulated": {
                "presses": sum(table.press_count for table in fit.tables),
                "seconds": sum(table.seconds for table in fit.tables),
                "interpolation_relative": max(t.error.interpolation for t in fit.tables),
            },
            "profiles": {
                name: {
                    "values": profile.values,
                    "excess": profile.excess,
                    "threshold": profile.threshold,
                    "interval": profile.interval,
                    "open": [profile.open_low, profile.open_high],
                }
                for name, profile in self.profiled.solution.profiles.items()
                if name in LAW_NAMES
            },
        }

    def residuals(self) -> dict[str, float]:
        """What the fit leaves over, as parts of the forces above a tenth of the largest; of points
        that were held out first."""
        fit, found = self.fit, {}
        least = [0.1 * item.force_n.max() for item in fit.points]
        miss = np.array([abs(p.relative) for p in self.held_out if p.force_n >= least[p.index]])
        if len(miss):
            found["indentation_held_out_worst_relative"] = float(miss.max())
            found["indentation_held_out_rms_relative"] = float(np.sqrt(np.mean(miss**2)))
        each = [
            fit.relative_residuals(i)[item.force_n >= least[i]] for i, item in enumerate(fit.points)
        ]
        found["indentation_worst_relative"] = max(float(abs(r).max()) for r in each)
        found["indentation_rms_relative"] = max(float(np.sqrt(np.mean(r**2))) for r in each)
        return found

    def valid_region(self) -> dict[str, tuple[float, float]]:
        """Depths and forces of the points."""
        depths = np.concatenate([item.depth_mm for item in self.fit.points])
        forces = np.concatenate([item.force_n for item in self.fit.points])
        return {
            "depth_mm": (depths.min(), depths.max()),
            "force_n": (forces.min(), forces.max()),
        }

    def correlation(self) -> dict[str, float]:
        """Correlation of the law's parameters, by their names in the block; none where nu is
        held."""
        solution = self.fit.solution
        if "nu" not in solution.names:
            return {}
        i, j = map(solution.names.index, LAW_NAMES)
        return {"young_modulus_pa*poisson_ratio": float(solution.correlation[i, j])}

    def predicted(self, index: int) -> list[Predicted]:
        """Forces of the tool of a record at depths up to its deepest."""
        fit = self.fit
        depths = fit.points[index].deepest_mm * np.linspace(0.2, 1.0, PREDICTED)
        forces = fit.tables[index].force_n(depths, fit.young_modulus_pa, fit.poisson_ratio)
        return [
            Predicted(
                depth,
                float(force),
                self.force_interval_n(index, depth),
                float(fit.predicted_n(index, np.array([depth]))[0]),
                self.force_interval_n(index, depth, reading=True),
            )
            for depth, force in zip(depths.tolist(), forces, strict=True)
        ]

    def force_interval_n(
        self, index: int, depth_mm: float, *, reading: bool = False
    ) -> tuple[float, float]:
        """95 % interval of the force [N] of a press of tool ``index`` past first touch, or of a
        ``reading`` at a depth as its record counts it."""
        return hull(
            force_interval_n(fit, index, depth_mm, recorded=reading, reading=reading)
            for fit in self.open_fits
        )


def fit_stiffness(
    points: Sequence[IndentationPoints],
    tables: Mapping[float, Sequence[ForceTable]],
    *,
    poisson_ratio: float,
    free_nu: bool,
    start_pa: float,
    touch_sigma_mm: float | None = None,
) -> Stiffness:
    """Fit Young's modulus and what else of the law the points determine.

    Args:
        points: Presses.
        tables: Simulated forces of each press, by the coefficient of friction in them; where there
            are several, the points choose, and those that they do not exclude widen intervals.
        poisson_ratio: Of the base, kept where it is not free or the points do not tell it.
        free_nu: Whether the points may tell another one.
        start_pa: Young's modulus to begin with [Pa].
        touch_sigma_mm: How well first touch is known; by the number of points when None.
    """
    touches = [touch_sigma(item, touch_sigma_mm) for item in points]

    def fit(
        mu: float,
        nu: bool,
        at: float = poisson_ratio,
        within: tuple[float, float] | None = None,
        keep: Sequence[np.ndarray] | None = None,
        profiled: Sequence[str] | None = (),
        drawn: bool = False,
    ) -> IndentationFit:
        kept = points if keep is None else [p.only(k) for p, k in zip(points, keep, strict=True)]
        return fit_indentation(
            kept, tables[mu], start_pa=start_pa, poisson_ratio=at, free_nu=nu, nu_range=within,
            touch_sigma_mm=touches, profiled=profiled, drawn=drawn,
        )  # fmt: skip

    remarks: list[Remark] = []
    likeliest = min(tables, key=lambda mu: fit(mu, free_nu).misfit)
    free = fit(likeliest, free_nu, profiled=None, drawn=True)
    profiles = free.solution.profiles
    nu_determined = free_nu and profiles["nu"].closed
    held = poisson_ratio
    if free_nu and not nu_determined:
        # The base's, moved into the interval where the data exclude it.
        held = min(max(held, profiles["nu"].interval[0]), profiles["nu"].interval[1])
    if not nu_determined:
        # What the profile will hold decides which friction belongs to it.
        likeliest = min(tables, key=lambda mu: fit(mu, False, held).misfit)
    found = fit(likeliest, nu_determined, held, profiled=None)
    # Gels have no other Poisson's ratio, unless the base profile says so.
    within = None if nu_determined else (min(GEL_NU[0], held), max(GEL_NU[1], held))

    def open_fit(mu: float, keep: Sequence[np.ndarray] | None = None) -> IndentationFit:
        only = ("ln_e",) if keep is None else ()
        return fit(mu, free_nu, held, within, keep, only)

    candidates = {mu: open_fit(mu) for mu in tables}
    least = min(item.misfit for item in candidates.values())
    left = {mu: item for mu, item in candidates.items() if item.misfit <= least + UNLIKELY}
    left[likeliest] = candidates[likeliest]

    def refit(keep: Sequence[np.ndarray]) -> tuple[IndentationFit, list[IndentationFit]]:
        return (
            fit(likeliest, nu_determined, held, keep=keep),
            [open_fit(mu, keep) for mu in left],
        )

    predicted = held_out(found, refit)
    remarks += residual_remarks(found, predicted)
    remarks += few_degrees_of_freedom(found, predicted)
    remarks += records_disagree(found, touches)
    if free_nu and not nu_determined:
        low, high = (fit(likeliest, False, nu).young_modulus_pa for nu in USUAL_NU)
        remarks.append(
            YOUNG_GIVEN_NU(
                nu=found.poisson_ratio,
                low_pa=low,
                low_nu=USUAL_NU[0],
                high_pa=high,
                high_nu=USUAL_NU[1],
                least_nu=GEL_NU[0],
                most_nu=GEL_NU[1],
            )
        )
    young = _young(found, list(left.values()))
    remarks += young_uncertain(young)
    if len(tables) > 1:
        remarks.append(
            friction_assumed(
                {mu: fit(mu, nu_determined, held) for mu in tables},
                likeliest,
                set(left),
            )
        )
    return Stiffness(
        fit=found,
        profiled=free,
        open_fits=tuple(left.values()),
        friction=likeliest,
        young=young,
        nu=_poisson(found) if nu_determined else None,
        held_out=predicted,
        remarks=tuple(remarks),
    )


def _poisson(fit: IndentationFit) -> Estimate:
    (low, high), bounds = fit.interval_of("nu"), fit.bounds_of("nu")
    interval = max(low, bounds[0]), min(high, bounds[1])
    return Estimate(fit.poisson_ratio, fit.sigma_of("nu"), "", interval)


def _young(found: IndentationFit, left: Sequence[IndentationFit]) -> Estimate:
    """Young's modulus with the interval over all that is left open [Pa]."""
    low, high = hull(item.young_interval_pa for item in (found, *left))
    value = found.young_modulus_pa
    return Estimate(value, value * math.log(high / low) / (2 * NORMAL_95), "Pa", (low, high))
