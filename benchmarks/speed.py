# SPDX-License-Identifier: Apache-2.0
"""The suite ``speed``: steps a second at a stated residual, memory, launches, time to start."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.benchmarks.clock import clock_name
from taccel_lab.benchmarks.launches import LaunchCounter
from taccel_lab.benchmarks.memory import MemoryMeter, pool_bytes
from taccel_lab.benchmarks.options import Speed
from taccel_lab.benchmarks.results import Deadline, ResultFile, Ticker, note, spread
from taccel_lab.benchmarks.runner import Motion, Runner
from taccel_lab.benchmarks.scenes import SCENES, SceneOptions, build_scene
from taccel_lab.benchmarks.startup import measure_startup
from taccel_lab.errors import InputError

WARM_UP_STEPS = 3
"""Untimed, before the first repeat: kernels are loaded, buffers grow, graphs are captured."""


def run_speed(options: Speed) -> None:
    """Run all rows, best known first: scenes in order, few environments before many."""
    wp.config.log_level = wp.LOG_WARNING
    scenes = list(SCENES) if options.scene == ("all",) else list(options.scene)
    if options.repeats < 1 or not options.envs or min(options.envs) < 1:
        raise InputError("--repeats and --envs must be at least 1")
    unknown = [name for name in scenes if name not in SCENES]
    if unknown:
        raise InputError(f"scene must be of {', '.join(SCENES)}, or all; got {unknown[0]!r}")
    config = parse_settings(options.set)
    deadline = Deadline(options.budget_s)
    what = "Environments x steps / seconds, end to end: targets set, stepped, forces read."
    settings = {
        "steps": options.steps,
        "repeats": options.repeats,
        "budget_s": options.budget_s,
        "solver": config,
        "clock": clock_name(options.device),
        "warm_up_steps": WARM_UP_STEPS,
    }
    with ResultFile("speed", what, options.out, options.device, settings).finishing() as result:
        for scene in scenes:
            for count in options.envs:
                if deadline.passed:
                    note(f"{scene}, {count}: not started, the budget is spent")
                    continue
                chosen = SceneOptions(count, options.source, config, options.lag)
                row = measure(scene, chosen, options, deadline)
                result.add(row)
                note(describe(row))
            if options.startup and not deadline.passed:
                found = measure_startup(scene, options.source, options.device)
                result.put("startup", {**result.get("startup", {}), scene: found})


def measure(scene: str, chosen: SceneOptions, options: Speed, deadline: Deadline) -> dict[str, Any]:
    """One row: a scene with a number of environments."""
    started = time.perf_counter()
    device = wp.get_device(options.device)
    pool = pool_bytes(device)
    with MemoryMeter() as meter:
        bench = build_scene(scene, chosen)
        runner = Runner(bench, options.device)
        built = time.perf_counter()
        warm_up = min(WARM_UP_STEPS, options.steps or bench.steps)
        runner.run(warm_up)
        setup_s = time.perf_counter() - started
        runner.reset()
        # Again, now that whatever is captured has been captured; lists grow with the motion, which
        # a GPU's pool shows at the end, and here the record of allocations.
        with LaunchCounter() as launches:
            again = runner.run(warm_up if device.is_cuda else options.steps)
    runs: list[Motion] = []
    label = f"{scene}, {chosen.env_count} environments"
    while len(runs) < options.repeats and not (runs and deadline.passed):
        runner.reset()
        ticker = Ticker(f"{label}, run {len(runs) + 1}/{options.repeats}")
        runs.append(runner.run(options.steps, keep_forces=len(runs) == 0, progress=ticker))
    after = pool_bytes(device)
    by_speed = sorted(runs, key=lambda run: run.fps)
    median = by_speed[len(runs) // 2]
    allocations = meter.allocations(device)
    bytes_used = allocations.peak_bytes
    if pool is not None and after is not None:
        bytes_used = max(bytes_used, float(after - pool))
    row: dict[str, Any] = {
        "scene": scene,
        "what": bench.what,
        "source": bench.source,
        "envs": chosen.env_count,
        "lag": chosen.lag,
        "steps": len(median.seconds),
        "is_whole_motion": len(median.seconds) == bench.steps,
        "dt_s": bench.scene.time.dt_s,
        "soft_nodes": runner.model.soft_count,
        "unknowns": 3 * runner.model.free_count,
        "fps": spread([run.fps for run in runs]),
        "solver_fps": spread([run.solver_fps for run in runs]),
        "ms_per_step": spread([1e3 * float(np.mean(run.seconds)) for run in runs]),
        "worst_step_ms": 1e3 * max(median.seconds),
        "residual": _worst([run.residual() for run in runs]),
        **median.work(),
        "memory_mib": bytes_used / 2**20,
        "memory_mib_per_env": bytes_used / 2**20 / chosen.env_count,
        "allocations": allocations.count,
        "launches_per_step": launches.count / len(again.seconds),
        "setup_s": setup_s,
        "build_s": built - started,
        "final_forces_n": runs[0].forces_n[-1][0].tolist(),
        "spread_between_envs_n": float(np.ptp(runs[0].forces_n[-1], axis=0).max()),
        "notes": dict(bench.notes),
    }
    if options.check:
        from taccel_lab.ipc.intersection import find_intersections

        found = find_intersections(runner.model, runner.state)
        row["intersections"] = sum(len(env) for env in found)
    return row


def _worst(residuals: list[dict[str, Any]]) -> dict[str, Any]:
    """Over all repeats."""
    worst = dict(max(residuals, key=lambda r: (r["unconverged"], r["worst_over_allowed"])))
    worst["repeats"] = len(residuals)
    return worst


def describe(row: dict[str, Any]) -> str:
    """A line for the person who waits."""
    fps, residual = row["fps"], row["residual"]
    line = (
        f"{row['scene']}, {row['envs']} environments, {row['steps']} steps: "
        f"{fps['median']:,.1f} FPS ({fps['min']:,.1f} to {fps['max']:,.1f}, {fps['count']} runs), "
        f"{row['ms_per_step']['median']:.2f} ms a step, Newton {row['newton_mean']:.1f}, "
        f"residual {residual['worst_over_contact_force']:.1e} of the contact force, "
        f"{row['memory_mib_per_env']:.2f} MiB an environment"
    )
    if residual["unconverged"]:
        line += f"; {residual['unconverged']} of {residual['env_steps']} NOT converged"
        line += f" ({residual['causes']})"
    return line


def parse_settings(texts: tuple[str, ...]) -> dict[str, Any]:
    """Fields of the solver's settings from NAME=VALUE."""
    values: dict[str, Any] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals:
            raise InputError(f"--set takes NAME=VALUE, got {text!r}")
        values[name.strip()] = _value(value.strip())
    return values


def _value(text: str) -> Any:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return {"true": True, "false": False, "none": None}.get(text.lower(), text)
