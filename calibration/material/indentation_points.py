# SPDX-License-Identifier: Apache-2.0
"""Force-depth points of an indentation record, or of presses with both given; faults in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import rankdata

from taccel_lab.calibration.capture import CaptureFolder, ForceRecord
from taccel_lab.calibration.capture.schema import ToolEntry
from taccel_lab.calibration.material.bonded_layer import layer_young_modulus_pa
from taccel_lab.calibration.material.gel import Gel, Tool
from taccel_lab.calibration.material.remarks import FORCE_DROPS, UNLOADING, UNUSUAL_MODULUS
from taccel_lab.calibration.result import Remark
from taccel_lab.calibration.robust_spread import spread_about_median
from taccel_lab.errors import InputError

PLAUSIBLE_PA = (1e4, 1e7)
"""Young's moduli of gels; a fit outside is a fault of units."""
USUAL_PA = (2e4, 2.5e6)
"""Young's moduli that gels of tactile sensors have; used to guess which unit was meant."""
GRAM_N = 9.80665e-3
FORCE_UNITS = {"mN": 1e-3, "grams": GRAM_N, "kilograms": 1e3 * GRAM_N, "kN": 1e3}
"""Newtons in one of a unit that forces are recorded in by mistake."""
DEPTH_UNITS = {"m": 1e3, "cm": 10.0, "um": 1e-3}
"""Millimetres in one of a unit that depths are recorded in by mistake."""
FALLING_CORRELATION = -0.3
"""Rank correlation of force and depth below which a curve falls."""


@dataclass(frozen=True)
class IndentationPoints:
    """One press of one tool."""

    name: str
    source: str
    sha256: str
    tool: Tool
    depth_mm: np.ndarray
    """Depth past first touch, shape [point]."""
    force_n: np.ndarray
    """Normal force into the gel, shape [point]."""
    sigma_n: np.ndarray | None
    """Standard deviation of each force [N]; None where the record does not say."""
    remarks: tuple[Remark, ...] = ()

    @property
    def deepest_mm(self) -> float:
        return float(self.depth_mm.max())

    def only(self, keep: np.ndarray) -> IndentationPoints:
        """Some of the points, those of a mask (bool, [point])."""
        sigma = None if self.sigma_n is None else self.sigma_n[keep]
        return replace(
            self, depth_mm=self.depth_mm[keep], force_n=self.force_n[keep], sigma_n=sigma
        )


def points_of_record(record: ForceRecord, gel: Gel, ball_mm: float | None) -> IndentationPoints:
    """The loading branch of an indentation record, checked.

    Raises:
        InputError: A curve that falls, negative forces, no depth above 0, or a missing tool.
    """
    depth, force = record.columns["depth_mm"], record.columns["force_n"]
    sigma = record_sigma(record, len(depth))
    remarks = []
    keep, unloading = loading_branch(depth)
    if unloading is not None:
        lost = hysteresis(depth[keep], force[keep], depth[unloading], force[unloading])
        remarks.append(UNLOADING(source=record.source, count=int(unloading.sum()), lost=lost))
    points = _checked(
        record.source.replace("\\", "/").rsplit("/", 1)[-1],
        record.source,
        record.sha256,
        gel.tool(record.entry.tool, ball_mm),
        depth[keep],
        force[keep],
        None if sigma is None else sigma[keep],
    )
    drops = _drops(points)
    if drops is not None:
        remarks.append(drops)
    return IndentationPoints(**{**vars(points), "remarks": tuple(remarks)})


def points_of_presses(folder: CaptureFolder, gel: Gel) -> list[IndentationPoints]:
    """Ball presses whose manifest entries state both depth and force, one set for each ball."""
    found: dict[float, list[tuple[float, float, str]]] = {}
    for press in folder.presses:
        depth, force = getattr(press, "depth_mm", None), getattr(press, "force_n", None)
        radius = getattr(press, "radius_mm", None) or folder.ball_radius_mm
        if depth and force is not None and radius is not None:
            found.setdefault(radius, []).append((depth, force, press.sha256))
    sets = []
    for radius, rows in sorted(found.items()):
        tool = gel.tool(ToolEntry(kind="sphere", radius_mm=radius))
        depth, force = np.array([row[:2] for row in rows]).T
        name = f"ball presses of {radius:g} mm"
        sets.append(_checked(name, folder.source, rows[0][2], tool, depth, force, None))
    return sets


