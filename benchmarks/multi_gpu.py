# SPDX-License-Identifier: Apache-2.0
"""The suite ``multi_gpu``: the peg scene over several GPUs, a process each.

Strong scaling keeps the number of environments, weak scaling the number on each
GPU. Timed are whole motions: targets set, stepped, forces of all environments on the host. The
efficiency is the speed over that of one GPU times the number of GPUs, and ``newton_differ`` counts
the steps of environments whose Newton iterations are not those of the first environment on one GPU:
all of them do the same, and only the order of sums tells them apart.
"""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing.connection import Connection
from typing import Any, ClassVar

import numpy as np
import warp as wp

from taccel_lab.benchmarks.results import Deadline, ResultFile, spread
from taccel_lab.benchmarks.runner import BenchmarkMotion, Runner
from taccel_lab.benchmarks.scenes import SceneOptions, build_scene
from taccel_lab.benchmarks.suite import Suite
from taccel_lab.errors import InputError
from taccel_lab.scene.shards import shard_of, shard_slice

MODE = "processes"
"""Of all rows, for comparison with results that have rows of threads, too."""
WORKER_LIMIT_S = 300.0
"""Longest silence of a worker: one that hangs ends the run with an error."""


@dataclass(frozen=True)
class MultiGpu(Suite):
    """The peg scene on several GPUs, a process each."""

    name: ClassVar[str] = "multi_gpu"
    what: ClassVar[str] = (
        "The peg scene over several GPUs: environments x steps / seconds, forces on the host."
    )
    shown: ClassVar[tuple[str, ...]] = (
        "scaling", "fps: median", "efficiency", "ms_per_step: median", "newton_mean",
        "newton_differ", "force_spread_n", "worst_over_contact_force", "unconverged",
    )  # fmt: skip
    devices: tuple[str, ...] = ()
    """Such as cuda:0 cuda:1; all GPUs of the machine when left out. They take --device's place."""
    counts: tuple[int, ...] = (1, 2, 4)
    """GPUs of a row; more than there are are left out."""
    envs: int = 4096
    """Environments of one GPU, and of strong scaling."""
    steps: int = 60
    """First steps of the motion."""
    warm_up: int = 10
    """Steps before the first repeat."""
    repeats: int = 3
    """Runs of each row; the median counts. A budget that is spent ends them, too."""
    source: str = "auto"
    """Meshes: published, generated, or auto for the published ones where they are."""

    def measure(self) -> ResultFile:
        devices = self.devices or tuple(device.alias for device in wp.get_cuda_devices())
        if not devices:
            raise InputError("there is no GPU here; --devices cpu cpu runs the CPU in its place")
        known = [device.alias for device in wp.get_devices()]
        for name in devices:
            if name not in known:
                raise InputError(f"device {name!r} is not here; devices are {', '.join(known)}")
        if min(self.steps, self.repeats, self.envs, *self.counts) < 1:
            raise InputError("--steps, --repeats, --envs and --counts must be at least 1")
        return Suite.measure(replace(self, device=devices[0], devices=devices))

    def settings(self) -> dict[str, Any]:
        return {
            "steps": self.steps,
            "repeats": self.repeats,
            "warm_up_steps": self.warm_up,
            "budget_s": self.budget_s,
            "devices": self.devices,
        }

    def measure_rows(self, result: ResultFile) -> None:
        """What matters most first."""
        counts = [count for count in self.counts if count <= min(len(self.devices), self.envs)]
        base: dict[str, Any] | None = None

        def row(scaling: str, count: int, envs: int) -> dict[str, Any]:
            nonlocal base
            alike = None if base is None else base["newton_by_step"]
            found = measure(workers, count, envs, self, result.deadline, alike)
            base = base or found
            # FPS counts all environments, so that ideal is the same for both kinds of scaling.
            efficiency = found["fps"]["median"] / (count * base["fps"]["median"])
            return found | {"mode": MODE, "scaling": scaling, "efficiency": efficiency}

        result.put("device_names", [wp.get_device(name).name for name in self.devices])
        with closing(Workers(self.devices[: max(counts)])) as workers:
            for planned in plan_rows(counts, self.envs):
                _, count, envs = planned
                label = f"{count} GPUs, {envs:,} environments"
                result.measure(label, partial(row, *planned))


def built(device: str, env_count: int, options: MultiGpu, rank: int, world: int) -> Runner:
    """The part of the scene that process ``rank`` of ``world`` has, on its device, warmed up."""
    bench = build_scene("peg", SceneOptions(env_count, options.source))
    runner = Runner(replace(bench, scene=shard_of(bench.scene, rank, world)), device)
    runner.run(options.warm_up)
    return runner


# Workers: one process a device -------------------------------------------------------------------


