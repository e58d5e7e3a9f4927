# SPDX-License-Identifier: Apache-2.0
"""Simulated presses laid over measured curves: one modulus a gel, a zero offset a curve.

Forces of the presses scale with Young's modulus, so that ``F = m f(d - d0)`` with the simulated
curve f has all there is to fit: m, the gel's modulus over the design's, which all its curves share,
and d0, how much deeper than the record says the tool touched. Noise is taken to grow with the force
down to a tenth of the largest. Dense rows are averaged to at most ``STEPS`` a curve, since
neighbours are not independent; intervals are those of Student's t, widened by what a press by
default is off (``MODEL``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from taccel_lab.studies.design_row import DesignRow
from taccel_lab.studies.measured_curve import MeasuredCurve, belongs, read_curve
from taccel_lab.studies.study import Study

STEPS = 25
MODEL = 0.03
"""Error of simulated forces, as a part (docs/verification.md, Presses by default)."""
FLOOR = 0.1
AHEAD = 1.1
"""How far beyond the deepest step of a press rows are compared, by the last steps' power law."""
ROWS_FOR_ZERO = 8
"""Fewer rows do not tell a load cell's zero from the touch's."""
LEAST_RMS = 0.02
"""Residuals below this part of the largest force are not worth a word."""
FAR_MM = 0.5
"""Largest zero offset."""


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


