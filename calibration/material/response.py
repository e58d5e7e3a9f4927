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
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from taccel_lab.calibration.material.candidates import Candidate, Reader, prepare, simulate
from taccel_lab.calibration.material.gel_presses import GelPresses, MaterialStep, Stop
from taccel_lab.calibration.material.setup import UNIT_MODULUS_PA, Gel, Tool
from taccel_lab.calibration.material.surface_fit import (
    chebyshev_basis,
    chebyshev_nodes,
    fit_surface,
)
from taccel_lab.envs import PressPath, profile_material
from taccel_lab.envs.physics import PHYSICS, Accuracy, PressPhysics
from taccel_lab.errors import InputError

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
        ratios, dratios = chebyshev_basis(2 * mooney_ratio - 1, c.shape[0])
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
        z, by_nu = _place(poisson_ratio, self.nu_range)
        basis, slope = chebyshev_basis(z, count)
        return basis, slope * by_nu


def free_nu_range(fixed_ratio: float | None) -> tuple[float, float]:
    """Poisson's ratios that a fit may take beside a Mooney ratio, of any when None.

    Mooney and Rivlin's law needs nu >= r / (1 + 2 r) (``ipc.elasticity.mooney_rivlin``).
    """
    ratio = 1.0 if fixed_ratio is None else fixed_ratio
    least = math.ceil(1e3 * (ratio / (1 + 2 * ratio) + 0.001)) * 1e-3
    return max(NU_RANGE[0], least), NU_RANGE[1]


def _place(poisson_ratio: float, nu_range: tuple[float, float]) -> tuple[float, float]:
    """z in -1..1 of sqrt(1 - 2 nu) between its ends, and dz/dnu."""
    s, high, low = (math.sqrt(1 - 2 * nu) for nu in (poisson_ratio, *nu_range))
    return (2 * s - high - low) / (high - low), -2 / ((high - low) * s)


