# SPDX-License-Identifier: Apache-2.0
"""Simulated force over depth, Poisson's ratio and law, as a smooth function with its own error.

Each force is that of a press as ``taccel-lab press`` simulates it: the mesh of its own depth, the
same steps on the way. Presses are simulated at Chebyshev nodes of s = sqrt(1 - 2 nu) (and of the
Mooney ratio), in which forces are nearly polynomial up to incompressibility: with five nodes over
nu 0.30 to 0.499 they are met to 0.04 %, with six nodes of nu itself to 0.06 %, of log(1 - 2 nu) to
0.08 %. The press of a ball also gives the slope of its force over nu and over the Mooney ratio by
the implicit function theorem, for a tenth of its time; three nodes with slopes are as good as five
of values. With friction there are no such slopes, and for tools with edges they are not used.
Presses between the nodes measure the error of the table; that of the mesh is the estimate of
``PressEnv``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from taccel_lab.calibration.material.gel import UNIT_MODULUS_PA, Gel, Tool
from taccel_lab.calibration.material.gel_presses import GelPresses, MaterialStep, Stop
from taccel_lab.calibration.material.interpolation import Axis, ResponseTable
from taccel_lab.calibration.material.press_plans import GelBench, PressPlan, simulate_each
from taccel_lab.errors import InputError
from taccel_lab.presses import PressPath, profile_material
from taccel_lab.progress import Progress, silent

NU_RANGE = (0.30, 0.499)
"""Poisson's ratios that a free fit may take."""
NU_NODES, RATIO_NODES = 3, 2
"""Nodes whose slopes are known."""
NU_VALUES, RATIO_VALUES = 5, 3
"""Nodes without slopes."""
DEPTHS = 7
SHALLOWEST = 0.08
"""Least simulated depth as a part of the deepest; below, force goes with depth as in Hertz' law."""
_GRID = 1.1
"""Depth ranges are rounded outwards to powers of this, so that similar records share a table."""
_STEP = 1e-5
"""Of parameters in slopes of elastic forces; these are linear in the moduli."""
_CHECK_NU = 0.4775
"""Between the nodes, where gels are; also the Poisson's ratio at which the mesh's error is told."""
_CHECK_RATIO = 0.3
NINE_IN_TEN = 1.645
"""Standard deviations that an error stays below in nine of ten cases."""


@dataclass(frozen=True)
class TableError:
    """How far a table is from the solution, as a part of the force."""

    interpolation: float
    """Greatest difference to a press between the nodes."""
    mesh: np.ndarray
    """Estimated error of the presses at each depth, see ``PressEnv.error_estimate``, as one
    standard deviation, shape [depth]."""

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

    @property
    def held_law(self) -> tuple[float, float]:
        """Poisson's ratio and Mooney ratio of a table that holds them."""
        return self.responses.second.low, self.responses.first.low

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
    tool: Tool,
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
    # Over an edge nodes slip by jumps: slopes at one nu are not those of the curve.
    smooth = friction == 0 and tool.kind == "sphere"
    for sloped in (True, False) if smooth else (False,):
        table = _table(gel, tool, depths, axes, sloped, friction, progress)
        if table is not None:
            return table
    raise AssertionError("a table of values needs no slopes")


def _axes(gel: Gel, free_nu: bool, free_ratio: bool) -> tuple[Axis, Axis]:
    """Of the Mooney ratio and of Poisson's ratio."""
    nu, ratio = gel.material.poisson_ratio, gel.material.mooney_ratio
    ratios = (0.0, 1.0) if free_ratio else (ratio, ratio)
    nus = free_nu_range(ratios[1]) if free_nu else (nu, nu)
    return Axis(*ratios), Axis(*nus, "compressibility")


