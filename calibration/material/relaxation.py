# SPDX-License-Identifier: Apache-2.0
"""The damping time of the gel from forces over time, and relaxation that the solver cannot show.

The solver damps like Kelvin and Voigt: viscous stress is ``damping_time_s`` times the rate of the
elastic one, so a press at a rate v needs F = E (f(d) + tau g(d) f'(d) v), with f of the tables and
g, 1 at small strains, of ``viscous_gain``; the extra force is gone at once when the tool stops. A
gel whose force keeps falling while the tool holds still relaxes (Maxwell, Zener); that no damping
time reproduces, and it is reported with its amplitude and time instead.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import savgol_filter
from scipy.stats import f as f_distribution

from taccel_lab.calibration.capture import ForceRecord
from taccel_lab.calibration.material.force_table import ForceTable
from taccel_lab.calibration.material.gel import Tool
from taccel_lab.calibration.material.remarks import DAMPING_UNDETERMINED, RELAXES
from taccel_lab.calibration.material.robust_statistics import robust_regression
from taccel_lab.calibration.result import Estimate
from taccel_lab.errors import InputError
from taccel_lab.report.remark import Remark

MIN_ROWS = 12
HOLD_RATE = 0.03
"""The tool holds still below this part of its greatest speed."""
MIN_HOLD_ROWS = 8
VISIBLE = 0.02
"""Relaxation of a smaller part of the force is not spoken of."""
WINDOW = 7
"""Rows of the smoothing of depth from which the speed is taken (cubic)."""


@dataclass(frozen=True)
class Relaxation:
    """A fall of the force at held depth, F = F_end + (F_0 - F_end) exp(-t / T)."""

    part: float
    """(F_0 - F_end) / F_0."""
    time_s: float


@dataclass(frozen=True)
class DampingFit:
    """What a relaxation record says."""

    name: str
    source: str
    sha256: str
    tool: Tool
    damping_time_s: Estimate | None
    """None where the record cannot tell it, or where Kelvin and Voigt's solid cannot do it."""
    relaxation: Relaxation | None
    young_modulus_pa: float
    """Of the elastic part [Pa]: of the force that is left when the tool holds still."""
    time_s: np.ndarray
    depth_mm: np.ndarray
    force_n: np.ndarray
    fitted_n: np.ndarray
    relative_residual: float
    max_rate_mm_s: float
    remarks: tuple[Remark, ...]

    group = "damping"

    def residuals(self) -> dict[str, float]:
        """As a part of the mean force."""
        return {"relaxation_rms_relative": self.relative_residual}

    def valid_region(self) -> dict[str, tuple[float, float]]:
        """Speeds of the tool."""
        return {"rate_mm_s": (0.0, self.max_rate_mm_s)}

    def figures(self) -> dict[str, Any]:
        """What was found, ready for JSON."""
        return {
            "name": self.name,
            "damping_time_s": self.damping_time_s.value if self.damping_time_s else None,
            "relaxation": vars(self.relaxation) if self.relaxation else None,
            "young_modulus_pa": self.young_modulus_pa,
        }


def check_relaxation(record: ForceRecord) -> None:
    """Refuse a record that is too short, or that presses nothing."""
    time = record.columns["time_s"]
    if len(time) < MIN_ROWS:
        raise InputError(f"{record.source}: {len(time)} rows; at least {MIN_ROWS} over time")
    if np.ptp(record.columns["depth_mm"]) <= 0 or record.columns["depth_mm"].max() <= 0:
        raise InputError(
            f"{record.source}: depth_mm never rises above first touch, so nothing is pressed"
        )


