# SPDX-License-Identifier: Apache-2.0
"""Taccel's peg scene (``taccel_lab.benchmarks.scenes.peg``), every step printed.

``python -m taccel_lab.benchmarks.peg_scene`` writes ``benchmarks/results/peg_scene.json``.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.benchmarks.assets import data_folder
from taccel_lab.benchmarks.machine import describe_run
from taccel_lab.benchmarks.scenes.peg import (
    DHAT_M,
    DT_S,
    FRICTION_SPEED_M_S,
    STEPS,
    PegParts,
    generated_parts,
    peg_config,
    peg_scene,
    published_parts,
    targets,
)
from taccel_lab.errors import InputError
from taccel_lab.output import write_json

RESULT = Path(__file__).parent / "results" / "peg_scene.json"


def run_scene(
    parts: PegParts, steps: int, hole_is_affine: bool, friction_speed_m_s: float
) -> dict[str, Any]:
    """Run the scene, print every step and return its figures, a list over the steps each."""
    from taccel_lab.ipc.intersection import find_intersections
    from taccel_lab.solvers import SolverIPC
    from taccel_lab.state import initial_state

    scene = peg_scene(parts, hole_is_affine=hole_is_affine)
    model = scene.finalize()
    solver = SolverIPC(model, peg_config(friction_speed_m_s=friction_speed_m_s))
    state = initial_state(model, targets(scene, 0))
    peg = model.bodies[model.body_id("peg")].node_slice
    rows: list[dict[str, Any]] = []
    for step in range(steps):
        report = solver.step(state, targets(scene, step))
        normal, friction = (
            -gradient.numpy()[0, peg].sum(axis=0)
            for gradient in (solver.contact_gradient, solver.friction_gradient)
        )
        place = state.positions.numpy()[0, model.affine.first_control] * 1e3
        crossed = find_intersections(model, state)[0]
        print(
            f"{step:3d} {report.summary()}; lags {report.friction_lags[0]}; "
            f"peg at {np.round(place, 3)} mm, "
            f"contact {np.round(normal, 3)} N, friction {np.round(friction, 3)} N"
            + (f", INTERSECTS {crossed}" if crossed else ""),
            flush=True,
        )
        rows.append(
            {
                "converged": bool(report.converged[0]),
                "substeps": int(report.substeps[0]),
                "newton_iterations": int(report.newton_iterations[0]),
                "residual_n": float(report.residual_n[0]),
                "contact_force_n": float(report.contact_force_n[0]),
                "min_distance_um": float(report.min_distance_m[0] * 1e6),
                "intersections": len(crossed),
                "peg_z_mm": float(place[2]),
                "seconds": report.seconds,
            }
        )
    return {key: [row[key] for row in rows] for key in rows[0]}


def main() -> None:
    """Run the scene with the published meshes, where the data is, and with ours.

    Prints every step; figures go to benchmarks/results/peg_scene.json.
    """
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--generated", action="store_true", help="meshes of ours only")
    parser.add_argument("--affine-hole", action="store_true")
    parser.add_argument("--friction-speed-m-s", type=float, default=FRICTION_SPEED_M_S)
    parser.add_argument("--out", type=Path, default=RESULT)
    args = parser.parse_args()
    if args.steps < 1:
        raise InputError(f"--steps must be at least 1, got {args.steps}")
    variants = {"generated": generated_parts()}
    if not args.generated:
        variants["published"] = published_parts(data_folder())
    options = (args.steps, args.affine_hole, args.friction_speed_m_s)
    record = {
        "what": "Taccel's peg scene, step by step: a peg between two gels is lowered into a hole.",
        "run": describe_run(),
        "settings": {
            "dt_s": DT_S,
            "dhat_m": DHAT_M,
            "relative_tolerance": peg_config().relative_tolerance,
            "friction_speed_m_s": args.friction_speed_m_s,
            "affine_hole": args.affine_hole,
        },
        **{name: run_scene(parts, *options) for name, parts in variants.items()},
    }
    write_json(args.out, record)
    print(f"wrote {args.out}")


if __name__ == "__main__":
    main()
