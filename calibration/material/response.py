# SPDX-License-Identifier: Apache-2.0
"""Simulated force over depth, Poisson's ratio and law, as a smooth function with its own error.

Presses are simulated at Chebyshev nodes of s = sqrt(1 - 2 nu) (and of the Mooney ratio), in which
forces are nearly polynomial up to incompressibility: with five nodes over nu 0.30 to 0.499 they are
met to 0.04 %, with six nodes of nu itself to 0.06 %, of log(1 - 2 nu) to 0.08 %. One press between
the nodes measures that error, and one on a finer mesh the error of the mesh, which is corrected.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev
from scipy.interpolate import CubicSpline

from calibration.material.setup import (
    DHAT_M,
    REFEREE,
    STANDARD,
    UNIT_MODULUS_PA,
    Effort,
    Gel,
    Tool,
)
from calibration.material.store import kept
from taccel_lab.errors import InputError

NU_RANGE = (0.30, 0.499)
"""Poisson's ratios that a free fit may take."""
NU_NODES = 5
RATIO_NODES = 3
DEPTHS = 7
SHALLOWEST = 0.08
"""Least simulated depth as a part of the deepest; below, force goes with depth as in Hertz' law."""
_GRID = 1.1
"""Depth ranges are rounded outwards to powers of this, so that similar records share a table."""
_CHECK_NU = 0.4775
"""Between the nodes, where gels are; also the Poisson's ratio of the finer press."""


@dataclass(frozen=True)
class TableError:
    """How far a table is from the solution, as a part of the force."""

    interpolation: float
    """Greatest difference to a press between the nodes."""
    mesh: np.ndarray
    """Difference to a press on a finer mesh at each depth, shape [depth]; the table is corrected
    by it, so it bounds what is left."""

    @property
    def scale(self) -> float:
        """Relative error of Young's modulus that a table may cause, one standard deviation."""
        return math.hypot(self.interpolation, float(np.sqrt(np.mean(self.mesh**2))))


