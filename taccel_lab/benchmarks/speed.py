# SPDX-License-Identifier: Apache-2.0
"""The suite ``speed``: steps a second at a stated residual, memory, launches, and time from nothing
to the first step, each in a new process: what a person waits for."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import warp as wp

import taccel_lab
from taccel_lab.benchmarks.measure import LaunchCounter, MemoryMeter, clock_name
from taccel_lab.benchmarks.results import Deadline, ResultFile, Suite, Ticker, note, spread
from taccel_lab.benchmarks.runner import SHOWN, BenchmarkMotion, Runner, figures_of, middle_of
from taccel_lab.benchmarks.scenes import SCENES, SceneOptions, build_scene
from taccel_lab.errors import InputError, SimulationError
from taccel_lab.guards import parse_words, require_known

ROOT = Path(taccel_lab.__file__).parents[1]
"""Where the package is imported from."""

STEPS = 12
"""Steps after the first one: until every kernel of the scene's motion has been needed."""
_CODE = """
import time
started = time.perf_counter()
import json, sys
import warp as wp
wp.config.log_level = wp.LOG_WARNING
from taccel_lab.benchmarks.runner import Runner
from taccel_lab.benchmarks.scenes import SceneOptions, build_scene
imported = time.perf_counter()
scene, source, device, steps = sys.argv[1:]
runner = Runner(build_scene(scene, SceneOptions(source=source)), device)
built = time.perf_counter()
runner.run(1)
first = time.perf_counter()
runner.run(int(steps))
print(json.dumps({
    "import_s": imported - started,
    "build_s": built - imported,
    "first_step_s": first - built,
    "import_to_first_step_s": first - started,
    "all_s": time.perf_counter() - started,
}))
"""


