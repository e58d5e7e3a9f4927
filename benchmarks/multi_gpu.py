# SPDX-License-Identifier: Apache-2.0
"""The suite ``multi_gpu``: the peg scene over several GPUs, a process each.

Strong scaling keeps the number of environments, weak scaling the number on each
GPU. Timed are whole motions: targets set, stepped, forces of all environments on the host. In the
table, "ideal" is the speed over that of one GPU times the number of GPUs, and "differ" counts the
steps of environments whose Newton iterations are not those of the first environment on one GPU: all
of them do the same, and only the order of sums tells them apart.
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

from taccel_lab.benchmarks.results import Deadline, ResultFile, note, spread
from taccel_lab.benchmarks.runner import ForceReader, Motion
from taccel_lab.benchmarks.scenes import SceneOptions, build_scene
from taccel_lab.benchmarks.suite import Suite
from taccel_lab.errors import InputError
from taccel_lab.scene.shards import shard_of, shard_slice
from taccel_lab.solvers import SolverIPC
from taccel_lab.state import initial_state

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
        settings = Settings(self.source, self.steps, self.warm_up)
        counts = [count for count in self.counts if count <= min(len(self.devices), self.envs)]
        base: dict[str, Any] | None = None

        def row(scaling: str, count: int, envs: int) -> dict[str, Any]:
            nonlocal base
            alike = None if base is None else base["newton_by_step"]
            found = measure(workers, count, envs, settings, self.repeats, result.deadline, alike)
            base = base or found
            # FPS counts all environments, so that ideal is the same for both kinds of scaling.
            efficiency = found["fps"]["median"] / (count * base["fps"]["median"])
            return found | {"mode": MODE, "scaling": scaling, "efficiency": efficiency}

        result.put("device_names", [wp.get_device(name).name for name in self.devices])
        note(HEAD)
        with closing(Workers(self.devices[: max(counts)])) as workers:
            for planned in plan_rows(counts, self.envs):
                _, count, envs = planned
                label = f"{count} GPUs, {envs:,} environments"
                result.measure(label, partial(row, *planned), describe)


@dataclass(frozen=True)
class Settings:
    """What is the same in all rows."""

    source: str
    steps: int
    warm_up: int


@dataclass
class Run:
    """One motion of the environments of a process."""

    motion: Motion
    newton: np.ndarray
    """Newton iterations, [steps, env]."""
    forces_n: np.ndarray
    """Forces on the gels at the end [N], [env, gel, 3]."""


class Party:
    """The part of the scene that one process has, on its device."""

    def __init__(
        self, device: str, env_count: int, settings: Settings, rank: int, world: int
    ) -> None:
        """``rank``, ``world``: which of how many processes this is; ``env_count``: of all."""
        self._bench = build_scene("peg", SceneOptions(env_count, settings.source))
        self.source = self._bench.source
        self._part = shard_slice(env_count, rank, world)
        scene = shard_of(self._bench.scene, rank, world)
        # Every environment starts alike, with a gap that is known: no need to search them all.
        config = replace(self._bench.config, check_start=False)
        model = scene.finalize(device)
        self._solver = SolverIPC(model, config)
        self._state = initial_state(model, self._targets(0))
        self._forces = ForceReader(self._solver)
        self.run(settings.warm_up)

    def _targets(self, step: int) -> np.ndarray:
        return self._bench.targets(step)[self._part]

    def reset(self) -> None:
        """All environments back to the start."""
        model = self._solver.model
        self._solver.reset(self._state, np.ones(model.env_count, dtype=bool), self._targets(0))
        wp.synchronize_device(model.device)

    def run(self, steps: int) -> Run:
        """The first steps of the motion, from where the environments are."""
        motion, newton = Motion(), []
        forces = np.zeros((self._solver.model.env_count, 0, 3))
        for step in range(1, steps + 1):
            started = time.perf_counter()
            report = self._solver.step(self._state, self._targets(step))
            forces = self._forces.read(self._state)
            motion.add(report, time.perf_counter() - started, report.seconds)
            newton.append(report.newton_iterations)
        return Run(motion, np.array(newton), forces)


# Workers: one process a device -------------------------------------------------------------------


def _work(pipe: Connection, device: str) -> None:
    """Do what the parent asks for until it asks for nothing."""
    wp.config.log_level = wp.LOG_WARNING
    party: Party | None = None
    while True:
        what, *values = pipe.recv()
        if what == "stop":
            return
        if what == "build":
            party = None
            party = Party(device, *values)
            pipe.send(party.source)
        elif party is not None:
            pipe.send(party.reset() if what == "reset" else party.run(*values))


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
        """Answers of the first ``count`` workers; each is told its rank when ``ranked``."""
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
    settings: Settings,
    repeats: int,
    end: Deadline,
    alike: Sequence[int] | None,
) -> dict[str, Any]:
    """A row: ``env_count`` environments on ``count`` devices.

    ``alike``: Newton iterations of each step that all environments are compared with; those of the
    first environment when None.
    """
    started = time.perf_counter()
    sources = workers.ask(count, "build", env_count, settings, ranked=True)
    setup_s = time.perf_counter() - started
    seconds: list[float] = []
    runs: list[Run] = []
    while len(seconds) < repeats and not (seconds and end.passed):
        workers.ask(count, "reset")
        started = time.perf_counter()
        runs = workers.ask(count, "run", settings.steps)
        seconds.append(time.perf_counter() - started)
    newton = np.concatenate([run.newton for run in runs], axis=1)
    forces = np.concatenate([run.forces_n for run in runs])
    residuals = [run.motion.residual() for run in runs]
    parts = [shard_slice(env_count, rank, count) for rank in range(count)]
    expected = newton[:, :1] if alike is None else np.array(alike)[:, None]
    return {
        "gpus": count,
        "envs": env_count,
        "source": sources[0],
        "fps": spread([env_count * settings.steps / s for s in seconds]),
        "ms_per_step": spread([1e3 * s / settings.steps for s in seconds]),
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


HEAD = (
    "scaling   GPUs    envs          FPS  spread  ideal  ms/step  Newton  differ  "
    "force spread [N]  residual/contact  unconverged"
)


def describe(row: dict[str, Any]) -> str:
    """A line of the table."""
    fps = row["fps"]
    width = (fps["max"] - fps["min"]) / fps["median"]
    return (
        f"{row['scaling']:<8} {row['gpus']:>4} {row['envs']:>7,} "
        f"{fps['median']:>12,.0f} {width:>6.1%}  {row['efficiency']:>5.0%} "
        f"{row['ms_per_step']['median']:>8.2f} {row['newton_mean']:>7.2f} "
        f"{row['newton_differ']:>7,} {row['force_spread_n']:>17.1e} "
        f"{row['worst_over_contact_force']:>17.1e} {row['unconverged']:>12,}"
    )
