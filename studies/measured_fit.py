# SPDX-License-Identifier: Apache-2.0
"""Measured curves of a study's gels: one modulus a gel and a zero a curve, by the fit of materials.

``calibration.material.indentation`` fits; the table of each curve is the simulated press of its
design, whose force scales with Young's modulus. Dense rows are averaged to at most ``STEPS`` a
curve, since neighbours are not independent; intervals are widened by what a press by default is off
(``MODEL``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from taccel_lab.calibration.material.force_table import ForceTable, TableError
from taccel_lab.calibration.material.gel import Tool
from taccel_lab.calibration.material.indentation import (
    TOUCH_LIMIT_MM,
    IndentationFit,
    fit_indentation,
)
from taccel_lab.calibration.material.indentation_points import IndentationPoints
from taccel_lab.calibration.material.interpolation import Axis, ResponseTable
from taccel_lab.calibration.result import NORMAL_95, Estimate
from taccel_lab.studies.design_row import DesignRow
from taccel_lab.studies.measured_curve import MeasuredCurve, belongs, read_curve
from taccel_lab.studies.study import Study

STEPS = 25
MODEL = 0.03
"""Error of simulated forces, as a part (docs/verification.md, Presses by default)."""
AHEAD = 1.1
"""How far beyond the deepest step of a press rows are compared, by the last steps' power law."""
ROWS_FOR_ZERO = 8
"""Fewer rows do not tell a load cell's zero from the touch's."""
ZERO_SIGMA = 0.1
"""Zero of a load cell, as a part of the largest force, before the rows are asked for it."""
LEAST_RMS = 0.01
"""Residuals below this part of the largest force are not worth a word."""
_DESIGN_NU = Axis(0.5, 0.5)
"""Poisson's ratio is the design's: presses with another one are not at hand."""


@dataclass(frozen=True)
class FittedCurve:
    """A measured curve beside its gel's fit."""

    file: str
    indenter: str
    offset_mm: float
    """How much later than the record says the tool touched."""
    offset_interval_mm: tuple[float, float]
    modulus_alone_mpa: float
    """Of this curve fitted by itself."""
    rms_n: float
    """Root mean square of the residuals [N]."""
    relative_rms: float
    """The same over the largest force."""
    worst_n: float
    rows: int
    depth_mm: list[float]
    """Of the averaged rows."""
    force_n: list[float]
    fitted_n: list[float]
    predicted_n: list[float]
    """Of the design as the study file states it, from the fitted touch on."""
    contact_rms_mm: float | None
    """Of simulated against measured contact diameters, at equal force; None without."""
    remarks: list[str]


@dataclass(frozen=True)
class FittedGel:
    """One measured gel."""

    design: str
    unit: str
    design_modulus_mpa: float
    """What the study file makes it."""
    modulus_mpa: float
    interval_mpa: tuple[float, float]
    """95 % interval."""
    ratio: float
    """Fitted over the design's modulus."""
    curves: list[FittedCurve]

    def to_json(self) -> dict[str, Any]:
        return asdict(self)


def fit_measured(study: Study, rows: Sequence[DesignRow]) -> tuple[list[FittedGel], list[str]]:
    """Every measured gel of a study; and, in words, curves that nothing can be said of."""
    curves = [read_curve(spec) for spec in study.spec.measured]
    found: list[FittedGel] = []
    problems: list[str] = []
    for row in rows:
        mine = [c for c in curves if belongs(c.spec, row.parameters)]
        for unit in dict.fromkeys(c.spec.unit for c in mine):
            usable = []
            for curve in (c for c in mine if c.spec.unit == unit):
                press = _simulated(study, row, curve.spec.indenter)
                if press is None:
                    name = f"{curve.spec.file} on {study.name_of(row.parameters)}"
                    problems.append(f"{name}: the press of {curve.spec.indenter} has no curve")
                elif curve.depth_mm[-1] > _thickness_mm(press):
                    problems.append(
                        f"{curve.spec.file}: reaches {curve.depth_mm[-1]:.3g} mm in a gel "
                        f"{_thickness_mm(press):.3g} mm thick ({study.name_of(row.parameters)})"
                        + ("" if curve.touch_mm else "; no touch is seen in it")
                    )
                else:
                    usable.append((curve, press))
            if usable:
                found.append(_fit_gel(study, row, unit, usable))
    return found, problems