class ForceLaw:
    """A simulated curve of force over depth, by power laws between its steps."""

    def __init__(self, depth_mm: Sequence[float], force_n: Sequence[float]) -> None:
        self._depth, self._force = np.log(depth_mm), np.log(force_n)

    @property
    def deepest_mm(self) -> float:
        return float(np.exp(self._depth[-1]))

    def force_n(self, depth_mm: np.ndarray) -> np.ndarray:
        """0 above the gel; below the first and beyond the last step by the next power law."""
        return self._read(np.asarray(depth_mm, dtype=float), self._depth, self._force)

    def depth_mm(self, force_n: np.ndarray) -> np.ndarray:
        """The inverse."""
        return self._read(np.asarray(force_n, dtype=float), self._force, self._depth)

    @staticmethod
    def _read(at: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        log = np.log(np.maximum(at, 1e-12))
        k = np.clip(np.searchsorted(x, log) - 1, 0, len(x) - 2)
        slope = (y[k + 1] - y[k]) / (x[k + 1] - x[k])
        return np.where(at > 0, np.exp(y[k] + slope * (log - x[k])), 0.0)


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


@dataclass
class _Item:
    """A curve in the fit."""

    curve: MeasuredCurve
    press: dict[str, Any]
    law: ForceLaw
    depth: np.ndarray
    force: np.ndarray
    weight: np.ndarray
    remarks: list[str]


def _prepared(curve: MeasuredCurve, press: dict[str, Any]) -> _Item:
    law = ForceLaw(press["depth_mm"], [f[2] for f in press["force_n"]])
    remarks = list(curve.remarks)
    keep = curve.depth_mm <= AHEAD * law.deepest_mm
    if not keep.all():
        remarks.append(
            f"{int((~keep).sum())} rows deeper than the press ({law.deepest_mm:.3g} mm) left out"
        )
    if keep.sum() < 3:
        keep[:] = True
        remarks[-1] = f"all but two rows are deeper than the press ({law.deepest_mm:.3g} mm)"
    depth, force = _averaged(curve.depth_mm[keep], curve.force_n[keep])
    weight = np.maximum(np.abs(force), FLOOR * float(force.max()))
    return _Item(curve, press, law, depth, force, weight, remarks)


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


def _solve(
    items: Sequence[_Item], zero_force: bool = False
) -> tuple[np.ndarray, np.ndarray, float]:
    """ln m and the offsets, half widths of their 95 % intervals, and the least squares; with
    ``zero_force`` what the load cell reads in air behind them, in largest forces."""
    from scipy.optimize import least_squares
    from scipy.stats import t

    def residuals(theta: np.ndarray) -> np.ndarray:
        zero = theta[-1] if zero_force else 0.0
        return np.concatenate([
            (math.exp(theta[0]) * item.law.force_n(item.depth - d0) + zero * item.force.max()
             - item.force) / item.weight
            for item, d0 in zip(items, theta[1:], strict=not zero_force)
        ])  # fmt: skip

    tops = [np.log(i.force[-1] / i.law.force_n(i.depth[-1:])[0]) for i in items if i.force[-1] > 0]
    start = float(np.median(tops)) if tops else 0.0
    far = [min(FAR_MM, 0.9 * float(item.depth.max())) for item in items]
    best = None
    for shift in (0.0, -0.3, 0.3):
        guess = np.array([start, *(shift * f for f in far)])
        low, high = np.array([-12.0, *(-f for f in far)]), np.array([12.0, *far])
        scale = [0.1, *far]
        if zero_force:
            guess, scale = np.append(guess, 0.0), [*scale, 0.1]
            low, high = np.append(low, -1.0), np.append(high, 1.0)
        found = least_squares(
            residuals, np.clip(guess, low, high), bounds=(low, high), x_scale=scale
        )
        best = found if best is None or found.cost < best.cost else best
    assert best is not None
    dof = max(len(best.fun) - len(best.x), 1)
    variance = 2 * best.cost / dof
    covariance = variance * np.linalg.pinv(best.jac.T @ best.jac)
    half = float(t.ppf(0.975, dof)) * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return best.x, half, float(best.cost)


def _fit_gel(
    study: Study, row: DesignRow, unit: str, usable: Sequence[tuple[MeasuredCurve, dict[str, Any]]]
) -> FittedGel:
    items = [_prepared(curve, press) for curve, press in usable]
    theta, half, _ = _solve(items)
    layers = study.family.parameters(row.parameters).layer_materials()
    stated = layers[0].young_modulus_pa * 1e-6
    wide = math.hypot(half[0], math.log1p(MODEL))
    modulus = stated * math.exp(theta[0])
    curves = []
    for number, item in enumerate(items):
        alone = theta if len(items) == 1 else _solve([item])[0]
        curves.append(
            _fitted_curve(
                item,
                math.exp(theta[0]),
                theta[number + 1],
                half[number + 1],
                stated * math.exp(alone[0]),
            )
        )
    return FittedGel(
        design=row.id,
        unit=unit,
        design_modulus_mpa=stated,
        modulus_mpa=modulus,
        interval_mpa=(modulus * math.exp(-wide), modulus * math.exp(wide)),
        ratio=math.exp(theta[0]),
        curves=curves,
    )


def _fitted_curve(
    item: _Item, ratio: float, offset: float, half: float, alone_mpa: float
) -> FittedCurve:
    unit = item.law.force_n(item.depth - offset)
    rest = ratio * unit - item.force
    touch = item.curve.touch_mm
    remarks = list(item.remarks)
    if abs(offset) > 0.98 * min(FAR_MM, 0.9 * float(item.depth.max())):
        remarks.append("the zero offset ends at its bound: look at the depths")
    remark = _zero_force_remark(item, rest)
    remarks += [remark] if remark else []
    return FittedCurve(
        file=item.curve.spec.file,
        indenter=item.curve.spec.indenter,
        offset_mm=float(touch + offset),
        offset_interval_mm=(float(touch + offset - half), float(touch + offset + half)),
        modulus_alone_mpa=alone_mpa,
        rms_n=float(np.sqrt(np.mean(rest**2))),
        relative_rms=float(np.sqrt(np.mean(rest**2)) / item.force.max()),
        worst_n=float(np.abs(rest).max()),
        rows=len(item.curve.depth_mm),
        depth_mm=(touch + item.depth).tolist(),
        force_n=item.force.tolist(),
        fitted_n=(ratio * unit).tolist(),
        predicted_n=unit.tolist(),
        contact_rms_mm=_contact_rms_mm(item, ratio),
        remarks=remarks,
    )


def _zero_force_remark(item: _Item, rest: np.ndarray) -> str:
    """Whether a load cell that reads something in air would explain most of the residuals."""
    if len(item.force) < ROWS_FOR_ZERO:
        return ""
    theta, half, _ = _solve([item], zero_force=True)
    largest = float(item.force.max())
    fitted = math.exp(theta[0]) * item.law.force_n(item.depth - theta[1]) + theta[2] * largest
    rms, before = (float(np.sqrt(np.mean(r**2))) for r in (fitted - item.force, rest))
    if abs(theta[2]) < half[2] or rms > before / 2 or before < LEAST_RMS * largest:
        return ""
    return (
        f"{theta[2] * largest:+.2g} N in all forces would leave {rms / largest:.1%} in place of "
        f"{before / largest:.1%}, at {math.exp(theta[0]):.3g} times the design's modulus: does the "
        "load cell read that in air?"
    )


def _contact_rms_mm(item: _Item, ratio: float) -> float | None:
    measured, simulated = item.curve.contact_diameter_mm, item.press.get("contact_diameter_mm")
    if measured is None or simulated is None:
        return None
    known = np.isfinite(measured) & (item.curve.force_n > 0)
    if not known.any():
        return None
    depth = item.law.depth_mm(item.curve.force_n[known] / ratio)
    at = np.interp(depth, [0.0, *item.press["depth_mm"]], [0.0, *simulated])
    return float(np.sqrt(np.mean((at - measured[known]) ** 2)))
