# SPDX-License-Identifier: Apache-2.0
"""Young's modulus and Poisson's ratio from force-depth points.

Each press has a touch point of its own, a nuisance parameter: force sensors and eyes find first
touch to a few hundredths of a millimetre, which at shallow depth is several per cent of the force.

Simulated forces have an error of their mesh, a factor of each tool's. What all tools share of it
moves Young's modulus alone; what they do not share looks like another Poisson's ratio too.
Intervals are widened by what factors of the estimated size, independent of each other or common to
all, do to the fit.

A predicted force takes the place of Young's modulus among the parameters (E = F / f(depth), f being
the force of a gel of 1 Pa) and gets a profile like any other: what first touch, Poisson's ratio and
noise leave open is in its interval, and what they share with the modulus is not counted twice.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from taccel_lab.calibration.material.force_table import ForceTable
from taccel_lab.calibration.material.gel import IndentationPoints
from taccel_lab.calibration.material.likelihood import (
    CurveGroup,
    FittedParameter,
    Likelihood,
    Solution,
    hull,
    widened,
)
from taccel_lab.with_error import NORMAL_95

LAW_NAMES = ("ln_e", "nu")
"""Parameters of the law; the others are of single presses."""
TOUCH_SIGMA_MM = {"sphere": 0.1, "cylinder": 0.05, "flat": 0.05}
"""How well first touch is known where a record has few points [mm]. A ball shows no force at first:
at 0.05 N it is 0.1 to 0.2 mm in the gel, a punch of 3 mm radius a hundredth."""
LOOSE_TOUCH_SIGMA_MM = 0.2
"""The same of a record from which it can be fitted."""
MANY_POINTS = 6
"""Points at different depths from which a record determines its touch point."""
LOOSE_POINTS = 3
"""Points at different depths from which they determine the touch better than the prior does."""
TOUCH_LIMIT_MM = 0.5
SMALL_FORCE = 0.05
"""Noise that grows with the force does not fall below this part of the largest one."""
USUAL_NOISE = 0.015
"""Scatter of readings that is usual, as a part of the force: what a record of few points has,
see ``likelihood``."""
USUAL_COUNT = 2.0
NO_DEPTH_MM = 1e-4
"""A tool that has not touched yet is taken to be this deep."""
GEL_NU = (0.40, 0.499)
"""Poisson's ratios that gels may have: one that records leave open lies here."""
FOLDS = 12
"""Most groups of points that are held out, interleaved; fewer points go one by one."""


@dataclass(frozen=True)
class PressForces:
    """Forces of all presses over the free parameters of a fit."""

    tables: Sequence[ForceTable]
    names: Sequence[str]
    """Names of the parameters: ``ln_e``, ``nu``, ``touch_<i>``, ``zero_<i>``."""
    poisson_ratio: float
    """Where it is not free."""

    def log_force(
        self, theta: np.ndarray, index: int, depth_mm: np.ndarray, recorded: bool = True
    ) -> tuple[np.ndarray, np.ndarray]:
        """ln force of a gel of 1 Pa, shape [point], and its derivatives by the parameters, [point,
        parameter], at depths as a press's record counts them, or from first touch."""
        place = {name: i for i, name in enumerate(self.names)}
        nu = theta[place["nu"]] if "nu" in place else self.poisson_ratio
        touch = place.get(f"touch_{index}") if recorded else None
        depth = depth_mm if touch is None else depth_mm - theta[touch]
        log, by_depth, by_nu = self.tables[index].log_force(np.maximum(depth, NO_DEPTH_MM), nu)
        slopes = np.zeros((len(log), len(theta)))
        if "nu" in place:
            slopes[:, place["nu"]] = by_nu
        if touch is not None:
            slopes[:, touch] = np.where(depth > NO_DEPTH_MM, -by_depth, 0.0)
        return log, slopes

    def residuals(
        self,
        theta: np.ndarray,
        points: Sequence[IndentationPoints],
        weights: Sequence[np.ndarray],
    ) -> tuple[np.ndarray, np.ndarray]:
        """Force less measured force over weight, of all points, and the derivatives."""
        e = self.names.index("ln_e")
        residuals, rows = [], []
        for i, (item, weight) in enumerate(zip(points, weights, strict=True)):
            log, slopes = self.log_force(theta, i, item.depth_mm)
            slopes[:, e] = 1.0
            force = np.exp(theta[e] + log)
            slopes *= force[:, None]
            if f"zero_{i}" in self.names:
                zero = self.names.index(f"zero_{i}")
                force = force + theta[zero]
                slopes[:, zero] = 1.0
            residuals.append((force - item.force_n) / weight)
            rows.append(slopes / weight[:, None])
        return np.concatenate(residuals), np.concatenate(rows)


