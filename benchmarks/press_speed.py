# SPDX-License-Identifier: Apache-2.0
"""Time of a press step on one CPU core, beside its force residual.

A ball of 2 mm radius goes 0.8 mm into the gelsight pad in steps of 0.2 mm, converged to 1e-4 of
the contact force, without and with friction, on meshes of about 2,000 to 12,000 nodes. Kernel
compilation into an empty cache is timed on its own, in a process of its own. Run it with
``python -m taccel_lab.benchmarks.press_speed``; results go to
``benchmarks/results/press_speed.json``.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.benchmarks.machine import describe_run
from taccel_lab.output import write_json

RESULT = Path(__file__).parent / "results" / "press_speed.json"
MESHES = {"2,000 nodes": (8, 10, 4), "5,600 nodes": (12, 20, 4), "11,700 nodes": (16, 26, 5)}
"""Core, rings and layers of the structured mesh."""
STEP_MM = 0.2
STEP_COUNT = 4
DEVICE = "cpu"


def press(
    mesh: tuple[int, int, int], friction: float, poisson_ratio: float, capture: bool = True
) -> dict[str, Any]:
    """One press; figures of each step."""
    from taccel_lab.envs import (
        PHYSICS,
        Accuracy,
        PressEnv,
        PressMeshOptions,
        parse_indenter,
    )
    from taccel_lab.scene import Element, Material
    from taccel_lab.sensors.press_mesh import press_mesh

    core, rings, layers = mesh
    options = PressMeshOptions(10.0, core=core, rings=rings, layers=layers)
    physics = replace(PHYSICS[Accuracy.DEFAULT], element=Element.LINEAR, dhat_m=2e-5)
    env = PressEnv(
        press_mesh("gelsight", {}, (1.0, -0.5), 1.26, options),
        Material(1.5e5, poisson_ratio),
        parse_indenter("sphere:2.0"),
        np.array([[1.0, -0.5]]),
        friction_coefficient=friction,
        physics=physics,
        config=physics.solver(capture=capture),
        device=DEVICE,
    )
    reports = [env.move_to(STEP_MM * (i + 1)) for i in range(STEP_COUNT)]
    return {
        "nodes": env.model.soft_count,
        "tets": sum(group.element_count for group in env.model.elastic),
        "friction": friction,
        "poisson_ratio": poisson_ratio,
        "seconds_per_step": [round(r.seconds, 4) for r in reports],
        "newton_iterations": [int(r.newton_iterations[0]) for r in reports],
        "cg_iterations": [int(r.cg_iterations[0]) for r in reports],
        "friction_lags": [int(r.friction_lags[0]) for r in reports],
        "residual_n": [float(r.residual_n[0]) for r in reports],
        "residual_over_contact_force": [
            float(r.residual_n[0] / r.contact_force_n[0]) for r in reports
        ],
        "min_distance_um": [float(r.min_distance_m[0] * 1e6) for r in reports],
        "force_n": float(env.wrench[0, 2]),
    }


def stages() -> dict[str, float]:
    """Share of the time of a frictional 2,000-node press by part of a Newton iteration.

    Kernels are launched one by one, since a graph shows nothing of its parts."""
    import cProfile
    import pstats

    profile = cProfile.Profile()
    profile.enable()
    press(MESHES["2,000 nodes"], 1.0, 0.46, capture=False)
    profile.disable()
    table = pstats.Stats(profile).stats  # type: ignore[attr-defined]
    names = {
        ("solver_ipc.py", "step"): "whole step",
        ("element_data.py", "write_hessians"): "elastic Hessian",
        ("element_data.py", "gather_hessians"): "elastic Hessian",
        ("system.py", "solve"): "linear solve",
        ("element_data.py", "add_gradient"): "elastic gradient",
        ("contact.py", "add_hessian"): "contact Hessian",
        ("friction.py", "add_hessian"): "friction Hessian",
        ("collisions.py", "collect"): "narrow phase",
        ("candidates.py", "search"): "broad phase",
        ("step_limit.py", "limit_step"): "CCD",
        ("newton.py", "energy"): "energies",
    }
    seconds: dict[str, float] = {}
    for (file, _, function), (_, _, _, cumulative, _) in table.items():
        label = names.get((Path(file).name, function))
        if label is not None:
            seconds[label] = seconds.get(label, 0.0) + cumulative
    return {name: round(value / seconds["whole step"], 3) for name, value in seconds.items()}


def cold_compilation() -> dict[str, float]:
    """Seconds of the first press with an empty and then with the filled kernel cache."""
    code = (
        "import time; t = time.perf_counter();"
        "from taccel_lab.benchmarks.press_speed import MESHES, press;"
        "press(MESHES['2,000 nodes'], 1.0, 0.46); print(time.perf_counter() - t)"
    )
    seconds = []
    with tempfile.TemporaryDirectory() as cache:
        for _ in range(2):
            run = subprocess.run(
                [sys.executable, "-c", code],
                env={**os.environ, "WARP_CACHE_PATH": cache},
                capture_output=True,
                text=True,
                check=True,
            )
            seconds.append(float(run.stdout.split()[-1]))
    return {
        "first_press_cold_s": round(seconds[0], 2),
        "first_press_warm_s": round(seconds[1], 2),
        "compilation_s": round(seconds[0] - seconds[1], 2),
    }


def main() -> None:
    import warp as wp

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--out", type=Path, default=RESULT)
    options = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    started = time.perf_counter()
    compilation = cold_compilation()
    rows = []
    for label, mesh in MESHES.items():
        for friction, nu in ((0.0, 0.46), (1.0, 0.46), (0.0, 0.49)):
            press(mesh, friction, nu)
            runs = [press(mesh, friction, nu) for _ in range(options.repeats)]
            means = [float(np.mean(run["seconds_per_step"])) for run in runs]
            row = runs[int(np.argsort(means)[len(means) // 2])]
            row |= {
                "mesh": label,
                "mean_seconds_per_step_median": round(float(np.median(means)), 4),
                "mean_seconds_per_step_range": [round(min(means), 4), round(max(means), 4)],
                "worst_step_s": round(max(max(run["seconds_per_step"]) for run in runs), 4),
            }
            rows.append(row)
            sys.stderr.write(
                f"{label}, friction {friction}, nu {nu}: "
                f"{row['mean_seconds_per_step_median']:.3f} s a step, worst "
                f"{row['worst_step_s']:.3f} s, residual {max(row['residual_n']):.1e} N\n"
            )
    result = {
        "what": (__doc__ or "").split("\n")[0],
        "run": describe_run(DEVICE),
        "settings": {"step_mm": STEP_MM, "relative_tolerance": 1e-4, "dhat_mm": 0.02},
        "compilation": compilation,
        "share_of_a_step": stages(),
        "presses": rows,
        "seconds": round(time.perf_counter() - started, 1),
    }
    write_json(options.out, result)
    sys.stdout.write(json.dumps({"compilation": compilation}) + "\n")


if __name__ == "__main__":
    main()