def fit_damping(
    record: ForceRecord,
    tool: Tool,
    table: ForceTable,
    gain: tuple[float, float] = (1.0, 0.0),
) -> DampingFit:
    """Damping time and relaxation of a record, columns time_s, depth_mm and force_n.

    ``table``: of the gel's law, which is held. ``gain``: of the solver's damping, at depth 0 and
    its slope over the depth [1/mm].
    """
    check_relaxation(record)
    time, depth, force = (record.columns[key] for key in ("time_s", "depth_mm", "force_n"))
    name = record.name
    rate = _rate(time, depth)
    fastest = float(np.abs(rate).max())
    elastic, slope = np.zeros(len(depth)), np.zeros(len(depth))
    inside = depth > 0
    log, by_depth, _, _ = table.log_force(depth[inside], *table.held_law)
    elastic[inside] = np.exp(log)
    slope[inside] = elastic[inside] * by_depth
    hold = _longest_hold(rate, fastest, depth)
    relaxation = None
    if hold is not None:
        relaxation = _relaxation(time[hold], force[hold])
    viscous = slope * rate * (gain[0] + gain[1] * depth)
    columns = np.stack([elastic, viscous], axis=1)
    use = inside.copy()
    if hold is not None and relaxation is not None:
        # The elastic part is what is left in the end.
        use[hold[: 2 * len(hold) // 3]] = False
    sigma = record.sigma_n()
    weight = np.ones(len(time)) if sigma is None else 1 / sigma
    fit = robust_regression(columns[use] * weight[use, None], force[use] * weight[use])
    modulus, resistance = (float(value) for value in fit.values)
    if modulus <= 0:
        raise InputError(
            f"{record.source}: the force does not grow with depth (modulus {modulus:.3g} Pa)"
        )
    tau = resistance / modulus
    # Error of a ratio, to first order.
    estimate: Estimate | None = fit.estimate(tau, np.array([-tau, 1.0]) / modulus, "s")
    low, high = estimate.interval95
    remarks: list[Remark] = []
    if relaxation is not None:
        remarks.append(
            RELAXES(
                name=name,
                part=relaxation.part,
                time_s=relaxation.time_s,
                modulus_pa=modulus,
            )
        )
        estimate = None
    elif low <= 0:
        remarks.append(DAMPING_UNDETERMINED(name=name, fastest=fastest, high_s=high))
        estimate = None
    fitted = columns @ fit.values
    level = float(np.abs(force[use]).mean())
    return DampingFit(
        name, record.source, record.sha256, tool, estimate, relaxation, modulus, time, depth,
        force, fitted, float(np.sqrt(np.mean((fitted[use] - force[use]) ** 2))) / level, fastest,
        tuple(remarks),
    )  # fmt: skip


def _rate(time: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Speed of the tool [mm/s]; smoothed over a few rows where the rows are even in time."""
    steps = np.diff(time)
    if len(time) > 2 * WINDOW and steps.max() < 1.05 * steps.min():
        return np.asarray(savgol_filter(depth, WINDOW, 3, deriv=1, delta=float(steps.mean())))
    return np.gradient(depth, time)


def _longest_hold(rate: np.ndarray, fastest: float, depth: np.ndarray) -> np.ndarray | None:
    """Rows of the longest time at rest in the gel."""
    still = (np.abs(rate) < HOLD_RATE * fastest) & (depth > 0.5 * depth.max())
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    if not len(edges):
        return None
    runs = edges.reshape(-1, 2)
    a, b = runs[int(np.argmax(runs[:, 1] - runs[:, 0]))]
    return np.arange(a, b) if b - a >= MIN_HOLD_ROWS else None


def _relaxation(time: np.ndarray, force: np.ndarray) -> Relaxation | None:
    """The exponential fall of a force, where there is one beyond its noise."""
    t = time - time[0]
    span = float(t[-1])

    def model(x: np.ndarray) -> np.ndarray:
        return x[0] + x[1] * np.exp(-t / math.exp(x[2]))

    start = np.array([force[-1], force[0] - force[-1], math.log(span / 4)])
    bounds = ([-np.inf, -np.inf, math.log(span / 200)], [np.inf, np.inf, math.log(10 * span)])
    fit = least_squares(lambda x: model(x) - force, start, bounds=bounds)
    flat = float(np.sum((force - force.mean()) ** 2))
    left = float(np.sum((model(fit.x) - force) ** 2))
    dof = len(force) - 3
    if left > 0 and f_distribution.sf((flat - left) / 2 / (left / dof), 2, dof) > 1e-3:
        return None
    begin = float(model(fit.x)[0])
    # A hold shorter than the relaxation does not show its end: what it lost so far counts.
    lost = begin - float(model(fit.x)[-1])
    if begin <= 0 or lost / begin < VISIBLE:
        return None
    return Relaxation(lost / begin, math.exp(float(fit.x[2])))
