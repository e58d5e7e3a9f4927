# SPDX-License-Identifier: Apache-2.0
"""Simulated force over depth, Poisson's ratio and law, as a smooth function with its own error.

Each force is that of a press as ``taccel-lab press`` simulates it: the mesh of its own depth, the
same steps on the way. Presses are simulated at Chebyshev nodes of s = sqrt(1 - 2 nu) (and of the
Mooney ratio), in which forces are nearly polynomial up to incompressibility: with four nodes over
nu 0.30 to 0.499 they are met to 0.03 %, with five to 0.005 % (a ball of 7.5 mm, 0.4 mm deep in the
GelSight Mini's gel). Presses between the nodes measure the error of the table; that of the mesh is
what such presses keep to.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.material.gel import UNIT_MODULUS_PA, CurveTool, Gel
from taccel_lab.calibration.material.gel_presses import GelBench
from taccel_lab.calibration.material.interpolation import ParameterAxis, ResponseTable
from taccel_lab.calibration.result import NORMAL_95
from taccel_lab.errors import InputError
from taccel_lab.presses import PressPath
from taccel_lab.presses.press_error import expected_error
from taccel_lab.progress import Progress, silent

NU_RANGE = (0.30, 0.499)
"""Poisson's ratios that a free fit may take."""
NU_NODES, RATIO_NODES = 4, 3
DEPTHS = 7
SHALLOWEST = 0.08
"""Least simulated depth as a part of the deepest; below, force grows with depth as in Hertz'
law."""
_GRID = 1.1
"""Depth ranges are rounded outwards to powers of this, so that similar records share a table."""
_CHECK_NU = 0.4775
"""Between the nodes, where gels are."""
_CHECK_RATIO = 0.3


@dataclass(frozen=True)
class TableError:
    """How far a table is from the solution, as a part of the force."""

    interpolation: float
    """Greatest difference to a press between the nodes."""
    mesh: np.ndarray
    """Error of the presses at each depth, see ``presses.press_error``, as one standard deviation,
    shape [depth]."""

    @property
    def scale(self) -> float:
        """Relative error of Young's modulus that a table may cause, one standard deviation."""
        return math.hypot(self.interpolation, float(np.sqrt(np.mean(self.mesh**2))))