@dataclass(frozen=True)
class IndentationFit:
    """What force-depth points say about the gel."""

    solution: Solution
    """Parameters ``ln_e``, ``nu`` where free, ``touch_<i>``; ``zero_<i>``, what is left of the load
    cell's zero [N], of records whose rows in air tell it."""
    poisson_ratio: float
    points: tuple[IndentationPoints, ...]
    tables: tuple[ForceTable, ...]
    model: PressForces
    noise: str
    """``given`` by the records, or ``proportional`` to the force."""
    misfit: float
    """Q of the likelihood, to compare fits of the same points."""
    likelihood: Likelihood
    model_errors: Mapping[str, float]
    """Standard deviation of each parameter from the errors of meshes and tables."""

    @property
    def young_modulus_pa(self) -> float:
        return math.exp(self.solution.value("ln_e"))

    @property
    def relative_sigma(self) -> float:
        """Standard deviation of Young's modulus as a part of it: noise and model."""
        return self.sigma_of("ln_e")

    def sigma_of(self, name: str) -> float:
        """Standard deviation of a parameter: noise and model."""
        return math.hypot(self.solution.sigma_of(name), self.model_errors[name])

    def interval_of(self, name: str) -> tuple[float, float]:
        """95 % interval of a parameter: that of noise, widened by the error of the model."""
        interval, value = self.solution.interval_of(name), self.solution.value(name)
        return widened(interval, value, NORMAL_95 * self.model_errors[name])

    def bounds_of(self, name: str) -> tuple[float, float]:
        """Bounds between which a parameter was searched."""
        (found,) = (p for p in self.likelihood.parameters if p.name == name)
        return found.low, found.high

    @property
    def young_interval_pa(self) -> tuple[float, float]:
        """95 % interval [Pa], see ``interval_of``."""
        low, high = self.interval_of("ln_e")
        return math.exp(low), math.exp(high)

    def touch_mm(self, index: int) -> float:
        """How much later the tool touched than the record says [mm]; 0 where that is trusted."""
        if f"touch_{index}" not in self.solution.names:
            return 0.0
        return self.solution.value(f"touch_{index}")

    def touch_interval_mm(self, index: int) -> tuple[float, float]:
        """95 % interval of ``touch_mm``."""
        name = f"touch_{index}"
        return self.interval_of(name) if name in self.solution.names else (0.0, 0.0)

    def predicted_n(self, index: int, depth_mm: np.ndarray) -> np.ndarray:
        """Forces of the fit [N] at recorded depths of one press."""
        past = np.asarray(depth_mm) - self.touch_mm(index)
        return self.tables[index].force_n(past, self.young_modulus_pa, self.poisson_ratio)

    def noise_n(self, index: int, force_n: float, scale: Sequence[float] | None = None) -> float:
        """Standard deviation of a reading of a force [N]; ``scale`` is that of ``Solution``."""
        scales = self.solution.noise if scale is None else scale
        item = self.points[index]
        if self.noise == "given":
            assert item.sigma_n is not None
            return scales[index] * float(np.median(item.sigma_n))
        return scales[0] * max(force_n, SMALL_FORCE * float(item.force_n.max()))

    def relative_residuals(self, index: int) -> np.ndarray:
        """Fit over measurement minus 1, shape [point]."""
        item = self.points[index]
        return self.predicted_n(index, item.depth_mm) / item.force_n - 1