def _thickness_mm(press: dict[str, Any]) -> float:
    """Gel under a stored press [mm]."""
    return float(press["thickness_mm"])


def _simulated(study: Study, row: DesignRow, indenter: str) -> dict[str, Any] | None:
    """The stored press of an indenter straight down, with three rising steps at least."""
    for name, press in study.presses.items():
        if not getattr(press, "straight", False):
            continue
        for stored in row.curves.get(name) or []:
            force = [f[2] for f in stored["force_n"]]
            rising = len(force) >= 3 and force[0] > 0 and (np.diff(force) > 0).all()
            if stored["indenter"] == indenter and rising:
                return stored
    return None


@dataclass(frozen=True)
class _Item:
    """A curve in the fit."""

    curve: MeasuredCurve
    press: dict[str, Any]
    table: ForceTable
    points: IndentationPoints
    """Averaged rows."""
    remarks: list[str]


def press_table(press: dict[str, Any], young_modulus_pa: float) -> ForceTable:
    """Force over depth of a stored press, of a gel of 1 Pa; beyond the deepest step by the last
    steps' power law."""
    depth, force = np.array(press["depth_mm"]), np.array([f[2] for f in press["force_n"]])
    exponent = float(np.polyfit(np.log(depth[-2:]), np.log(force[-2:]), 1)[0])
    reduced = np.log(force / young_modulus_pa) - exponent * np.log(depth)
    responses = ResponseTable.through(
        Axis(0.0, 0.0), _DESIGN_NU, np.log(depth), reduced[None, None]
    )
    return ForceTable(exponent, responses, TableError(0.0, np.full(len(depth), MODEL / NORMAL_95)))


def _prepared(curve: MeasuredCurve, press: dict[str, Any], young_modulus_pa: float) -> _Item:
    deepest = float(press["depth_mm"][-1])
    remarks = list(curve.remarks)
    keep = curve.depth_mm <= AHEAD * deepest
    if not keep.all():
        remarks.append(
            f"{int((~keep).sum())} rows deeper than the press ({deepest:.3g} mm) left out"
        )
    if keep.sum() < 3:
        keep[:] = True
        remarks[-1] = f"all but two rows are deeper than the press ({deepest:.3g} mm)"
    depth, force = _averaged(curve.depth_mm[keep], curve.force_n[keep])
    name = curve.spec.indenter
    tool = Tool("sphere" if name.startswith("sphere:") else "flat", 0.0, (0.0, 0.0), name)
    points = IndentationPoints(curve.spec.file, curve.spec.file, "", tool, depth, force, None)
    return _Item(curve, press, press_table(press, young_modulus_pa), points, remarks)


