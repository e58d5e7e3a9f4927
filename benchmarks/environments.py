# SPDX-License-Identifier: Apache-2.0
"""The suite ``environments``: steps a second of a task as a learning loop has it, end to end, and
what the parts of a step cost.

``TactileVectorEnv`` with all its observations, stepped by an untrained policy that goes down on the
whole, environments in phases of their own. Images go through a colour network of the real
architecture with seeded random weights (that of the suite ``images``). Frames a second are timed
without a look inside; parts in another run, in which the device is waited for after each.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import warp as wp

from taccel_lab.benchmarks.clock import clock_name, clock_of
from taccel_lab.benchmarks.images import background, color_model
from taccel_lab.benchmarks.memory import MemoryMeter
from taccel_lab.benchmarks.results import ResultFile, Ticker, spread
from taccel_lab.benchmarks.runner import Motion
from taccel_lab.benchmarks.speed import parse_settings
from taccel_lab.benchmarks.suite import Suite
from taccel_lab.errors import InputError
from taccel_lab.progress import Progress, silent
from taccel_lab.solvers import EnvStatus

if TYPE_CHECKING:
    import torch

    from taccel_lab.learning.vector_env import TactileVectorEnv


@dataclass(frozen=True)
class Environments(Suite):
    """FPS of vector environments with images, end to end, and what each part costs."""

    name: ClassVar[str] = "environments"
    what: ClassVar[str] = (
        "Environments x steps / seconds of a gymnasium vector environment: actions in, images, "
        "markers, wrenches, rewards and ends out, in torch, new episodes begun on the way."
    )
    task: str = "peg-insertion"
    """Task that can be learned."""
    envs: tuple[int, ...] = (1, 64, 1024, 4096)
    """Numbers of environments, a row each."""
    steps: int = 100
    """Timed steps."""
    warm_up: int = 60
    """Steps before, in which each environment is put into a phase of its own."""
    repeats: int = 3
    """Timed runs, one going on where the other ended; the median counts."""
    observe: tuple[str, ...] = ("rgb", "markers_px", "wrench", "proprioception")
    """Observations, see docs/environments.md."""
    size_px: tuple[int, ...] = (80, 60)
    """Width and height of images."""
    randomised: bool = False
    """Whether episodes draw modulus, friction and mass, too."""
    seed: int = 0
    """Of episodes and actions."""
    set: tuple[str, ...] = ()
    """Solver settings other than the task's, e.g. relative_tolerance=1e-3."""

    def settings(self) -> dict[str, Any]:
        return {
            "task": self.task,
            "steps": self.steps,
            "warm_up_steps": self.warm_up,
            "repeats": self.repeats,
            "observe": list(self.observe),
            "size_px": list(self.size_px),
            "randomised": self.randomised,
            "seed": self.seed,
            "solver": parse_settings(self.set),
            "clock": clock_name(self.device),
        }

    def measure_rows(self, result: ResultFile) -> None:
        """Few environments before many."""
        if min(self.steps, self.warm_up, self.repeats, *self.envs) < 1:
            raise InputError("--envs, --steps, --warm-up and --repeats must be at least 1")
        if len(self.size_px) != 2:
            raise InputError(f"--size-px needs width and height, got {len(self.size_px)} numbers")
        for count in self.envs:
            result.measure(f"{count} environments", partial(measure, count, self), describe)