def record_sigma(record: ForceRecord, count: int) -> np.ndarray | None:
    """Standard deviation of each force of a record [N], or None."""
    if "sigma_n" in record.columns:
        sigma = record.columns["sigma_n"]
        if (sigma <= 0).any():
            raise InputError(f"{record.source}: sigma_n must be above 0 in every row")
        return sigma
    if record.entry.force_sigma_n is not None:
        return np.full(count, record.entry.force_sigma_n)
    return None


def loading_branch(depth_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """Masks of the way down and of the way up, which is None where there is none.

    A record that goes down and up again in order has both; other rows (depths in any order) are
    points of their own and all count as loading.
    """
    count = len(depth_mm)
    top = int(np.argmax(depth_mm))
    down, up = np.diff(depth_mm[: top + 1]), np.diff(depth_mm[top:])
    noise = 0.02 * np.ptp(depth_mm)
    ordered = (down >= -noise).all() and (up <= noise).all()
    everything = np.ones(count, dtype=bool)
    if not ordered or count - top - 1 < 3 or top < 2:
        return everything, None
    loading = np.arange(count) <= top
    return loading, ~loading


def hysteresis(
    down_mm: np.ndarray, down_n: np.ndarray, up_mm: np.ndarray, up_n: np.ndarray
) -> float:
    """Part of the work of the way down that the way up does not give back, where both were."""
    order = np.argsort(up_mm)
    low, high = max(down_mm.min(), up_mm.min()), min(down_mm.max(), up_mm.max())
    depth = np.linspace(low, high, 100)
    work = float(np.trapezoid(np.interp(depth, down_mm, down_n), depth))
    back = float(np.trapezoid(np.interp(depth, up_mm[order], up_n[order]), depth))
    return 1 - back / work if work > 0 else 0.0


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


def _checked(
    name: str,
    source: str,
    sha256: str,
    tool: Tool,
    depth: np.ndarray,
    force: np.ndarray,
    sigma: np.ndarray | None,
) -> IndentationPoints:
    touching = depth > 0
    if not touching.any():
        raise InputError(
            f"{source}: no row lies below first touch; depth_mm must be positive into the gel "
            f"(found {depth.min():g} to {depth.max():g} mm)"
        )
    positive = force[touching] > 0
    middle = float(np.median(force[touching]))
    if middle < 0:
        raise InputError(
            f"{source}: forces are negative (median {middle:.3g} N); force_n is positive when the "
            "tool presses into the gel: turn the sign"
        )
    if positive.mean() < 0.5:
        raise InputError(
            f"{source}: {(~positive).sum()} of {len(positive)} rows below first touch show no "
            "force; is depth_mm counted from first touch?"
        )
    if len(np.unique(depth[touching])) > 2:
        ranks = rankdata(depth[touching]), rankdata(force[touching])
        correlation = float(np.corrcoef(ranks[0], ranks[1])[0, 1])
        if correlation < FALLING_CORRELATION:
            raise InputError(
                f"{source}: the force falls with depth (rank correlation {correlation:.2f}); "
                "depth_mm must grow into the gel and force_n with it: turn the sign of one of them"
            )
    keep = touching
    return IndentationPoints(
        name, source, sha256, tool, depth[keep], force[keep], None if sigma is None else sigma[keep]
    )


def _drops(points: IndentationPoints) -> Remark | None:
    """Whether the force falls where the depth rises by more than the record's noise."""
    order = np.argsort(points.depth_mm, kind="stable")
    force = points.force_n[order]
    if len(force) < 4:
        worst = float(np.diff(force).min()) if len(force) > 1 else 0.0
        limit = 0.05 * force.max()
    else:
        second = np.diff(force, 2)
        noise = spread_about_median(second) / np.sqrt(6)
        worst = float(np.diff(force).min())
        limit = max(5 * noise, 0.05 * force.max())
    if worst >= -limit:
        return None
    where = float(points.depth_mm[order][int(np.argmin(np.diff(force)))])
    return FORCE_DROPS(name=points.name, drop_n=-worst, depth_mm=where)
