# SPDX-License-Identifier: Apache-2.0
"""Time of a material's candidates: presses one by one against environments of one scene.

A ball of 7.5 mm radius on a gel of 25 x 20 x 4 mm and 1 MPa, as a fit of material parameters asks
for it: seven depths without friction, with the slope of each force over Poisson's ratio by the
implicit function theorem (``slopes``) or without (``values``), and a press with two drags
(``friction``). Run it with ``python -m taccel_lab.benchmarks.material_presses``; results go to
``benchmarks/results/material_presses.json``. Needs Warp, numpy and scipy alone.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from taccel_lab.benchmarks.machine import describe_run
from taccel_lab.calibration.material.gel_presses import GelPresses, MaterialStep, Stop
from taccel_lab.calibration.material.press_plans import Followed, PressPlan, follow
from taccel_lab.envs import parse_indenter
from taccel_lab.geometry import TetMesh
from taccel_lab.geometry.block import block_mesh
from taccel_lab.output import write_json
from taccel_lab.scene import Material
from taccel_lab.solvers import SolverConfig

RESULT = Path(__file__).parent / "results" / "material_presses.json"
YOUNG_PA = 1e6
BALL = "sphere:7.5"
DEPTHS_MM = 0.09 + 1.2 * np.linspace(0, 1, 7) ** 1.4
SHEAR_DEPTH_MM = 0.6
SMOOTH = SolverConfig(dhat_m=2e-6)
RUBBING = SolverConfig(
    dhat_m=5e-6, friction_eps_m=5e-6, max_substep_halvings=3, max_friction_lags=60
)
FEWEST = 3
"""Presses that are timed one by one, however long they take."""

Kind = Literal["slopes", "values", "friction"]


@dataclass(frozen=True)
class Row:
    """One table of candidates, in one scene and one by one."""

    kind: Kind
    candidates: int
    stops: int
    nodes: int
    tets: int
    linear_solver: str
    together_s: float
    """Building the scene and all stops."""
    one_by_one_s: float
    """The same for all candidates; scaled up from ``one_by_one_measured`` of them."""
    one_by_one_measured: int
    speedup: float
    converged: int
    residual_together_n: float
    residual_one_by_one_n: float
    largest_force_n: float
    force_difference: float
    """Largest difference of normal forces, over the largest force of the candidate."""
    second_difference: float | None
    """The same for the slopes or the shear forces, over the largest of them."""


def pad_mesh(cells: int) -> TetMesh:
    """25 x 20 x 4 mm, fine about the middle; 14 cells give the nodes of a standard press."""
    block = block_mesh((cells, cells, 3), (2.0, 2.0, 1.0))
    nodes = block.nodes_m.copy()
    across = np.abs(nodes[:, :2])
    nodes[:, :2] = np.sign(nodes[:, :2]) * (0.35 * across + 0.65 * across**2.2)
    nodes[:, 2] = -(np.abs(nodes[:, 2]) ** 1.3)
    return TetMesh(
        nodes * np.array([12.5e-3, 10e-3, 4e-3]), block.tets, block.faces, block.face_regions
    )


def _sloped(env: GelPresses, together: Sequence[PressPlan]) -> np.ndarray:
    half = [1e-5 * (0.5 - c.poisson_ratio) for c in together]
    low, high = (
        [
            Material(YOUNG_PA, c.poisson_ratio + sign * h)
            for c, h in zip(together, half, strict=True)
        ]
        for sign in (-1, 1)
    )
    step = MaterialStep(low, high, [2 * h for h in half])
    return np.hstack([env.press_force[:, 2:], env.force_slopes([step])])


def _valued(env: GelPresses, together: Sequence[PressPlan]) -> np.ndarray:
    return env.press_force[:, 2:]


def _dragged(env: GelPresses, together: Sequence[PressPlan]) -> np.ndarray:
    return env.press_force[:, [2, 0]]


def candidates_of(kind: Kind, count: int) -> list[PressPlan]:
    """Gels spread over Poisson's ratio (0.35 to 0.499) or over friction (0.1 to 0.6)."""
    if kind == "friction":
        return [_press(0.47, float(mu), _dragged) for mu in np.geomspace(0.1, 0.6, count)]
    # Chebyshev's points in sqrt(1 - 2 nu), in which forces are smooth up to 0.5.
    s = 0.3 + 0.25 * np.cos(np.pi * (np.arange(count) + 0.5) / count)
    read = _sloped if kind == "slopes" else _valued
    return [_press(0.5 * (1 - float(v) ** 2), 0.0, read) for v in s]