@dataclass(frozen=True)
class ForceTable:
    """ln force of a gel of 1 Pa over depth, Poisson's ratio and Mooney ratio."""

    tool: Tool
    depths_mm: np.ndarray
    """Rising, shape [depth]."""
    exponent: float
    """Power of the depth that is taken out of the force: 1.5 of a ball, 1 of a flat end."""
    nu_range: tuple[float, float]
    """Equal where Poisson's ratio is fixed."""
    coefficients: np.ndarray
    """Chebyshev coefficients of ln(F / depth^exponent), shape [ratio, nu, depth]."""
    error: TableError
    seconds: float
    """What the simulations took, whenever that was."""
    press_count: int

    def __post_init__(self) -> None:
        spline = CubicSpline(np.log(self.depths_mm), self.coefficients, axis=2)
        object.__setattr__(self, "_spline", spline)
        object.__setattr__(self, "_slope", spline.derivative())

    def log_force(
        self, depth_mm: np.ndarray, poisson_ratio: float, mooney_ratio: float = 0.0
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """ln F of a gel of 1 Pa at depths > 0, and its derivatives by depth [1/mm], nu and ratio.

        All of shape [point].
        """
        x = np.log(np.clip(depth_mm, self.depths_mm[0], self.depths_mm[-1]))
        c = self._spline(x)  # type: ignore[attr-defined]
        slope = self._slope(x)  # type: ignore[attr-defined]
        slope[..., depth_mm < self.depths_mm[0]] = 0.0
        slope[..., depth_mm > self.depths_mm[-1]] = 0.0
        basis, dbasis = self._nu_basis(poisson_ratio)
        ratios, dratios = _basis(2 * mooney_ratio - 1, c.shape[0])
        terms = np.stack(
            [
                np.outer(ratios, basis).ravel(),
                np.outer(ratios, dbasis).ravel(),
                np.outer(2 * dratios, basis).ravel(),
            ]
        )
        value, by_nu, by_ratio = terms @ c.reshape(terms.shape[1], -1)
        by_depth = terms[0] @ slope.reshape(terms.shape[1], -1)
        return (
            value + self.exponent * np.log(depth_mm),
            (by_depth + self.exponent) / depth_mm,
            by_nu,
            by_ratio,
        )

    def force_n(
        self,
        depth_mm: np.ndarray,
        young_modulus_pa: float,
        poisson_ratio: float,
        mooney_ratio: float = 0.0,
    ) -> np.ndarray:
        """Force [N] at depths [mm]; none above the gel."""
        depth = np.asarray(depth_mm, dtype=float)
        force = np.zeros_like(depth)
        inside = depth > 0
        if inside.any():
            log = self.log_force(depth[inside], poisson_ratio, mooney_ratio)[0]
            force[inside] = young_modulus_pa * np.exp(log)
        return force

    def _nu_basis(self, poisson_ratio: float) -> tuple[np.ndarray, np.ndarray]:
        """Chebyshev polynomials at nu, and their derivatives by nu."""
        count = self.coefficients.shape[1]
        if count == 1:
            return np.ones(1), np.zeros(1)
        s, high, low = (math.sqrt(1 - 2 * nu) for nu in (poisson_ratio, *self.nu_range))
        basis, slope = _basis((2 * s - high - low) / (high - low), count)
        return basis, slope * 2 / (high - low) * (-1 / s)


def _basis(z: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """T_0 .. T_{count-1} at z and their derivatives."""
    # T_k = cos(k a) and T_k' = k sin(k a) / sin(a), by their recurrences: quicker than numpy's.
    value, slope = [1.0, z], [0.0, 1.0]
    for _ in range(2, count):
        value.append(2 * z * value[-1] - value[-2])
        slope.append(2 * value[-2] + 2 * z * slope[-1] - slope[-2])
    return np.array(value[:count]), np.array(slope[:count])


def force_table(
    gel: Gel,
    tool: Tool,
    depth_range_mm: tuple[float, float],
    *,
    fixed_nu: float | None = None,
    fixed_ratio: float | None = None,
    friction: float = 0.0,
    effort: Effort = STANDARD,
    checked: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> ForceTable:
    """Simulate the presses of a table, or take it from the cache.

    Args:
        gel: The pad and the law.
        tool: What comes down, and where.
        depth_range_mm: Depths of the record; the table reaches a little deeper.
        fixed_nu: Poisson's ratio where it is not to be fitted; one press suffices then.
        fixed_ratio: Mooney ratio, likewise; 0 of other laws.
        friction: Between tool and gel.
        effort: Mesh of the presses.
        checked: Whether a finer mesh corrects the table and tells its error.
        progress: Told how many presses are done, and of how many.

    Raises:
        InputError: A depth past the gel.
        SimulationError: A press that did not converge.
    """
    depths = _depths(depth_range_mm)
    _require_depth(gel, depths[-1], depth_range_mm[1])
    if gel.material.model != "mooney_rivlin":
        fixed_ratio = 0.0
    nus = _nodes(NU_RANGE, NU_NODES) if fixed_nu is None else np.array([fixed_nu])
    ratios = _unit_nodes(RATIO_NODES) if fixed_ratio is None else np.array([fixed_ratio])
    check_nu = _CHECK_NU if fixed_nu is None else fixed_nu
    check_ratio = 0.3 if fixed_ratio is None else fixed_ratio
    free = fixed_nu is None or fixed_ratio is None
    jobs = [(nu, ratio, effort) for ratio in ratios for nu in nus]
    if free:
        jobs.append((check_nu, check_ratio, effort))
    if checked:
        jobs.append((check_nu, check_ratio, REFEREE[effort.name]))
    forces, seconds = [], 0.0
    for done, (nu, ratio, fineness) in enumerate(jobs):
        if progress is not None:
            progress(done, len(jobs))
        found = simulate_press(gel, tool, depths, float(nu), float(ratio), friction, fineness)
        forces.append(found["force_n"])
        seconds += float(found["seconds"])
    if progress is not None:
        progress(len(jobs), len(jobs))
    exponent = 1.5 if tool.kind == "sphere" else 1.0
    reduced = np.log(np.array(forces) / UNIT_MODULUS_PA) - exponent * np.log(depths)
    count = len(ratios) * len(nus)
    values = reduced[:count].reshape(len(ratios), len(nus), -1)
    coefficients = _transform(_transform(values, 0), 1)
    draft = ForceTable(
        tool, depths, exponent, NU_RANGE, coefficients, TableError(0.0, np.zeros(1)), 0.0, 0
    )
    here = draft.log_force(depths, check_nu, check_ratio)[0] - exponent * np.log(depths)
    interpolation = float(np.abs(reduced[count] - here).max()) if free else 0.0
    own = reduced[count] if free else here
    correction = reduced[-1] - own if checked else np.zeros(len(depths))
    coefficients[0, 0] += correction
    return ForceTable(
        tool=tool,
        depths_mm=depths,
        exponent=exponent,
        nu_range=NU_RANGE if fixed_nu is None else (fixed_nu, fixed_nu),
        coefficients=coefficients,
        error=TableError(interpolation, np.abs(correction)),
        seconds=seconds,
        press_count=len(jobs),
    )


def simulate_press(
    gel: Gel,
    tool: Tool,
    depths_mm: np.ndarray,
    poisson_ratio: float,
    mooney_ratio: float,
    friction: float,
    effort: Effort,
) -> dict[str, np.ndarray]:
    """Forces [N] of one press of 1 MPa at rising depths, and the seconds that it took."""

    def simulate() -> dict[str, np.ndarray]:
        mesh = gel.mesh(tool, float(depths_mm[-1]), effort)
        env = gel.environment(tool, mesh, poisson_ratio, mooney_ratio, friction)
        forces, seconds = [], 0.0
        for depth in depths_mm:
            seconds += env.move_to(float(depth)).seconds
            forces.append(env.press_force[0, 2])
        return {"force_n": np.array(forces), "seconds": np.array(seconds)}

    recipe = {
        "what": "press",
        "gel": gel.recipe(),
        "tool": tool.description,
        "at_mm": list(tool.at_mm),
        "depths_mm": depths_mm,
        "nu": poisson_ratio,
        "ratio": mooney_ratio,
        "friction": friction,
        "effort": effort.recipe(),
        "dhat_m": DHAT_M,
    }
    return kept(recipe, simulate)


def _nodes(nu_range: tuple[float, float], count: int) -> np.ndarray:
    """Poisson's ratios at the Chebyshev nodes of sqrt(1 - 2 nu)."""
    high, low = (math.sqrt(1 - 2 * nu) for nu in nu_range)
    s = 0.5 * (high + low) + 0.5 * (high - low) * (2 * _unit_nodes(count) - 1)
    return 0.5 * (1 - s**2)


def _unit_nodes(count: int) -> np.ndarray:
    """Chebyshev nodes in 0..1."""
    return 0.5 * (1 + np.cos(math.pi * (np.arange(count) + 0.5) / count))


def _transform(values: np.ndarray, axis: int) -> np.ndarray:
    """Chebyshev coefficients of values at the nodes of ``axis``."""
    count = values.shape[axis]
    nodes = 2 * _unit_nodes(count) - 1
    inverse = np.linalg.inv(chebyshev.chebvander(nodes, count - 1))
    return np.moveaxis(np.tensordot(inverse, values, (1, axis)), 0, axis)


def _depths(depth_range_mm: tuple[float, float]) -> np.ndarray:
    low, high = depth_range_mm
    deepest = _GRID ** math.ceil(math.log(high * 1.03, _GRID))
    # Shallower than the record: the fit may find that the tool touched later.
    shallowest = _GRID ** math.floor(math.log(max(0.5 * low, 1e-6), _GRID))
    shallowest = min(max(shallowest, SHALLOWEST * deepest), 0.2 * deepest)
    return shallowest + (deepest - shallowest) * np.linspace(0, 1, DEPTHS) ** 1.4


def _require_depth(gel: Gel, deepest_mm: float, recorded_mm: float) -> None:
    limit = 0.75 * gel.thickness_mm
    if deepest_mm > limit:
        raise InputError(
            f"the record goes {recorded_mm:g} mm deep and the gel is {gel.thickness_mm:g} mm "
            f"thick; at most {limit / 1.13:.3g} mm can be simulated. Is the depth in mm, and "
            "counted from first touch?"
        )