def force_table(
    gel: Gel,
    tool: Tool,
    depth_range_mm: tuple[float, float],
    *,
    fixed_nu: float | None = None,
    fixed_ratio: float | None = None,
    friction: float = 0.0,
    physics: PressPhysics = PHYSICS[Accuracy.DEFAULT],
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
        physics: Of the presses.
        progress: Told how many presses are done, and of how many.

    Raises:
        InputError: A depth past the gel.
        SimulationError: A press that did not converge.
    """
    depths = _depths(depth_range_mm)
    _require_depth(gel, depths[-1], depth_range_mm[1])
    if gel.material.model != "mooney_rivlin":
        fixed_ratio = 0.0
    # Over an edge nodes slip by jumps: slopes at one nu are not those of the curve.
    if friction == 0 and tool.kind == "sphere":
        grid = _Grid(fixed_nu, fixed_ratio, sloped=True)
        table = _table(gel, tool, depths, grid, friction, physics, progress)
        if table is not None:
            return table
    grid = _Grid(fixed_nu, fixed_ratio, sloped=False)
    table = _table(gel, tool, depths, grid, friction, physics, progress)
    assert table is not None
    return table


@dataclass(frozen=True)
class _Grid:
    """Where presses are simulated."""

    fixed_nu: float | None
    fixed_ratio: float | None
    sloped: bool


def _table(
    gel: Gel,
    tool: Tool,
    depths: np.ndarray,
    grid: _Grid,
    friction: float,
    physics: PressPhysics,
    progress: Callable[[int, int], None] | None,
) -> ForceTable | None:
    """The table of a grid; None where slopes are wanted that a press does not have."""
    fixed_nu, fixed_ratio, sloped = grid.fixed_nu, grid.fixed_ratio, grid.sloped
    nu_count, ratio_count = (NU_NODES, RATIO_NODES) if sloped else (NU_VALUES, RATIO_VALUES)
    free = {"nu": fixed_nu is None, "ratio": fixed_ratio is None}
    slopes = tuple(name for name, is_free in free.items() if is_free and sloped)
    nu_range = free_nu_range(fixed_ratio)
    nus = _nodes(nu_range, nu_count) if fixed_nu is None else np.array([fixed_nu])
    ratios = chebyshev_nodes(ratio_count) if fixed_ratio is None else np.array([fixed_ratio])
    check_nu = _CHECK_NU if fixed_nu is None else fixed_nu
    check_ratio = 0.3 if fixed_ratio is None else fixed_ratio
    gels = [(float(nu), float(ratio), slopes) for ratio in ratios for nu in nus]
    if any(free.values()):
        gels.append((check_nu, check_ratio, ()))
    total = len(gels) * len(depths)
    found: list[list[dict[str, np.ndarray]]] = []

    def told(done: int, _: int = 0) -> None:
        if progress is not None:
            progress(len(found) * len(gels) + done, total)

    for depth in depths.tolist():
        bench = gel.bench(tool, depth, physics)
        presses = [
            press_candidate(gel, tool, depth, nu, ratio, friction, physics, wanted)
            for nu, ratio, wanted in gels
        ]
        prepare(bench, presses, told)
        row = []
        for done, press in enumerate(presses):
            told(done)
            row.append(simulate(bench, press))
        found.append(row)
        finite = [np.isfinite(row[i][f"by_{n}_n"]).all() for i, g in enumerate(gels) for n in g[2]]
        if not all(finite):
            return None
    forces = np.array([[item["force_n"][0] for item in row] for row in found]).T
    seconds = float(sum(item["seconds"] for row in found for item in row))
    if progress is not None:
        progress(total, total)
    exponent = 1.5 if tool.kind == "sphere" else 1.0
    reduced = np.log(forces / UNIT_MODULUS_PA) - exponent * np.log(depths)
    shape = (len(ratios), len(nus), len(depths))
    count = len(ratios) * len(nus)

    def log_slopes(name: str, per: float | np.ndarray) -> np.ndarray | None:
        """d ln F by the parameter scaled to -1..1, at the nodes."""
        if name not in slopes:
            return None
        rows = np.array([[item[f"by_{name}_n"][0] for item in row[:count]] for row in found]).T
        return (rows / forces[:count]).reshape(shape) / per

    places = [_place(float(nu), nu_range) for nu in nus] if fixed_nu is None else [(0.0, 1.0)]
    coefficients = fit_surface(
        2 * ratios - 1,
        np.array([z for z, _ in places]),
        reduced[:count].reshape(shape),
        log_slopes("ratio", 2.0),
        log_slopes("nu", np.array([[slope] for _, slope in places])),
    )
    draft = ForceTable(
        tool, depths, exponent, nu_range, coefficients, TableError(0.0, np.zeros(1)), 0.0, 0
    )
    here = draft.log_force(depths, check_nu, check_ratio)[0]
    between = any(free.values())
    own = np.log(forces[-1] / UNIT_MODULUS_PA)
    interpolation = float(np.abs(own - here).max()) if between else 0.0
    mesh = np.array([row[-1]["error_n"][0] for row in found]) / forces[-1] / NINE_IN_TEN
    return ForceTable(
        tool=tool,
        depths_mm=depths,
        exponent=exponent,
        nu_range=nu_range if fixed_nu is None else (fixed_nu, fixed_nu),
        coefficients=coefficients,
        error=TableError(interpolation, mesh),
        seconds=seconds,
        press_count=total,
    )


def simulate_press(
    gel: Gel,
    tool: Tool,
    depths_mm: np.ndarray,
    poisson_ratio: float,
    mooney_ratio: float = 0.0,
    friction: float = 0.0,
    physics: PressPhysics = PHYSICS[Accuracy.DEFAULT],
) -> np.ndarray:
    """Forces [N] of presses of 1 MPa to each depth, shape [depth]."""
    found = []
    for depth in np.asarray(depths_mm).tolist():
        press = press_candidate(gel, tool, depth, poisson_ratio, mooney_ratio, friction, physics)
        found.append(simulate(gel.bench(tool, depth, physics), press))
    return np.array([float(item["force_n"][0]) for item in found])


def press_candidate(
    gel: Gel,
    tool: Tool,
    depth_mm: float,
    poisson_ratio: float,
    mooney_ratio: float,
    friction: float,
    physics: PressPhysics,
    slopes: Sequence[str] = (),
) -> Candidate:
    """A press to one depth, which may also give the slopes of its force over "nu" and the Mooney
    "ratio" [N], as ``by_nu_n`` and ``by_ratio_n``; ``error_n`` is its estimated error."""
    recipe = {
        "what": "press",
        "gel": gel.recipe(),
        "tool": tool.description,
        "at_mm": list(tool.at_mm),
        "depth_mm": depth_mm,
        "nu": poisson_ratio,
        "ratio": mooney_ratio,
        "friction": friction,
        "physics": physics.record(),
    }
    if slopes:
        recipe["slopes"] = list(slopes)

    def reader(env: GelPresses, together: Sequence[Candidate]) -> Reader:
        steps = [_material_step(gel, env, together, name) for name in slopes]

        def read() -> np.ndarray:
            both = np.column_stack([env.press_force[:, 2], env.error_estimate().force_n])
            return np.hstack([both, env.force_slopes(steps)]) if steps else both

        return read

    def arrays(rows: np.ndarray) -> dict[str, np.ndarray]:
        return dict(
            zip(["force_n", "error_n", *(f"by_{name}_n" for name in slopes)], rows.T, strict=True)
        )

    return Candidate(
        recipe,
        poisson_ratio,
        mooney_ratio,
        friction,
        [Stop(depth, read=depth == depth_mm) for depth, _, _ in PressPath(depth_mm).waypoints()],
        reader,
        arrays,
        must_reach=1,
    )


def _material_step(
    gel: Gel, env: GelPresses, together: Sequence[Candidate], name: str
) -> MaterialStep:
    """Gels beside those of the candidates along one parameter."""
    (soft,) = env.model.scene.soft_bodies
    sides, half = [], []
    for sign in (-1, 1):
        side = []
        for item in together:
            nu, ratio = item.poisson_ratio, item.mooney_ratio
            # Small beside what is left to 0.5, where lambda has its pole.
            step = _STEP * (0.5 - nu) if name == "nu" else _STEP
            half.append(step)
            nu, ratio = (nu + sign * step, ratio) if name == "nu" else (nu, ratio + sign * step)
            side.append(profile_material(gel.unit_material(nu, ratio), soft.mesh))
        sides.append(side)
    return MaterialStep(sides[0], sides[1], [2 * step for step in half[: len(together)]])


def _nodes(nu_range: tuple[float, float], count: int) -> np.ndarray:
    """Poisson's ratios at the Chebyshev nodes of sqrt(1 - 2 nu)."""
    high, low = (math.sqrt(1 - 2 * nu) for nu in nu_range)
    s = 0.5 * (high + low) + 0.5 * (high - low) * (2 * chebyshev_nodes(count) - 1)
    return 0.5 * (1 - s**2)


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