def measure_startup(scene: str, source: str, device: str, repeats: int = 3) -> dict[str, Any]:
    """Cold, with an empty kernel cache, then warm; seconds.

    ``compilation_s`` is what the cold process took longer, to the end of the first dozen steps.
    The driver's own cache is off: its hits would hide compilation.
    """
    with tempfile.TemporaryDirectory() as cache:
        note(f"{scene}: import to first step, cold kernel cache ...")
        cold = _one(scene, source, device, cache)
        note(f"{scene}: cold {cold['import_to_first_step_s']:.2f} s; warm ...")
        warm = [_one(scene, source, device, cache) for _ in range(repeats)]
    warm.sort(key=lambda run: run["import_to_first_step_s"])
    middle = warm[len(warm) // 2]
    note(f"{scene}: warm {middle['import_to_first_step_s']:.2f} s")
    return {
        "cold": cold,
        "warm": middle,
        "warm_range_s": [run["import_to_first_step_s"] for run in (warm[0], warm[-1])],
        "compilation_s": cold["all_s"] - middle["all_s"],
    }


def _one(scene: str, source: str, device: str, cache: str) -> dict[str, float]:
    environment = {"WARP_CACHE_PATH": cache, "CUDA_CACHE_DISABLE": "1"}
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    run = subprocess.run(
        [sys.executable, "-c", _CODE, scene, source, device, str(STEPS)],
        env=os.environ | environment | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
    )
    if run.returncode != 0:
        raise SimulationError(f"timing the start of {scene} failed:\n{run.stderr[-2000:]}")
    return json.loads(run.stdout.strip().splitlines()[-1])


WARM_UP_STEPS = 3
"""Untimed, before the first repeat: kernels are loaded, buffers grow, graphs are captured."""


@dataclass(frozen=True)
class Speed(Suite):
    """FPS = environments x steps / seconds, end to end, at a stated force residual."""

    name: ClassVar[str] = "speed"
    what: ClassVar[str] = (
        "Environments x steps / seconds, end to end: targets set, stepped, forces read."
    )
    shown: ClassVar[tuple[str, ...]] = SHOWN
    scene: tuple[str, ...] = ("peg",)
    """Scenes: peg, press_239, press_2005, press_5215, bolt, hand, squeeze, or all."""
    envs: tuple[int, ...] = (1,)
    """Numbers of environments, a row each."""
    steps: int | None = None
    """First steps of the motion; all of it by default."""
    repeats: int = 5
    """Runs of each row; the median counts. A budget that is spent ends them, too."""
    source: str = "auto"
    """Meshes: published, generated, or auto for the published ones where they are."""
    set: tuple[str, ...] = ()
    """Solver settings other than the scene's, e.g. relative_tolerance=1e-5 deterministic=true."""
    lag: int = 0
    """Environment e is e modulo (LAG + 1) steps behind, so that they differ; 0: all do the same."""
    startup: bool = True
    """Time import to first step, with a warm and a cold kernel cache, in their own processes."""
    check: bool = False
    """Look for bodies that overlap after the last step."""

    def settings(self) -> dict[str, Any]:
        return super().settings() | {
            "budget_s": self.budget_s,
            "solver": parse_settings(self.set),
            "clock": clock_name(self.device),
            "warm_up_steps": WARM_UP_STEPS,
        }

    def measure_rows(self, result: ResultFile) -> None:
        """Best known first: scenes in order, few environments before many."""
        scenes = list(SCENES) if self.scene == ("all",) else list(self.scene)
        if self.repeats < 1 or not self.envs or min(self.envs) < 1:
            raise InputError("--repeats and --envs must be at least 1")
        for name in scenes:
            require_known("scene", name, SCENES)
        config = parse_settings(self.set)
        for scene in scenes:
            for count in self.envs:
                chosen = SceneOptions(count, self.source, config, self.lag)
                row = partial(measure, scene, chosen, self, result.deadline)
                result.measure(f"{scene}, {count}", row)
            if self.startup and not result.deadline.passed:
                found = measure_startup(scene, self.source, self.device)
                result.put("startup", {**result.get("startup", {}), scene: found})


def measure(scene: str, chosen: SceneOptions, options: Speed, deadline: Deadline) -> dict[str, Any]:
    """One row: a scene with a number of environments."""
    started = time.perf_counter()
    device = wp.get_device(options.device)
    with MemoryMeter(options.device) as meter:
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
    runs: list[BenchmarkMotion] = []
    label = f"{scene}, {chosen.env_count} environments"
    while len(runs) < options.repeats and not (runs and deadline.passed):
        runner.reset()
        ticker = Ticker(f"{label}, run {len(runs) + 1}/{options.repeats}")
        runs.append(runner.run(options.steps, keep_forces=len(runs) == 0, progress=ticker))
    median = runs[middle_of(runs)]
    bytes_used = meter.used_bytes()
    row: dict[str, Any] = {
        **figures_of(runs, bench, runner.model),
        "lag": chosen.lag,
        "steps": len(median.seconds),
        "is_whole_motion": len(median.seconds) == bench.steps,
        "dt_s": bench.scene.time.dt_s,
        "ms_per_step": spread([1e3 * float(np.mean(run.seconds)) for run in runs]),
        "worst_step_ms": 1e3 * max(median.seconds),
        "memory_mib": bytes_used / 2**20,
        "memory_mib_per_env": bytes_used / 2**20 / chosen.env_count,
        "allocations": meter.allocations().count,
        "launches_per_step": launches.count / len(again.seconds),
        "setup_s": setup_s,
        "build_s": built - started,
        "final_forces_n": runs[0].forces_n[-1][0].tolist(),
        "spread_between_envs_n": float(np.ptp(runs[0].forces_n[-1], axis=0).max()),
        "notes": dict(bench.notes),
    }
    if options.check:
        from taccel_lab.ipc.contact.overlap_search import find_overlaps

        found = find_overlaps(runner.model, runner.state)
        row["intersections"] = sum(len(env) for env in found)
    return row


def parse_settings(texts: tuple[str, ...]) -> dict[str, Any]:
    """Fields of the solver's settings from NAME=VALUE."""
    return {name: _value(text) for name, text in parse_words(texts).items()}


def _value(text: str) -> Any:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return {"true": True, "false": False, "none": None}.get(text.lower(), text)