def _averaged(depth: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means over equal steps of depth."""
    if len(depth) <= STEPS:
        return depth, force
    edges = np.linspace(depth[0], depth[-1], STEPS + 1)[1:-1]
    group = np.searchsorted(edges, depth)
    counts = np.bincount(group, minlength=STEPS)
    full = counts > 0
    means = (np.bincount(group, weights=v, minlength=STEPS)[full] for v in (depth, force))
    x, y = (mean / counts[full] for mean in means)
    return x, y


def _fit(points: Sequence[IndentationPoints], tables: Sequence[ForceTable]) -> IndentationFit:
    tops = [
        item.force_n[-1] / table.force_n(item.depth_mm[-1:], 1.0, _DESIGN_NU.low)[0]
        for item, table in zip(points, tables, strict=True)
        if item.force_n[-1] > 0 and item.depth_mm[-1] > 0
    ]
    start = float(np.exp(np.median(np.log(tops))))
    return fit_indentation(
        points, tables, start_pa=start, poisson_ratio=_DESIGN_NU.low, free_nu=False, profiled=()
    )


def _fit_gel(
    study: Study, row: DesignRow, unit: str, usable: Sequence[tuple[MeasuredCurve, dict[str, Any]]]
) -> FittedGel:
    stated = study.family.parameters(row.parameters).layer_materials()[0].young_modulus_pa
    items = [_prepared(curve, press, stated) for curve, press in usable]
    fit = _fit([item.points for item in items], [item.table for item in items])
    low, high = fit.young_interval_pa
    return FittedGel(
        design=row.id,
        unit=unit,
        design_modulus_mpa=1e-6 * stated,
        modulus_mpa=1e-6 * fit.young_modulus_pa,
        interval_mpa=(1e-6 * low, 1e-6 * high),
        ratio=fit.young_modulus_pa / stated,
        curves=[
            _fitted_curve(
                item, fit, i, stated,
                fit if len(items) == 1 else _fit([item.points], [item.table]),
            )
            for i, item in enumerate(items)
        ],
    )  # fmt: skip


def _fitted_curve(
    item: _Item, fit: IndentationFit, index: int, stated_pa: float, alone: IndentationFit
) -> FittedCurve:
    depth, force = item.points.depth_mm, item.points.force_n
    fitted = fit.predicted_n(index, depth)
    rms = float(np.sqrt(np.mean((fitted - force) ** 2)))
    touch, offset = item.curve.touch_mm, fit.touch_mm(index)
    low, high = fit.touch_interval_mm(index)
    remarks = list(item.remarks)
    if abs(offset) > 0.98 * TOUCH_LIMIT_MM:
        remarks.append("the zero offset ends at its bound: look at the depths")
    remark = _zero_force_remark(item, rms, stated_pa)
    remarks += [remark] if remark else []
    return FittedCurve(
        file=item.curve.spec.file,
        indenter=item.curve.spec.indenter,
        offset_mm=touch + offset,
        offset_interval_mm=(touch + low, touch + high),
        modulus_alone_mpa=1e-6 * alone.young_modulus_pa,
        rms_n=rms,
        relative_rms=rms / float(force.max()),
        worst_n=float(np.abs(fitted - force).max()),
        rows=len(item.curve.depth_mm),
        depth_mm=(touch + depth).tolist(),
        force_n=force.tolist(),
        fitted_n=fitted.tolist(),
        predicted_n=(fitted * stated_pa / fit.young_modulus_pa).tolist(),
        contact_rms_mm=_contact_rms_mm(item, fit.young_modulus_pa),
        remarks=remarks,
    )


def _zero_force_remark(item: _Item, rms_n: float, stated_pa: float) -> str:
    """Whether a load cell that reads something in air would explain most of the residuals."""
    largest = float(item.points.force_n.max())
    if len(item.points.force_n) < ROWS_FOR_ZERO or rms_n < LEAST_RMS * largest:
        return ""
    fit = _fit([replace(item.points, zero=Estimate(0.0, ZERO_SIGMA * largest))], [item.table])
    zero = fit.solution.value("zero_0")
    low, high = fit.interval_of("zero_0")
    left = fit.predicted_n(0, item.points.depth_mm) + zero - item.points.force_n
    rms = float(np.sqrt(np.mean(left**2)))
    if low <= 0 <= high or rms > rms_n / 2:
        return ""
    return (
        f"{zero:+.2g} N in all forces would leave {rms / largest:.1%} in place of "
        f"{rms_n / largest:.1%}, at {fit.young_modulus_pa / stated_pa:.3g} times the design's "
        "modulus: does the load cell read that in air?"
    )


def _contact_rms_mm(item: _Item, young_modulus_pa: float) -> float | None:
    """Of contact diameters, measured and simulated, at equal force."""
    measured, simulated = item.curve.contact_diameter_mm, item.press.get("contact_diameter_mm")
    if measured is None or simulated is None:
        return None
    known = np.isfinite(measured) & (item.curve.force_n > 0)
    if not known.any():
        return None
    depth = np.append(0.0, np.geomspace(1e-3, 1.0, 400) * AHEAD * item.press["depth_mm"][-1])
    force = item.table.force_n(depth, young_modulus_pa, _DESIGN_NU.low)
    reached = np.interp(item.curve.force_n[known], force, depth)
    at = np.interp(reached, [0.0, *item.press["depth_mm"]], [0.0, *simulated])
    return float(np.sqrt(np.mean((at - measured[known]) ** 2)))
