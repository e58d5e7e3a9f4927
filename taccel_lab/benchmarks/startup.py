# SPDX-License-Identifier: Apache-2.0
"""Time from nothing to the first step of a scene, and of compiling its kernels, each in its
own process: what a person waits for."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import taccel_lab
from taccel_lab.benchmarks.results import note
from taccel_lab.errors import SimulationError

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