@dataclass(frozen=True)
class ForceTable:
    """Force of a gel of 1 Pa over depth, Poisson's ratio and Mooney ratio."""

    exponent: float
    """Power of the depth that is taken out of the force: 1.5 of a ball, 1 of a flat end."""
    responses: ResponseTable
    """ln(F / depth^exponent) over Mooney ratio, Poisson's ratio and ln depth."""
    error: TableError
    seconds: float = 0.0
    """What the simulations took, whenever that was."""
    press_count: int = 0

    @property
    def nu_range(self) -> tuple[float, float]:
        """Poisson's ratios of the table; equal where it is held."""
        return self.responses.second.low, self.responses.second.high

    def log_force(
        self, depth_mm: np.ndarray, poisson_ratio: float, mooney_ratio: float = 0.0
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """ln F of a gel of 1 Pa at depths > 0, and its derivatives by depth [1/mm], nu and ratio.

        All of shape [point].
        """
        log = np.log(depth_mm)
        value, by_ratio, by_nu, by_log = self.responses.at(mooney_ratio, poisson_ratio, log)
        return (
            value + self.exponent * log,
            (by_log + self.exponent) / depth_mm,
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


def free_nu_range(largest_ratio: float) -> tuple[float, float]:
    """Poisson's ratios that a fit may take beside Mooney ratios up to the largest.

    Mooney and Rivlin's law needs nu >= r / (1 + 2 r) (``ipc.elasticity.mooney_rivlin``).
    """
    least = math.ceil(1e3 * (largest_ratio / (1 + 2 * largest_ratio) + 0.001)) * 1e-3
    return max(NU_RANGE[0], least), NU_RANGE[1]


def force_table(
    gel: Gel,
    tool: CurveTool,
    depth_range_mm: tuple[float, float],
    *,
    free_nu: bool = True,
    free_ratio: bool = True,
    friction: float = 0.0,
    progress: Progress = silent,
) -> ForceTable:
    """Simulate the presses of a table, or take it from the cache.

    Args:
        gel: The pad, and what of its law is not to be fitted.
        tool: What comes down, and where.
        depth_range_mm: Depths of the record; the table reaches a little deeper.
        free_nu: Whether Poisson's ratio is to be fitted; else one press suffices.
        free_ratio: Whether the Mooney ratio is, of the law that has one.
        friction: Between tool and gel.
        progress: Told how many presses are done, and of how many.

    Raises:
        InputError: A depth past the gel.
        SimulationError: A press that did not converge.
    """
    depths = _depths(depth_range_mm)
    _require_depth(gel, depths[-1], depth_range_mm[1])
    axes = _axes(gel, free_nu, free_ratio and gel.material.model == "mooney_rivlin")
    counts = (RATIO_NODES, NU_NODES)
    ratios, nus = (axis.nodes(count) for axis, count in zip(axes, counts, strict=True))
    gels = [gel.with_law(float(nu), float(ratio)) for ratio in ratios for nu in nus]
    free = not all(axis.held for axis in axes)
    check_ratio = axes[0].low if axes[0].held else _CHECK_RATIO
    check_nu = axes[1].low if axes[1].held else _CHECK_NU
    if free:
        gels.append(gel.with_law(check_nu, check_ratio))
    task = f"presses of {tool.description}" + (f", friction {friction:g}" if friction else "")
    rows: list[list[dict[str, np.ndarray]]] = []
    total = len(depths) * len(gels)
    for depth in depths.tolist():
        bench, row = GelBench(gel, tool, depth), []
        for each in gels:
            progress(task, len(rows) * len(gels) + len(row), total)
            row.append(bench.pressed(each, friction))
        rows.append(row)
    progress(task, total, total)
    exponent = 1.5 if tool.kind == "sphere" else 1.0
    forces = np.array([[item["force_n"][0] for item in row] for row in rows]).T
    reduced = np.log(forces / UNIT_MODULUS_PA) - exponent * np.log(depths)
    at_nodes = reduced[: len(ratios) * len(nus)].reshape(len(ratios), len(nus), len(depths))
    responses = ResponseTable.through(*axes, np.log(depths), at_nodes)
    between = responses.at(check_ratio, check_nu, np.log(depths)).value
    return ForceTable(
        exponent=exponent,
        responses=responses,
        error=TableError(
            float(np.abs(reduced[-1] - between).max()) if free else 0.0,
            _press_errors(gel, tool, depths, friction) / NORMAL_95,
        ),
        seconds=float(sum(item["seconds"] for row in rows for item in row)),
        press_count=len(gels) * len(depths),
    )


def _axes(gel: Gel, free_nu: bool, free_ratio: bool) -> tuple[ParameterAxis, ParameterAxis]:
    """Of the Mooney ratio and of Poisson's ratio."""
    nu, ratio = gel.material.poisson_ratio, gel.material.mooney_ratio
    ratios = (0.0, 1.0) if free_ratio else (ratio, ratio)
    nus = free_nu_range(ratios[1]) if free_nu else (nu, nu)
    return ParameterAxis(*ratios), ParameterAxis(*nus, "compressibility")


def _press_errors(gel: Gel, tool: CurveTool, depths_mm: np.ndarray, friction: float) -> np.ndarray:
    """Relative errors that presses to these depths [mm] keep to, [depth]."""
    steps_mm = depths_mm / [len(PressPath(depth).waypoints()) for depth in depths_mm.tolist()]
    return expected_error(
        gel.physics,
        tool.indenter().shape,
        np.ones_like(depths_mm),
        1e-3 * depths_mm,
        1e-3 * steps_mm,
        friction,
    ).force_n


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