def _press(nu: float, mu: float, read: object) -> PressPlan:
    stops = [Stop(float(depth)) for depth in DEPTHS_MM]
    if mu:
        d = SHEAR_DEPTH_MM
        stops = [Stop(d * k / 4, read=k == 4) for k in range(1, 5)]
        stops += [Stop(d, (mu * d * k / 2, 0.0)) for k in (1, 2)]
    return PressPlan({}, nu, 0.0, mu, stops, read, lambda rows: {"rows": rows})  # type: ignore[arg-type]


def timed(
    mesh: TetMesh, candidates: Sequence[PressPlan], device: str
) -> tuple[GelPresses, Followed, float]:
    """The scene of the candidates, what was read there, and seconds with building it."""
    started = time.perf_counter()
    env = GelPresses(
        mesh,
        [Material(YOUNG_PA, c.poisson_ratio) for c in candidates],
        parse_indenter(BALL),
        (0.0, 0.0),
        [c.friction for c in candidates],
        config=RUBBING if candidates[0].friction else SMOOTH,
        device=device,
    )
    found = follow(env, candidates)
    # What was read is on the host: nothing is under way any more.
    return env, found, time.perf_counter() - started


def compare(mesh: TetMesh, kind: Kind, count: int, device: str, budget_s: float) -> Row:
    """Time all candidates in one scene, and as many one by one as go into ``budget_s``."""
    wanted = candidates_of(kind, count)
    # Kernels are compiled and graphs captured before the clock starts.
    timed(mesh, wanted[:1], device)
    timed(mesh, wanted, device)
    env, found, together_s = timed(mesh, wanted, device)
    alone, alone_s, residual = [], 0.0, 0.0
    # Spread over the table: presses near incompressibility take longer.
    for index in np.random.default_rng(0).permutation(count):
        if alone_s > budget_s and len(alone) >= FEWEST:
            break
        _, single, seconds = timed(mesh, [wanted[index]], device)
        alone.append((index, single.rows[0]))
        alone_s += seconds
        residual = max(residual, float(single.residual_n[0]))
    rows = np.array([found.rows[index] for index, _ in alone])
    apart = np.abs(rows - np.array([row for _, row in alone]))
    scale = np.abs(rows)
    one_by_one_s = alone_s / len(alone) * count
    return Row(
        kind=kind,
        candidates=count,
        stops=len(wanted[0].stops),
        nodes=int(env.model.soft_count),
        tets=int(env.model.elastic[0].element_count),
        linear_solver=env.solver.linear.describe(),
        together_s=round(together_s, 3),
        one_by_one_s=round(one_by_one_s, 3),
        one_by_one_measured=len(alone),
        speedup=round(one_by_one_s / together_s, 2),
        converged=int(found.converged.sum()),
        residual_together_n=float(found.residual_n.max()),
        residual_one_by_one_n=residual,
        largest_force_n=float(np.nanmax(scale[..., 0])),
        force_difference=float(
            np.nanmax(apart[..., 0] / np.nanmax(scale[..., 0], axis=1, keepdims=True))
        ),
        second_difference=None
        if kind == "values"
        else float(np.nanmax(apart[..., 1]) / np.nanmax(scale[..., 1])),
    )


def main() -> None:
    import warp as wp

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--device", default="cpu", help="cpu or cuda:0 (cpu)")
    parser.add_argument("--sizes", default="8,32,128", help="candidates of a table (8,32,128)")
    parser.add_argument("--kinds", default="slopes,values,friction", help="(all three)")
    parser.add_argument("--cells", type=int, default=14, help="of the mesh along a side (14)")
    parser.add_argument(
        "--budget-s", type=float, default=20.0, help="for presses one by one, each table (20)"
    )
    parser.add_argument("--out", type=Path, default=RESULT, help="JSON file")
    options = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    wp.init()
    mesh = pad_mesh(options.cells)
    rows: list[dict[str, object]] = []
    for kind in options.kinds.split(","):
        for count in map(int, options.sizes.split(",")):
            row = compare(mesh, kind, count, options.device, options.budget_s)
            rows.append(asdict(row))
            sys.stderr.write(
                f"{kind}, {count}: {row.together_s:.2f} s together, {row.one_by_one_s:.2f} s one "
                f"by one ({row.one_by_one_measured} measured), forces differ by "
                f"{row.force_difference:.1e}, residual {row.residual_together_n:.1e} N\n"
            )
            # After every table: a run that is cut short keeps what it measured.
            write_json(
                options.out,
                {
                    "what": (__doc__ or "").split("\n")[0],
                    "run": describe_run(options.device),
                    "settings": {
                        "ball": BALL,
                        "depths_mm": DEPTHS_MM.round(4).tolist(),
                        "young_pa": YOUNG_PA,
                        "dhat_m": {"smooth": SMOOTH.dhat_m, "friction": RUBBING.dhat_m},
                        "relative_tolerance": SMOOTH.relative_tolerance,
                        "cells": options.cells,
                    },
                    "rows": rows,
                },
            )


if __name__ == "__main__":
    main()
