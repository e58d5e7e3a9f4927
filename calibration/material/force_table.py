# SPDX-License-Identifier: Apache-2.0
"""Simulated force over depth and Poisson's ratio, as a smooth function with its own error.

Each force is that of a press as ``taccel-lab press`` simulates it: the mesh of its own depth, the
same steps on the way, with the press beside it. Presses are simulated at Chebyshev nodes of
s = sqrt(1 - 2 nu), in which forces are nearly polynomial up to incompressibility: with four nodes
over nu 0.30 to 0.499 they are met to 0.03 %, with five to 0.005 % (a ball of 7.5 mm, 0.4 mm deep in
the GelSight Mini's gel). Over the depth a cubic spline goes through them. Presses between the nodes
measure the error of the table; that of the mesh is what the presses state.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.polynomial.chebyshev import chebpts1
from scipy.interpolate import CubicSpline

from taccel_lab.calibration.material.gel import UNIT_MODULUS_PA, CurveTool, Gel
from taccel_lab.errors import InputError
from taccel_lab.files.file_cache import cached_arrays
from taccel_lab.geometry import PixelGrid
from taccel_lab.presses import (
    PressOutcome,
    PressPath,
    PressSetup,
    profile_material,
    simulate_press,
)
from taccel_lab.presses.mesh import is_beside_edge
from taccel_lab.presses.numerical_error import measured_press
from taccel_lab.presses.outcome import SeenFrom
from taccel_lab.presses.resolution import Resolution
from taccel_lab.progress import Progress, silent
from taccel_lab.with_error import NORMAL_95

NU_RANGE = (0.30, 0.499)
"""Poisson's ratios that a free fit may take."""
NU_NODES = 4
DEPTHS = 7
SHALLOWEST = 0.08
"""Least simulated depth as a part of the deepest; below, force grows with depth as in Hertz'
law."""
_GRID = 1.1
"""Depth ranges are rounded outwards to powers of this, so that similar records share a table."""
_CHECK_NU = 0.4775
"""Poisson's ratio between the nodes, where gels are."""


@dataclass(frozen=True)
class TableError:
    """How far a table is from the solution, as a part of the force."""

    interpolation: float
    """Greatest difference to a press between the nodes."""
    mesh: np.ndarray
    """Error of the presses at each depth, see ``measured_press``, as one standard deviation, shape
    [depth]."""

    @property
    def scale(self) -> float:
        """Relative error of Young's modulus that a table may cause, one standard deviation."""
        return math.hypot(self.interpolation, float(np.sqrt(np.mean(self.mesh**2))))


