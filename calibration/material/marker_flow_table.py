# SPDX-License-Identifier: Apache-2.0
"""Simulated motion of markers under a tool, over friction and Poisson's ratio.

Displacements do not depend on Young's modulus: the gel is one of 1 MPa.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from taccel_lab.calibration.material.force_table import NU_RANGE
from taccel_lab.calibration.material.gel import Gel, Tool
from taccel_lab.calibration.material.gel_presses import GelPresses
from taccel_lab.calibration.material.interpolation import Axis, ResponseTable
from taccel_lab.calibration.material.likelihood import Group, Likelihood, Parameter
from taccel_lab.calibration.material.press_plans import (
    GelBench,
    PressPlan,
    prepare,
    simulate,
    simulate_each,
)
from taccel_lab.calibration.material.tool_path import ToolPath, path_stops
from taccel_lab.errors import SimulationError
from taccel_lab.progress import Progress, silent
from taccel_lab.signals.markers import MarkerLayout

MU_NODES = (0.1, 0.14, 0.2, 0.28, 0.4, 0.56, 0.8, 1.1)
_CHECK_MU, _CHECK_MU_OF_FEW = 0.47, 0.24
_CHECK_NU = 0.485
NU_NODES = 3


@dataclass(frozen=True)
class FlowTable:
    """Simulated displacements of markers over friction and Poisson's ratio."""

    responses: ResponseTable
    """Displacements [mm], [frame, marker, 2], over Poisson's ratio and ln mu."""
    error_mm: float = 0.0
    """Root mean square difference to a press between the nodes, of another accuracy."""
    mu_error: float = 0.0
    """What that difference does to friction, as a part of it."""
    nu_error: float = 0.0
    """The same of Poisson's ratio."""

    def displacement_mm(self, mu: float, poisson_ratio: float) -> np.ndarray:
        """Displacements [mm], shape [frame, marker, 2]."""
        return self.responses.at(0.0, poisson_ratio, np.array([math.log(mu)])).value[..., 0]


def flow_likelihood(
    table: FlowTable, use: np.ndarray, target_mm: np.ndarray, sigma_mm: np.ndarray
) -> Likelihood:
    """Misfit of the table over ``ln_mu``, and over ``nu`` unless the table holds it."""
    low, high = table.responses.way[[0, -1]]
    nus = table.responses.second
    parameters = [Parameter("ln_mu", math.log(0.4), low, high, 0.3)]
    if not nus.held:
        parameters.append(Parameter("nu", 0.47, nus.low, nus.high, 0.02))

    def residuals(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        nu = nus.low if nus.held else float(theta[1])
        there = table.responses.at(0.0, nu, theta[:1])
        slopes = [there.by_way, there.by_second][: len(theta)]
        return (
            (there.value[..., 0][use] - target_mm) / sigma_mm,
            np.stack([slope[..., 0][use] / sigma_mm for slope in slopes], axis=1),
        )

    return Likelihood(parameters, [Group(len(target_mm), True)], residuals)


def flow_table(
    gel: Gel,
    tool: Tool,
    path: ToolPath,
    frames: np.ndarray,
    points_mm: np.ndarray,
    *,
    free_nu: bool = True,
    progress: Progress = silent,
) -> FlowTable:
    """Simulate the tool's path at several coefficients and Poisson's ratios.

    Raises:
        SimulationError: Presses that do not converge even with little friction.
    """
    held_nu, ratio = gel.material.poisson_ratio, gel.material.mooney_ratio
    axis = Axis(*(NU_RANGE if free_nu else (held_nu, held_nu)), "compressibility")
    depth = float(path.depth_mm[frames].max())
    task = f"path of {tool.description}"

    def plans(bench: GelBench, nu: float, mus: Sequence[float]) -> list[PressPlan]:
        own = bench.gel.with_law(nu, ratio)
        return [path_plan(bench, own, path, frames, points_mm, mu) for mu in mus]

    bench = GelBench(gel, tool, depth)
    mus, rows, nus = MU_NODES, [], axis.nodes(NU_NODES).tolist()
    prepare(bench, [plan for nu in nus for plan in plans(bench, nu, mus)], progress, task)
    for nu in nus:
        row = []
        for found in simulate_each(bench, plans(bench, nu, mus), progress, f"{task}, nu {nu:.3f}"):
            if not np.isfinite(found["displacement_mm"]).all():
                break  # with this much friction the gel folds up; less is all that can be told
            row.append(found["displacement_mm"])
        mus = mus[: len(row)]
        rows.append(row)
    if len(mus) < 3:
        raise SimulationError(
            f"the path of {tool.description} does not converge with friction above "
            f"{MU_NODES[max(len(mus) - 1, 0)]:g}; use a shorter or shallower path"
        )
    values = np.array([row[: len(mus)] for row in rows])
    table = FlowTable(
        ResponseTable.through(
            Axis(0.0, 0.0), axis, np.log(mus), np.moveaxis(values, 1, -1)[None]
        )
    )  # fmt: skip
    check_nu = _CHECK_NU if free_nu else held_nu
    check_mu = _CHECK_MU if mus[-1] > _CHECK_MU else _CHECK_MU_OF_FEW
    other = GelBench(gel.for_comparison(), tool, depth)
    check = simulate(other, plans(other, check_nu, [check_mu])[0])["displacement_mm"]
    if not np.isfinite(check).all():
        raise SimulationError(
            f"the path of {tool.description} does not converge with friction of {check_mu:g} and "
            f"accuracy {other.gel.physics.accuracy}; use a shorter or shallower path"
        )
    # What the mesh does to the estimates: those of the other press, whose parameters are known.
    everywhere = np.ones(check.shape, dtype=bool)
    size = np.full(check.size, float(np.sqrt(np.mean(check**2))))
    seen = flow_likelihood(table, everywhere, check.ravel(), size).solve(())
    miss = check - table.displacement_mm(check_mu, check_nu)
    return FlowTable(
        table.responses,
        float(np.sqrt(np.mean(miss**2))),
        abs(seen.value("ln_mu") - math.log(check_mu)),
        abs(seen.value("nu") - check_nu) if free_nu else 0.0,
    )


def path_plan(
    bench: GelBench,
    gel: Gel,
    path: ToolPath,
    frames: np.ndarray,
    points_mm: np.ndarray,
    mu: float,
) -> PressPlan:
    """A press of a gel along the path.

    Gives ``displacement_mm`` of points of the contact face, [frame, point, 2]; NaN from where it
    does not converge.
    """
    way = np.column_stack([path.depth_mm[frames], path.shift_mm[frames], path.angle_deg[frames]])

    def read(env: GelPresses, _: Sequence[PressPlan]) -> np.ndarray:
        markers = MarkerLayout.from_points(env.mesh, points_mm)
        change = (env.positions[..., :2] - env.mesh.nodes_m[:, :2]) * 1e3
        return np.einsum("pc,epcx->epx", markers.weights, change[:, markers.nodes])

    return bench.plan(
        "markers",
        gel,
        mu,
        {"path": way, "points_mm": points_mm, "mu": mu},
        path_stops(way),
        read,
        arrays=lambda rows: {"displacement_mm": rows},
    )