def fit_indentation(
    points: Sequence[IndentationPoints],
    tables: Sequence[ForceTable],
    *,
    start_pa: float,
    poisson_ratio: float,
    free_nu: bool = True,
    nu_range: tuple[float, float] | None = None,
    touch_sigma_mm: float | Sequence[float] | None = None,
    profiled: Sequence[str] | None = None,
    drawn: bool = False,
) -> IndentationFit:
    """Fit the law's parameters to the points of one or more presses.

    Args:
        points: Presses; forces in N, depths in mm.
        tables: Simulated forces of each press.
        start_pa: Young's modulus to begin with [Pa].
        poisson_ratio: Fixed, or to begin with.
        free_nu: Whether Poisson's ratio is fitted.
        touch_sigma_mm: How well first touch is known, one or one a press; by ``touch_sigma`` when
            None.
        nu_range: Poisson's ratios that a free one may take; those of the tables when None.
        profiled: Parameters whose profile is wanted; all when None.
        drawn: Whether profiles are for a figure, with more points.
    """
    if touch_sigma_mm is None or isinstance(touch_sigma_mm, float | int):
        touch = [touch_sigma(item, touch_sigma_mm) for item in points]
    else:
        touch = touch_sigma_mm
    parameters = [FittedParameter("ln_e", math.log(start_pa), math.log(1e3), math.log(1e9), 0.1)]
    if free_nu:
        low = max(table.nu_range[0] for table in tables)
        high = min(table.nu_range[1] for table in tables)
        if nu_range is not None:
            low, high = max(low, nu_range[0]), min(high, nu_range[1])
        start = min(max(poisson_ratio, low + 0.1 * (high - low)), high - 0.02 * (high - low))
        parameters.append(FittedParameter("nu", start, low, high, 0.02))
    for i, sigma in enumerate(touch):
        if sigma > 0:
            parameters.append(
                FittedParameter(
                    f"touch_{i}",
                    0.0,
                    -TOUCH_LIMIT_MM,
                    TOUCH_LIMIT_MM,
                    min(sigma, 0.02),
                    sigma,
                    loose=len(np.unique(points[i].depth_mm)) >= LOOSE_POINTS,
                )
            )
    for i, item in enumerate(points):
        if item.zero is not None and item.zero.sigma > 0:
            sigma = item.zero.sigma
            parameters.append(
                FittedParameter(f"zero_{i}", 0.0, -8 * sigma, 8 * sigma, sigma, prior_sigma=sigma)
            )
    names = [p.name for p in parameters]
    model = PressForces(tables, names, poisson_ratio)
    noise = "given" if all(item.sigma_n is not None for item in points) else "proportional"
    groups = [CurveGroup(len(item.depth_mm), True) for item in points]
    weights = [item.sigma_n for item in points if item.sigma_n is not None]
    if noise == "proportional":
        count = sum(len(item.depth_mm) for item in points)
        groups = [CurveGroup(count, False, USUAL_NOISE, USUAL_COUNT)]
        # Standard deviations up to a common factor.
        size = [np.abs(item.force_n) for item in points]
        weights = [np.maximum(force, SMALL_FORCE * force.max()) for force in size]
    likelihood = Likelihood(
        parameters, groups, lambda theta: model.residuals(theta, points, weights)
    )
    solution = likelihood.solve(profiled, drawn)
    nu = solution.value("nu") if free_nu else poisson_ratio
    return IndentationFit(
        solution,
        nu,
        tuple(points),
        tuple(tables),
        model,
        noise,
        likelihood.q(solution.values),
        likelihood,
        _model_errors(likelihood, solution, points, tables),
    )


def _model_errors(
    likelihood: Likelihood,
    solution: Solution,
    points: Sequence[IndentationPoints],
    tables: Sequence[ForceTable],
) -> dict[str, float]:
    """Standard deviation of each parameter when the forces of each tool are off by a factor."""
    e = solution.names.index("ln_e")
    # Young's modulus is such a factor for all of them.
    by_factor = likelihood.residuals(solution.values)[1][:, e]
    tools = np.repeat([p.tool.description for p in points], [len(p.depth_mm) for p in points])
    variance = np.zeros(len(solution.names))
    for tool in np.unique(tools):
        sigma = max(
            table.error.scale
            for item, table in zip(points, tables, strict=True)
            if item.tool.description == tool
        )
        by = np.where(tools == tool, sigma * by_factor, 0.0)
        variance += likelihood.response(solution.values, by) ** 2
    errors = np.sqrt(variance)
    errors[e] = max(errors[e], max(table.error.scale for table in tables))
    return dict(zip(solution.names, errors.tolist(), strict=True))


