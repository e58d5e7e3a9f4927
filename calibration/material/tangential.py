# SPDX-License-Identifier: Apache-2.0
"""Friction from shear and twist at held depth: the stick before the slip, by simulation.

Forces scale with Young's modulus; a record that states the normal force tells it as well.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from taccel_lab.calibration.capture import ForceRecord
from taccel_lab.calibration.material.friction import FrictionFit
from taccel_lab.calibration.material.gel import Gel, Tool
from taccel_lab.calibration.material.likelihood import Group, Likelihood, Parameter, Solution
from taccel_lab.calibration.material.remarks import FRICTION_UNDETERMINED, TANGENTIAL_MISFIT
from taccel_lab.calibration.material.tangential_table import (
    Motion,
    TangentialTable,
    tangential_table,
)
from taccel_lab.errors import InputError
from taccel_lab.progress import Progress, silent
from taccel_lab.report.remark import Remark

FLAT = 0.3
"""A curve whose last slope is below this part of its first one has slipped: friction is near."""
ZERO = 0.02
"""How well the force at the start of the motion is read, as a part of the largest one."""
STEADY_DEPTH = 0.1
"""A held depth may vary by this part of itself."""

START_SIGMA_MM = 0.02
"""How well the start of the motion is known."""


@dataclass(frozen=True)
class TangentialFit(FrictionFit):
    """Friction of one shear or twist record."""

    name: str
    source: str
    sha256: str
    tool: Tool
    motion: Motion
    depth_mm: float
    solution: Solution
    """Parameters ``ln_mu``, ``ln_e``, ``start`` (motion at which the tool begins to move) and
    ``zero`` (force of the fit there)."""
    table: TangentialTable
    motions: np.ndarray
    """Shift [mm] or angle [deg] of the rows fitted."""
    tangential: np.ndarray
    """Measured tangential force [N], or torque [N mm], positive along the motion."""
    normal_n: np.ndarray | None
    fitted: np.ndarray
    relative_residual: float
    remarks: tuple[Remark, ...]

    @property
    def table_error(self) -> float:
        """Relative error of the simulated table."""
        return self.table.error

    group = "tangential"

    def residuals(self) -> dict[str, float]:
        """As a part of the largest force."""
        return {"tangential_rms_relative": self.relative_residual}

    def valid_region(self) -> dict[str, tuple[float, float]]:
        """The held depth."""
        return {f"{self.motion}_depth_mm": (self.depth_mm, self.depth_mm)}

    def figures(self) -> dict[str, Any]:
        """What was found, ready for JSON."""
        return {
            "name": self.name,
            "motion": self.motion,
            "friction": self.friction,
            "interval95": self.friction_interval,
            "determined": self.friction_determined,
            "relative_residual": self.relative_residual,
        }


def fit_tangential(
    record: ForceRecord,
    gel: Gel,
    tool: Tool,
    *,
    young_pa: tuple[float, float] | None = None,
    progress: Progress = silent,
) -> TangentialFit:
    """Fit the coefficient of friction to a shear or twist record.

    Args:
        record: Columns depth_mm, shift_mm, normal_n, tangential_n; or depth_mm, angle_deg,
            torque_nmm.
        gel: The pad and the law, on which the ratio of the forces hardly depends.
        tool: A ball or punch.
        young_pa: Young's modulus [Pa] and its relative standard deviation from elsewhere; a
            twist record without it tells nothing.
        progress: Told how many presses are done, and of how many.

    Raises:
        InputError: A depth that is not held, no motion, or a twist record without a modulus.
    """
    motion, moved, tangential, normal, depth, rows = _loading_rows(record)
    name = record.name
    lever = 1.0 if motion == "shear" else 2 / 3 * tool.contact_radius_mm(depth)
    if normal is None:
        if young_pa is None:
            raise InputError(
                f"{record.source}: a twist record has no normal force, so it needs Young's modulus "
                "from an indentation record"
            )
        least = 0.3
    else:
        ratio = np.abs(tangential) / np.maximum(normal, 1e-12)
        least = float(np.clip(np.percentile(ratio, 98) / lever, 0.05, 1.8))
    slipped = _has_slipped(moved, tangential)

    def simulate(mu: float) -> TangentialTable:
        return tangential_table(
            gel, tool, motion, round(depth, 2), mu, float(moved.max()), slipped=slipped,
            progress=progress,
        )  # fmt: skip

    table = simulate(least)
    at_start = np.zeros(1)
    if normal is None:
        assert young_pa is not None
        start_n = young_pa[0] * table.forces(at_start, math.sqrt(math.prod(table.mu_range)))[0][1]
        least = float(np.clip(np.abs(tangential).max() / start_n[0] / lever, 0.05, 1.8))
        table = simulate(least)
    # Rows past what was simulated belong to sliding, and have a record of their own.
    near = moved <= 1.15 * table.reach
    if near.sum() < 5:
        raise InputError(
            f"{record.source}: {int(near.sum())} rows lie within the first {table.reach:.3g} of "
            "the motion, before the tool slides as a whole; at least 5 are needed there"
        )
    moved, tangential, rows = moved[near], tangential[near], rows[near]
    normal = None if normal is None else normal[near]
    # Rows of the table that were measured: the tangential force, and the normal one where stated.
    measured = tangential[None] if normal is None else np.stack([tangential, normal])
    largest = np.abs(measured).max(axis=1)
    if young_pa is not None:
        start_e, prior = young_pa[0], math.hypot(young_pa[1], 0.01)
    else:
        start_e = float(np.median(measured[1]) / table.forces(at_start, least)[0][1, 0])
        prior = None
    unit = 1.0 if motion == "shear" else math.degrees(1 / tool.contact_radius_mm(depth))
    step = START_SIGMA_MM * unit
    low, high = table.mu_range
    parameters = [
        Parameter("ln_mu", math.log(least), math.log(low), math.log(high), 0.1),
        Parameter("ln_e", math.log(start_e), math.log(1e3), math.log(1e9), 0.05, prior),
        Parameter("start", 0.0, -5 * step, 5 * step, step, step),
        # The force at the start is a reading like any other: what it is off by is common to all.
        Parameter(
            "zero", 0.0, -0.3 * largest[0], 0.3 * largest[0], 0.01 * largest[0], ZERO * largest[0]
        ),
    ]
    sigma = record.sigma_n()
    known = sigma is not None and motion == "shear"
    scale = sigma[rows] if sigma is not None and known else largest[:, None]

    def model(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forces of the rows that were measured, and their derivatives by the parameters, last."""
        along = moved - theta[2]
        forces, by_motion, by_ln_mu = (
            math.exp(theta[1]) * each[: len(measured)]
            for each in table.forces(np.maximum(along, 0.0), math.exp(theta[0]))
        )
        by_zero = np.zeros_like(forces)
        by_zero[0] = 1.0
        slopes = np.stack([by_ln_mu, forces, -by_motion * (along > 0), by_zero], axis=-1)
        return forces + theta[3] * by_zero, slopes

    def residuals(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        forces, slopes = model(theta)
        weighted = (slopes / np.broadcast_to(scale, forces.shape)[..., None]).reshape(-1, 4)
        return ((forces - measured) / scale).ravel(), weighted

    groups = [Group(len(moved), known)] * len(measured)
    solution = Likelihood(parameters, groups, residuals).solve(["ln_mu"], drawn=True)
    fitted = model(solution.values)[0][0]
    residual = float(np.sqrt(np.mean((fitted - tangential) ** 2)) / largest[0])
    remarks = []
    profile = solution.profiles["ln_mu"]
    if not profile.closed:
        remarks.append(FRICTION_UNDETERMINED(name=name, least=math.exp(profile.interval[0])))
    if residual > 0.1:
        remarks.append(TANGENTIAL_MISFIT(name=name, motion=motion, residual=residual))
    return TangentialFit(
        name, record.source, record.sha256, tool, motion, depth, solution, table, moved,
        tangential, normal, fitted, residual, tuple(remarks),
    )  # fmt: skip


def _loading_rows(
    record: ForceRecord,
) -> tuple[Motion, np.ndarray, np.ndarray, np.ndarray | None, float, np.ndarray]:
    """Motion from its start to its first turning point, forces along it, depth, row numbers."""
    motion: Motion = "shear" if record.entry.kind == "shear" else "twist"
    depth = record.columns["depth_mm"]
    moved = record.columns["shift_mm" if motion == "shear" else "angle_deg"]
    tangential = record.columns["tangential_n" if motion == "shear" else "torque_nmm"]
    reach = float(np.ptp(moved))
    if reach <= 0:
        raise InputError(f"{record.source}: the tool does not move sideways or turn")
    relative = moved - moved[0]
    far = int(np.argmax(np.abs(relative)))
    slack = 0.05 * reach
    sign = 1 if relative[far] > 0 else -1
    ahead = sign * relative
    # The first turning point: the largest advance before the way back exceeds the slack.
    highest = np.maximum.accumulate(ahead)
    back = np.flatnonzero(highest - ahead > slack)
    end = int(np.argmax(ahead[: back[0]])) if len(back) else len(ahead) - 1
    rows = np.flatnonzero((np.arange(len(ahead)) <= end) & (ahead >= 0))
    if len(rows) < 5:
        raise InputError(
            f"{record.source}: only {len(rows)} rows before the motion turns back; at least 5"
        )
    held = float(np.median(depth[rows]))
    if held <= 0 or np.ptp(np.percentile(depth[rows], [5, 95])) > STEADY_DEPTH * held:
        raise InputError(
            f"{record.source}: a {motion} record needs one held depth above 0 mm; depth_mm goes "
            f"from {depth[rows].min():g} to {depth[rows].max():g} mm"
        )
    along = tangential[rows] - tangential[rows[0]]
    along = along if along[-1] >= 0 else -along
    normal = record.columns["normal_n"][rows] if motion == "shear" else None
    if normal is not None and (normal <= 0).any():
        raise InputError(f"{record.source}: normal_n must be positive while the tool presses")
    return motion, ahead[rows], along, normal, held, rows


def _has_slipped(moved: np.ndarray, tangential: np.ndarray) -> bool:
    """Whether the force has all but stopped growing at the end of the motion."""
    span = float(moved.max())
    early, late = moved <= 0.25 * span, moved >= 0.8 * span
    if early.sum() < 2 or late.sum() < 3:
        return False
    first, last = (np.polyfit(moved[part], tangential[part], 1)[0] for part in (early, late))
    return bool(last < FLAT * first)