def _table(
    gel: Gel,
    tool: Tool,
    depths: np.ndarray,
    axes: tuple[Axis, Axis],
    sloped: bool,
    friction: float,
    progress: Progress,
) -> ForceTable | None:
    """The table at the nodes of both axes; None where slopes are wanted that a press does not
    have."""
    names = tuple(
        name for name, axis in zip(("ratio", "nu"), axes, strict=True) if sloped and not axis.held
    )
    counts = (RATIO_NODES, NU_NODES) if sloped else (RATIO_VALUES, NU_VALUES)
    ratios, nus = (axis.nodes(count) for axis, count in zip(axes, counts, strict=True))
    gels = [(gel.with_law(float(nu), float(ratio)), names) for ratio in ratios for nu in nus]
    free = not all(axis.held for axis in axes)
    check_ratio = axes[0].low if axes[0].held else _CHECK_RATIO
    check_nu = axes[1].low if axes[1].held else _CHECK_NU
    if free:
        gels.append((gel.with_law(check_nu, check_ratio), ()))
    task = f"presses of {tool.description}" + (f", friction {friction:g}" if friction else "")
    rows: list[list[dict[str, np.ndarray]]] = []

    def told(_: str, done: int, each: int) -> None:
        progress(task, len(rows) * each + done, len(depths) * each)

    for depth in depths.tolist():
        bench = GelBench(gel, tool, depth)
        plans = [press_plan(bench, each, friction, wanted) for each, wanted in gels]
        row = list(simulate_each(bench, plans, told))
        rows.append(row)
        slopes = [row[k][f"by_{name}_n"] for k, (_, wanted) in enumerate(gels) for name in wanted]
        if not np.isfinite(slopes).all():
            return None

    def every(name: str, count: int) -> np.ndarray:
        """Of the first so many gels, shape [gel, depth]."""
        return np.array([[item[name][0] for item in row[:count]] for row in rows]).T

    exponent = 1.5 if tool.kind == "sphere" else 1.0
    count, shape = len(ratios) * len(nus), (len(ratios), len(nus), len(depths))
    forces = every("force_n", len(gels))
    reduced = np.log(forces / UNIT_MODULUS_PA) - exponent * np.log(depths)
    relative = {name: (every(f"by_{name}_n", count) / forces[:count]).reshape(shape)
                for name in names}  # fmt: skip
    responses = ResponseTable.through(
        *axes, np.log(depths), reduced[:count].reshape(shape),
        (relative.get("ratio"), relative.get("nu")),
    )  # fmt: skip
    between = responses.at(check_ratio, check_nu, np.log(depths)).value
    return ForceTable(
        exponent=exponent,
        responses=responses,
        error=TableError(
            float(np.abs(reduced[-1] - between).max()) if free else 0.0,
            np.array([row[-1]["error_n"][0] for row in rows]) / forces[-1] / NINE_IN_TEN,
        ),
        seconds=float(sum(item["seconds"] for row in rows for item in row)),
        press_count=len(gels) * len(depths),
    )


def press_plan(
    bench: GelBench,
    gel: Gel,
    friction: float = 0.0,
    slopes: Sequence[str] = (),
) -> PressPlan:
    """A press of a gel to the depth of the bench: ``force_n`` and its estimated error ``error_n``.

    It may also give the slopes of its force over "nu" and the Mooney "ratio" [N], as ``by_nu_n``
    and ``by_ratio_n``.
    """
    way: dict[str, Any] = {"slopes": list(slopes)} if slopes else {}

    def read(env: GelPresses, together: Sequence[PressPlan]) -> np.ndarray:
        both = np.column_stack([env.press_force[:, 2], env.error_estimate().force_n])
        steps = [_material_step(gel, env, together, name) for name in slopes]
        return np.hstack([both, env.force_slopes(steps)]) if steps else both

    def arrays(rows: np.ndarray) -> dict[str, np.ndarray]:
        return dict(
            zip(["force_n", "error_n", *(f"by_{name}_n" for name in slopes)], rows.T, strict=True)
        )

    goal = bench.depth_mm
    stops = [Stop(depth, read=depth == goal) for depth, _, _ in PressPath(goal).waypoints()]
    way |= {"depth_mm": goal, "friction": friction}
    return bench.plan("press", gel, friction, way, stops, read, arrays, must_reach=1)


def _material_step(
    gel: Gel, env: GelPresses, together: Sequence[PressPlan], name: str
) -> MaterialStep:
    """Gels beside those of the plans along one parameter."""
    (soft,) = env.model.scene.soft_bodies
    # Small beside what is left to 0.5, where lambda has its pole.
    half = [_STEP * (0.5 - plan.poisson_ratio if name == "nu" else 1.0) for plan in together]
    sides = []
    for sign in (-1, 1):
        gels = [
            (plan.poisson_ratio + sign * step, plan.mooney_ratio)
            if name == "nu"
            else (plan.poisson_ratio, plan.mooney_ratio + sign * step)
            for plan, step in zip(together, half, strict=True)
        ]
        sides.append([profile_material(gel.with_law(*g).unit_material(), soft.mesh) for g in gels])
    return MaterialStep(sides[0], sides[1], [2 * step for step in half])


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