def _work(pipe: Connection, device: str) -> None:
    """Do what the parent asks for until it asks for nothing."""
    wp.config.log_level = wp.LOG_WARNING
    runner: Runner | None = None
    while True:
        what, *values = pipe.recv()
        if what == "stop":
            return
        if what == "build":
            runner = None
            runner = built(device, *values)
            pipe.send(runner.bench.source)
        elif runner is not None and what == "reset":
            runner.reset()
            wp.synchronize_device(device)
            pipe.send(None)
        elif runner is not None:
            motion = runner.run(*values, keep_forces=True)
            pipe.send(replace(motion, forces_n=motion.forces_n[-1:]))


class Workers:
    """A process for each device, which wait for each other at the start of every run only."""

    def __init__(self, devices: Sequence[str]) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipes: list[Connection] = []
        self._processes = []
        for device in devices:
            mine, its = context.Pipe()
            process = context.Process(target=_work, args=(its, device), daemon=True)
            process.start()
            its.close()
            self._pipes.append(mine)
            self._processes.append(process)

    def ask(self, count: int, what: str, *values: Any, ranked: bool = False) -> list[Any]:
        """Answers of the first ``count`` workers; each gets its rank when ``ranked``."""
        for rank, pipe in enumerate(self._pipes[:count]):
            pipe.send((what, *values, rank, count) if ranked else (what, *values))
        answers = []
        for rank, pipe in enumerate(self._pipes[:count]):
            if not pipe.poll(WORKER_LIMIT_S):
                raise RuntimeError(f"worker {rank} was silent for {WORKER_LIMIT_S:g} s")
            try:
                answers.append(pipe.recv())
            except EOFError:
                raise RuntimeError(f"worker {rank} ended; its error is above") from None
        return answers

    def close(self) -> None:
        """End all processes."""
        for pipe, process in zip(self._pipes, self._processes, strict=True):
            if process.is_alive():
                pipe.send(("stop",))
        for process in self._processes:
            process.join(10)
            if process.is_alive():
                process.terminate()


# Rows --------------------------------------------------------------------------------------------


def measure(
    workers: Workers,
    count: int,
    env_count: int,
    options: MultiGpu,
    end: Deadline,
    alike: Sequence[int] | None,
) -> dict[str, Any]:
    """A row: ``env_count`` environments on ``count`` devices.

    ``alike``: Newton iterations of each step that all environments are compared with; those of the
    first environment when None.
    """
    started = time.perf_counter()
    sources = workers.ask(count, "build", env_count, options, ranked=True)
    setup_s = time.perf_counter() - started
    seconds: list[float] = []
    runs: list[BenchmarkMotion] = []
    while len(seconds) < options.repeats and not (seconds and end.passed):
        workers.ask(count, "reset")
        started = time.perf_counter()
        runs = workers.ask(count, "run", options.steps)
        seconds.append(time.perf_counter() - started)
    newton = np.concatenate([np.array(run.iterations) for run in runs], axis=1)
    forces = np.concatenate([run.forces_n[-1] for run in runs])
    residuals = [run.residual() for run in runs]
    parts = [shard_slice(env_count, rank, count) for rank in range(count)]
    expected = newton[:, :1] if alike is None else np.array(alike)[:, None]
    return {
        "gpus": count,
        "envs": env_count,
        "source": sources[0],
        "fps": spread([env_count * options.steps / s for s in seconds]),
        "ms_per_step": spread([1e3 * s / options.steps for s in seconds]),
        "setup_s": setup_s,
        "newton_mean": float(newton.mean()),
        "newton_by_step": newton[:, 0].tolist(),
        "newton_mean_of_shards": [float(newton[:, part].mean()) for part in parts],
        "newton_differ": int((newton != expected).sum()),
        "newton_largest_difference": int(np.abs(newton - expected).max()),
        "force_spread_n": float(np.ptp(forces, axis=0).max()),
        "force_n": float(np.linalg.norm(forces, axis=-1).mean()),
        "env_steps": int(newton.size),
        "unconverged": sum(r["unconverged"] for r in residuals),
        "worst_over_contact_force": max(r["worst_over_contact_force"] for r in residuals),
        "worst_over_allowed": max(r["worst_over_allowed"] for r in residuals),
        "allowed": residuals[0]["allowed"],
    }


def plan_rows(counts: Sequence[int], envs: int) -> list[tuple[str, int, int]]:
    """(scaling, devices, environments of all), what matters most first."""
    rows = [("one GPU", 1, envs)]
    several = sorted({count for count in counts if count > 1}, reverse=True)
    for scaling in ("strong", "weak"):
        for count in several:
            rows.append((scaling, count, envs * (count if scaling == "weak" else 1)))
    return rows