def touch_sigma(item: IndentationPoints, given_mm: float | None) -> float:
    """How well the first touch of a press is known [mm]."""
    if given_mm is not None:
        return given_mm
    many = len(np.unique(item.depth_mm)) >= MANY_POINTS
    return LOOSE_TOUCH_SIGMA_MM if many else TOUCH_SIGMA_MM[item.tool.kind]


def force_interval_n(
    fit: IndentationFit,
    index: int,
    depth_mm: float,
    *,
    recorded: bool = True,
    reading: bool = False,
) -> tuple[float, float]:
    """95 % interval of the force [N] of the tool of press ``index`` at a depth.

    Args:
        fit: Whose free parameters are varied.
        index: Of the press.
        depth_mm: Depth above 0 [mm].
        recorded: Whether the depth counts as that record counts it, whose first touch is
            uncertain; else from first touch itself, as in a simulated press.
        reading: Whether the interval is of one reading, with its noise, or of the force itself.
    """
    old, at = fit.likelihood, np.array(fit.solution.values)
    e = fit.model.names.index("ln_e")
    depth = np.array([depth_mm])

    def residuals(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        (log,), (slopes,) = fit.model.log_force(theta, index, depth, recorded)
        inner = theta.copy()
        inner[e] = theta[e] - log
        r, jacobian = old.residuals(inner)
        return r, jacobian - np.outer(jacobian[:, e], slopes)

    middle = float(at[e] + fit.model.log_force(at, index, depth, recorded)[0][0])
    parameters = [p if p.prior_sigma is not None else replace(p, start=float(at[i]))
                  for i, p in enumerate(old.parameters)]  # fmt: skip
    parameters[e] = FittedParameter("ln_f", middle, middle - 4, middle + 4, 0.05)
    found = Likelihood(parameters, old.groups, residuals).solve(["ln_f"])
    extra = NORMAL_95 * fit.tables[index].error.interpolation
    if reading:
        force = math.exp(middle)
        extra = math.hypot(extra, old.quantile * fit.noise_n(index, force, found.noise) / force)
    low, high = widened(found.profiles["ln_f"].interval, middle, extra)
    return math.exp(low), math.exp(high)


@dataclass(frozen=True)
class HeldOut:
    """A point that was predicted from the others."""

    index: int
    """Index of its press."""
    depth_mm: float
    force_n: float
    predicted_n: float
    interval_n: tuple[float, float]
    """95 % interval of a reading there."""

    @property
    def relative(self) -> float:
        """Prediction over measurement minus 1."""
        return self.predicted_n / self.force_n - 1


Refit = Callable[[Sequence[np.ndarray]], tuple[IndentationFit, Sequence[IndentationFit]]]
"""The fit of the points that masks keep (one mask a press, bool [point]), and the fits in which all
that the data leave open is free."""


def held_out(fit: IndentationFit, refit: Refit) -> tuple[HeldOut, ...]:
    """Each point predicted from the others, or from those of other groups where there are many.

    None where a press has a single point or there are fewer than three points.
    """
    sizes = [len(item.depth_mm) for item in fit.points]
    if min(sizes) < 2 or sum(sizes) < 3:
        return ()
    folds = min(FOLDS, sum(sizes))
    owner = np.concatenate([np.full(size, i) for i, size in enumerate(sizes)])
    place = np.concatenate([np.arange(size) for size in sizes])
    found: list[HeldOut] = []
    for fold in range(folds):
        out = np.arange(len(owner)) % folds == fold
        keep = [~out[owner == i] for i in range(len(sizes))]
        if not all(mask.any() for mask in keep):
            continue
        one, free = refit(keep)
        for i, j in zip(owner[out].tolist(), place[out].tolist(), strict=True):
            depth, force = float(fit.points[i].depth_mm[j]), float(fit.points[i].force_n[j])
            interval = hull(force_interval_n(f, i, depth, reading=True) for f in free)
            predicted = float(one.predicted_n(i, np.array([depth]))[0])
            found.append(HeldOut(i, depth, force, predicted, interval))
    return tuple(sorted(found, key=lambda item: (item.index, item.depth_mm)))