class EnvironmentLoop:
    """A vector environment stepped by an untrained policy."""

    def __init__(self, count: int, options: Environments) -> None:
        import torch

        from taccel_lab.learning.catalogue import make_vec

        self.env: TactileVectorEnv = make_vec(
            options.task,
            count,
            observe=options.observe,
            size_px=(options.size_px[0], options.size_px[1]),
            colors=lambda grid: (color_model(grid), background(grid)),
            randomised=options.randomised,
            device=options.device,
            solver=parse_settings(options.set),
        )
        self._clock = clock_of(self.env.model.device)
        self._random = torch.Generator(self.env.device).manual_seed(options.seed)
        self.env.reset(seed=options.seed)
        self.failed = 0
        """Simulations that failed so far."""

    def act(self) -> torch.Tensor:
        """Noise, and down along z."""
        import torch

        size = (self.env.num_envs, len(self.env.task.action_names))
        action = 0.5 * torch.randn(size, generator=self._random, device=self.env.device)
        action[:, 2] -= 0.7
        return action

    def spread_phases(self, steps: int, seed: int, progress: Progress = silent) -> None:
        """So many steps, in which each environment begins anew once."""
        when = np.random.default_rng(seed).integers(0, steps, self.env.num_envs)
        for step in range(steps):
            self.env.step(self.act())
            if (when == step).any():
                self.env.reset(options={"reset_mask": when == step})
            progress("steps", step + 1, steps)

    def run(self, steps: int, progress: Progress = silent) -> float:
        """Seconds of so many steps, of the environment alone: actions are drawn before."""
        device, total = self.env.model.device, 0.0
        for step in range(steps):
            action = self.act()
            wp.synchronize_device(device)
            started = self._clock()
            info = self.env.step(action)[-1]
            wp.synchronize_device(device)
            total += self._clock() - started
            self.failed += int(info["_cause"].sum()) if "cause" in info else 0
            progress("steps", step + 1, steps)
        return total

    def run_in_parts(self, steps: int, progress: Progress = silent) -> tuple[dict, Motion, int]:
        """Seconds of the parts of so many steps, what the solver did, and episodes begun."""
        env, parts, motion = self.env, defaultdict(float), Motion()
        begun = 0

        def timed(work: Callable, name: str | None = None) -> Callable:
            def wrapped(*args: Any, **options: Any) -> Any:
                nonlocal begun
                wp.synchronize_device(env.model.device)
                started = self._clock()
                found = work(*args, **options)
                wp.synchronize_device(env.model.device)
                seconds = self._clock() - started
                # A view is named by its first argument.
                parts[name or args[0]] += seconds
                if name == "step":
                    motion.add(found.of(found.status != EnvStatus.SKIPPED), seconds, seconds)
                elif name == "reset":
                    begun += int(args[0].sum())
                return found

            return wrapped

        methods: list[tuple[Any, str, str | None]] = [
            (env.solver, "step", "step"),
            (env, "begin_episodes", "reset"),
            (env.views, "read", None),
        ]
        for owner, method, name in methods:
            setattr(owner, method, timed(getattr(owner, method), name))
        try:
            whole = self.run(steps, progress)
        finally:
            for owner, method, _ in methods:
                delattr(owner, method)
        parts["other"] = whole - sum(parts.values())
        return dict(parts), motion, begun


def measure(count: int, options: Environments) -> dict[str, Any]:
    """One row."""
    label = f"{options.task}, {count} environments"
    with MemoryMeter(options.device) as meter:
        loop = EnvironmentLoop(count, options)
        loop.spread_phases(options.warm_up, options.seed, Ticker(f"{label}, warming up"))
        seconds = [
            loop.run(options.steps, Ticker(f"{label}, run {i + 1}/{options.repeats}"))
            for i in range(options.repeats)
        ]
        failed = loop.failed
        parts, motion, begun = loop.run_in_parts(options.steps, Ticker(f"{label}, parts"))
    bytes_used = meter.used_bytes()
    model = loop.env.model
    return {
        "task": options.task,
        "envs": count,
        "steps": options.steps,
        "soft_nodes": model.soft_count,
        "gels": len(loop.env.views.gels),
        "observe": list(options.observe),
        "fps": spread([count * options.steps / s for s in seconds]),
        "ms_per_step": spread([1e3 * s / options.steps for s in seconds]),
        "failed": failed,
        "env_steps": count * options.steps * options.repeats,
        "parts_ms_per_step": {name: 1e3 * s / options.steps for name, s in parts.items()},
        "begun_per_step": begun / options.steps,
        "residual": motion.residual(),
        **motion.work(),
        "memory_mib_per_env": bytes_used / 2**20 / count,
    }


def describe(row: dict[str, Any]) -> str:
    """A line for the person who waits."""
    parts = ", ".join(f"{name} {ms:.2f}" for name, ms in row["parts_ms_per_step"].items())
    return (
        f"{row['task']}, {row['envs']} environments: {row['fps']['median']:,.1f} FPS, "
        f"{row['ms_per_step']['median']:.2f} ms a step; in parts [ms]: {parts}; "
        f"{row['begun_per_step']:.2f} episodes begun a step, {row['failed']} of "
        f"{row['env_steps']:,} simulations failed, Newton {row['newton_mean']:.1f}, residual "
        f"{row['residual']['worst_over_contact_force']:.1e} of the contact force"
    )