@dataclass(frozen=True)
class ForceTable:
    """Force of a gel of 1 Pa over depth and Poisson's ratio."""

    exponent: float
    """Power of the depth that is taken out of the force: 1.5 of a ball, 1 of a flat end."""
    nu: np.ndarray
    """Poisson's ratios of the presses, rising, shape [node]; one where it is held."""
    depth_mm: np.ndarray
    """Rising, shape [depth]."""
    log_reduced: np.ndarray
    """ln(F / depth^exponent), shape [node, depth]."""
    error: TableError
    nu_range: tuple[float, float]
    """Poisson's ratios that the table holds for; equal where it is held."""
    seconds: float = 0.0
    """What the simulations took, whenever that was."""
    press_count: int = 0

    @cached_property
    def _splines(self) -> tuple[CubicSpline, CubicSpline]:
        """Splines over ln depth of the coefficients of a polynomial in s, [power]; and their
        slopes."""
        powers = np.vander(np.sqrt(1 - 2 * self.nu), increasing=True)
        coefficients = np.linalg.solve(powers, self.log_reduced)
        spline = CubicSpline(np.log(self.depth_mm), coefficients, axis=1)
        return spline, spline.derivative()

    def log_force(
        self, depth_mm: np.ndarray, poisson_ratio: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """ln F of a gel of 1 Pa at depths > 0, and its derivatives by depth [1/mm] and nu, all of
        shape [point]; beyond the table's depths only the power of the depth goes on."""
        spline, slope = self._splines
        log, ends = np.log(depth_mm), np.log(self.depth_mm[[0, -1]])
        within = np.clip(log, *ends)
        of_s, along = spline(within), np.where(within == log, slope(within), 0.0)
        s, power = math.sqrt(1 - 2 * poisson_ratio), np.arange(len(self.nu))
        by_s = power[1:] * s ** power[:-1]
        value = s**power @ of_s + self.exponent * log
        return value, (s**power @ along + self.exponent) / depth_mm, by_s @ of_s[1:] / -s

    def force_n(
        self, depth_mm: np.ndarray, young_modulus_pa: float, poisson_ratio: float
    ) -> np.ndarray:
        """Force [N] at depths [mm]; none above the gel."""
        depth = np.asarray(depth_mm, dtype=float)
        force = np.zeros_like(depth)
        inside = depth > 0
        if inside.any():
            log = self.log_force(depth[inside], poisson_ratio)[0]
            force[inside] = young_modulus_pa * np.exp(log)
        return force


def free_nu_range(mooney_ratio: float) -> tuple[float, float]:
    """Poisson's ratios that a fit may take beside a Mooney ratio.

    Mooney and Rivlin's law needs nu >= r / (1 + 2 r) (``ipc.elasticity.mooney_rivlin``).
    """
    least = math.ceil(1e3 * (mooney_ratio / (1 + 2 * mooney_ratio) + 0.001)) * 1e-3
    return max(NU_RANGE[0], least), NU_RANGE[1]


def force_table(
    gel: Gel,
    tool: CurveTool,
    depth_range_mm: tuple[float, float],
    *,
    free_nu: bool = True,
    friction: float = 0.0,
    progress: Progress = silent,
) -> ForceTable:
    """Simulate the presses of a table, or take it from the cache.

    Args:
        gel: The pad and its law; its Poisson's ratio where that is not to be fitted.
        tool: What comes down, and where.
        depth_range_mm: Depths of the record; the table reaches a little deeper.
        free_nu: Whether Poisson's ratio is to be fitted; else one press suffices.
        friction: Between tool and gel.
        progress: Told how many presses are done, and of how many.

    Raises:
        InputError: A depth past the gel.
        SimulationError: A press that did not converge.
    """
    depths = _depths(depth_range_mm)
    _require_depth(gel, depths[-1], depth_range_mm[1])
    nu = gel.material.poisson_ratio
    within = free_nu_range(gel.material.mooney_ratio) if free_nu else (nu, nu)
    nus = _nodes(*within, NU_NODES) if free_nu else np.array([nu])
    gels = [gel.with_law(each) for each in nus.tolist()]
    if free_nu:
        gels.append(gel.with_law(_CHECK_NU))
    task = f"presses of {tool.description}" + (f", friction {friction:g}" if friction else "")
    rows: list[list[dict[str, np.ndarray]]] = []
    total = len(depths) * len(gels)
    for depth in depths.tolist():
        bench, row = GelBench(gel, tool, depth, friction, within[1]), []
        for each in gels:
            progress(task, len(rows) * len(gels) + len(row), total)
            row.append(bench.pressed(each))
        rows.append(row)
    progress(task, total, total)
    exponent = 1.5 if tool.kind == "sphere" else 1.0
    forces = np.array([[item["force_n"][0] for item in row] for row in rows]).T
    reduced = np.log(forces / UNIT_MODULUS_PA) - exponent * np.log(depths)
    mesh = np.array([max(item["error"][0] for item in row) for row in rows]) / NORMAL_95
    table = ForceTable(
        exponent=exponent,
        nu=nus,
        depth_mm=depths,
        log_reduced=reduced[: len(nus)],
        error=TableError(0.0, mesh),
        nu_range=within,
        seconds=float(sum(item["seconds"] for row in rows for item in row)),
        press_count=len(gels) * len(depths),
    )
    if not free_nu:
        return table
    off = table.log_force(depths, _CHECK_NU)[0] - exponent * np.log(depths) - reduced[-1]
    return replace(table, error=TableError(float(np.abs(off).max()), mesh))


def _nodes(low: float, high: float, count: int) -> np.ndarray:
    """Poisson's ratios at the Chebyshev nodes of sqrt(1 - 2 nu) between two, rising."""
    least, most = math.sqrt(1 - 2 * high), math.sqrt(1 - 2 * low)
    s = 0.5 * (most + least) + 0.5 * (most - least) * chebpts1(count)[::-1]
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


RUBBING_LIMITS = {"max_substep_halvings": 3, "max_friction_lags": 60}
"""Limits of iterations, on which no result depends: with much friction a step that does not
converge soon will not."""
UNSEEN = SeenFrom(PixelGrid(2, 2, 1.0, 1.0))
"""Stands for the pixels, of which nothing is kept."""
RECIPE_VERSION = 4
"""Raised when the solver or the way of simulating changes forces, so that none are taken from the
cache that were made otherwise."""


@dataclass(frozen=True)
class GelBench:
    """A gel and a tool, on the mesh of one depth.

    Presses are taken one by one, each kept in the cache by all that its forces depend on. Those of
    a table as environments of one scene gained 3 s of 7 on an H200 (docs/evidence/ablations.md) and
    nothing on a core.
    """

    gel: Gel
    tool: CurveTool
    depth_mm: float
    friction: float = 0.0
    most_nu: float | None = None
    """Largest Poisson's ratio of gels that are compared: they share its mesh, so that forces are
    smooth in the ratio. That of ``gel`` when None."""

    @property
    def _mesh_nu(self) -> float:
        return self.gel.material.poisson_ratio if self.most_nu is None else self.most_nu

    def pressed(self, gel: Gel) -> dict[str, np.ndarray]:
        """``force_n`` of a press of ``gel`` to the depth of the bench, its numerical error over it,
        ``error``, and its ``seconds``.

        ``gel`` differs from that of the bench in its law at most.

        Raises:
            SimulationError: It did not converge.
        """

        def made() -> dict[str, np.ndarray]:
            started = time.perf_counter()
            tool, friction = self.tool.indenter(), self.friction
            measured = measured_press(
                lambda at: self._press(gel, at),
                gel.physics,
                tool.shape,
                friction=friction,
                remembers=friction > 0,
                beside_edge=is_beside_edge(gel.pad, self.tool.at_mm, tool.contact(self.depth_mm)),
            )
            error = measured.error
            return {
                "force_n": np.array([error.stated_for(measured.outcome).force_n]),
                "error": np.array([error.share]),
                "seconds": np.array(time.perf_counter() - started),
            }

        return cached_arrays("responses", self._recipe(gel)).read_or_make(made)

    def _press(self, gel: Gel, at: Resolution) -> PressOutcome:
        """The press as ``taccel-lab press`` has it, of a gel of 1 MPa."""
        tool, whole = self.tool.indenter(), PressPath(self.depth_mm).bounded((), self.friction)
        setup = PressSetup.on_pad(
            gel.pad,
            partial(profile_material, gel.unit_material()),
            tool,
            self.tool.at_mm,
            whole,
            poisson_ratio=self._mesh_nu,
            friction_coefficient=self.friction,
            physics=gel.physics,
            resolution=at,
            device=gel.device,
        )
        return simulate_press(
            setup,
            self.tool.at_mm,
            at.path(whole, tool.shape, self.friction, relaxes=False),
            UNSEEN,
            beside=whole if at.is_beside and self.friction > 0 else None,
            limits=RUBBING_LIMITS if self.friction > 0 else {},
        )

    def _recipe(self, gel: Gel) -> dict[str, Any]:
        """All that a press of ``gel`` here depends on."""
        return {
            "version": RECIPE_VERSION,
            "gel": gel.recipe(),
            "tool": self.tool.description,
            "at_mm": list(self.tool.at_mm),
            "nu": gel.material.poisson_ratio,
            "mesh_nu": self._mesh_nu,
            "ratio": gel.material.mooney_ratio,
            "physics": gel.physics.record(),
            "depth_mm": self.depth_mm,
            "friction": self.friction,
        }
