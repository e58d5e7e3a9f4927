# SPDX-License-Identifier: Apache-2.0
"""The suite ``quick``: figures that noise cannot move, against a committed baseline, on the CPU.

A few steps of small scenes of our own meshes. Work (iterations, launches, allocations, kernels)
may sink freely and rise by a stated part; forces must stay within a stated part; a step that does
not converge or intersects is a failure whatever the baseline says. No wall time is looked at.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.benchmarks.measure import LaunchCounter, MemoryMeter
from taccel_lab.benchmarks.results import note
from taccel_lab.benchmarks.runner import Runner
from taccel_lab.benchmarks.scenes import SceneOptions, build_scene
from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import write_json
from taccel_lab.report.machine import describe_run

BASELINE = Path(__file__).parent / "baselines" / "quick_cpu.json"
STEPS = {"peg": 12, "press_239": 14, "squeeze": 4}
"""First steps of each scene."""
EAGER_STEPS = 3
"""Steps that are launched kernel by kernel, to count kernels."""
WORK = {
    "newton_iterations": 0.10,
    "cg_iterations": 0.15,
    "friction_lags": 0.10,
    "searches": 0.10,
    "ccd_passes": 0.10,
}
"""What a step is asked for its work, and as below."""
RISE = {
    **WORK,
    "launches_per_step": 0.10,
    "eager_launches_per_step": 0.15,
    "allocations": 0.10,
    "memory_mib": 0.10,
    "kernels": 0.10,
}
"""Part by which each may rise; compilers differ in the last digits, so iterations do a little."""
FORCE_RATIO, FORCE_N = 2e-3, 2e-4
"""Forces may differ by the first, as a part of the largest one, or by the second [N]."""


@dataclass(frozen=True)
class QuickFinding:
    """A figure that is out of bounds, or much better than the baseline."""

    scene: str
    figure: str
    baseline: Any
    found: Any
    is_failure: bool

    def describe(self) -> str:
        verdict = "out of bounds" if self.is_failure else "better"
        return f"{self.scene}: {self.figure} is {self.found}, was {self.baseline}: {verdict}"


def measure(scene: str) -> dict[str, Any]:
    """The figures of one scene."""
    from taccel_lab.ipc.contact.overlap_search import find_overlaps

    count = STEPS[scene]
    bench = build_scene(scene, SceneOptions(source="generated"))
    with MemoryMeter() as meter:
        runner = Runner(bench)
        # Once as it comes, once captured: after that a step is launched as a whole.
        runner.run(3)
        runner.reset()
        with LaunchCounter() as launches:
            motion = runner.run(count, keep_forces=True)
    allocations, residual = meter.allocations(), motion.residual()
    with LaunchCounter() as eager:
        Runner(replace(bench, config=replace(bench.config, capture=False))).run(EAGER_STEPS)
    return {
        "steps": count,
        **{name: int(motion.of(name).sum()) for name in (*WORK, "starts_taken")},
        "launches_per_step": launches.count / count,
        "eager_launches_per_step": eager.count / EAGER_STEPS,
        "allocations": allocations.count,
        "memory_mib": allocations.peak_bytes / 2**20,
        "kernels": len(eager.kernels),
        "unconverged": residual["unconverged"],
        "taken_in_parts": residual["taken_in_parts"],
        "worst_residual_over_allowed": residual["worst_over_allowed"],
        "intersections": sum(len(env) for env in find_overlaps(runner.model, runner.state)),
        "forces_n": motion.forces_n[-1][0].tolist(),
    }


def measure_all() -> dict[str, dict[str, Any]]:
    """Figures by scene."""
    wp.config.log_level = wp.LOG_WARNING
    return {scene: measure(scene) for scene in STEPS}


def out_of_bounds(
    baseline: dict[str, dict[str, Any]], found: dict[str, dict[str, Any]]
) -> Iterator[QuickFinding]:
    """What is out of bounds, and what has become better by as much."""
    for scene, now in found.items():
        for name, allowed in (("unconverged", 0), ("intersections", 0), ("taken_in_parts", 0)):
            if now[name] > allowed:
                yield QuickFinding(scene, name, allowed, now[name], True)
        if now["worst_residual_over_allowed"] > 1:
            value = now["worst_residual_over_allowed"]
            yield QuickFinding(scene, "worst_residual_over_allowed", 1, value, True)
        before = baseline.get(scene)
        if before is None or before["steps"] != now["steps"]:
            yield QuickFinding(scene, "baseline", None, "another number of steps or none", True)
            continue
        for name, rise in RISE.items():
            if now[name] > (1 + rise) * before[name]:
                yield QuickFinding(scene, name, before[name], now[name], True)
            elif now[name] < (1 - rise) * before[name]:
                yield QuickFinding(scene, name, before[name], now[name], False)
        forces, expected = np.array(now["forces_n"]), np.array(before["forces_n"])
        error = float(np.abs(forces - expected).max())
        if error > max(FORCE_RATIO * float(np.abs(expected).max()), FORCE_N):
            yield QuickFinding(scene, "forces_n", before["forces_n"], now["forces_n"], True)


def read_baseline() -> dict[str, dict[str, Any]]:
    """The committed figures."""
    if not BASELINE.is_file():
        raise InputError(f"{BASELINE} does not exist; write it with --update")
    return json.loads(BASELINE.read_text(encoding="utf-8"))["scenes"]


@dataclass(frozen=True)
class Quick:
    """Figures that noise cannot move (iterations, launches, forces) against the baseline, CPU."""

    update: bool = False
    """Write the baseline anew instead of comparing with it."""

    def run(self) -> None:
        """Exit code 1 when a figure is out of bounds."""
        found = measure_all()
        if self.update:
            what = "Figures of tools.bench.quick that noise cannot move, by --update."
            write_json(BASELINE, {"what": what, "run": describe_run(), "scenes": found})
            note(f"wrote {BASELINE}")
            return
        findings = list(out_of_bounds(read_baseline(), found))
        for finding in findings:
            note(finding.describe())
        failures = sum(finding.is_failure for finding in findings)
        note(f"{len(found)} scenes, {failures} figures out of bounds")
        if failures:
            raise SystemExit(1)
