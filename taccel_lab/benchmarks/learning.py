# SPDX-License-Identifier: Apache-2.0
"""The suite ``learning``: steps a second as a learning loop uses the solver.

Environments that all do the same are the best case of a batch. In a learning loop each is in its
own phase, its targets are an untrained policy's, and some begin anew at every step; the
batch waits for its slowest environment, unless each goes at its own pace (``ReadySteps``), as those
who make data may let it. Resets, the check of new starts, setting targets, stepping and reading
forces are timed, and what a policy sees of a step where one looks (``Observer``):

Images are those of ``SignalTactile``, 64 x 64 pixels over the gel's contact face by a colour
network of the real architecture with seeded random weights (``color_model``); wrenches
those of ``Outputs.soft_wrenches``. Torch reads both where they are, and takes the mean of each
colour of each image: nothing is copied to the host.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import warp as wp

from taccel_lab.benchmarks.measure import MemoryMeter, clock_name, clock_of
from taccel_lab.benchmarks.results import ResultFile, Suite, Ticker, spread
from taccel_lab.benchmarks.runner import SHOWN, BenchmarkMotion, ForceProbe, figures_of, middle_of
from taccel_lab.benchmarks.scenes import SCENES, SceneOptions, build_scene
from taccel_lab.benchmarks.scenes.base import BenchScene
from taccel_lab.benchmarks.speed import parse_settings
from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.guards import require_known, require_range
from taccel_lab.model import Model
from taccel_lab.networks.color_settings import ColorModelConfig
from taccel_lab.outputs import to_torch
from taccel_lab.outputs.gel_frames import GelFrames
from taccel_lab.outputs.soft_wrenches import SoftWrenchReader
from taccel_lab.progress import Progress, silent
from taccel_lab.signals.color_model import ColorModel
from taccel_lab.signals.gel_faces import bonded_gels, face_grid
from taccel_lab.signals.tactile import SignalTactile
from taccel_lab.solvers import EnvStatus, ReadySteps, SolverIPC, StepReport
from taccel_lab.state import State, initial_state

if TYPE_CHECKING:
    import torch


SIZE_PX = (64, 64)
OBSERVED = ("rgb", "wrench")
"""What there is to see."""


@dataclass
class Sight:
    """How much was seen, and what it took."""

    env_steps: int
    """Steps of environments that were looked at."""
    seconds: dict[str, float]
    """Seconds of each kind, torch's part too."""

    @classmethod
    def none(cls, names: tuple[str, ...]) -> Sight:
        return cls(0, dict.fromkeys(names, 0.0))

    @property
    def total_s(self) -> float:
        """Seconds of all kinds."""
        return sum(self.seconds.values())


class Observer:
    """Looks at the gels of a solver's scene: its bonded soft bodies."""

    def __init__(self, solver: SolverIPC, names: tuple[str, ...]) -> None:
        """``names``: of ``OBSERVED``.

        Raises:
            InputError: The scene has no gel.
        """
        self._model = model = solver.model
        self._clock = clock_of(model.device)
        self.gels = bonded_gels(model)
        """Indices of the gels among the soft bodies."""
        self._frames = GelFrames(model)
        self._signals = [gel_signal(model, i) for i in self.gels] if "rgb" in names else []
        self._wrenches = SoftWrenchReader(solver) if "wrench" in names else None
        self.images: list[torch.Tensor] = []
        """Latest images of each gel, uint8, [env observed, 64, 64, 3] each."""
        self.wrenches: torch.Tensor | None = None
        """Latest wrenches on the soft bodies, float64, [env observed, soft body, 6]."""
        self.features: torch.Tensor | None = None
        """What torch made of them, float32, [env observed, gel, ...]: the means of three colours, 0
        to 1, and the six entries of the wrench, in the order asked for."""
        self._names = names
        self._spent = Sight.none(names)

    def observe(self, state: State, who: np.ndarray | None = None) -> None:
        """See what the last step led to in the environments of ``who`` (bool, [env_count]), in all
        when None; waits for the device, so that each kind has its own time."""
        import torch

        count = self._model.env_count if who is None else int(np.count_nonzero(who))
        if count == 0:
            return
        self._spent.env_steps += count
        wp.synchronize_device(self._model.device)
        parts = []
        for name in self._names:
            started = self._clock()
            parts.append(self._see_images(state, who) if name == "rgb" else self._feel(state, who))
            wp.synchronize_device(self._model.device)
            self._spent.seconds[name] += self._clock() - started
        self.features = torch.cat(parts, dim=2)

    def take(self) -> Sight:
        """What was seen since this was asked last."""
        spent, self._spent = self._spent, Sight.none(self._names)
        return spent

    def _see_images(self, state: State, who: np.ndarray | None) -> torch.Tensor:
        import torch

        self.images = []
        for gel, signal in zip(self.gels, self._signals, strict=True):
            signal.update(state.positions, self._frames.of(gel, state), who)
            self.images.append(to_torch(signal.rgb))
        means = [image.to(torch.float32).mean(dim=(1, 2)) / 255.0 for image in self.images]
        return torch.stack(means, dim=1)

    def _feel(self, state: State, who: np.ndarray | None) -> torch.Tensor:
        import torch

        assert self._wrenches is not None
        self.wrenches = to_torch(self._wrenches.read(state, who))
        return self.wrenches[:, self.gels].to(torch.float32)

    def figures(self, sight: Sight, env_steps: int, seconds: float) -> dict[str, Any]:
        """Figures for a row of results, of ``env_steps`` steps that took so long."""
        found: dict[str, Any] = {"what": list(self._names), "gels": len(self.gels)}
        found |= {"env_steps": sight.env_steps, "fps": env_steps / seconds}
        found["fps_without"] = env_steps / (seconds - sight.total_s)
        for name, spent in sight.seconds.items():
            found[f"{name}_us_per_env_step"] = 1e6 * spent / sight.env_steps
        if self._signals:
            found["size_px"] = list(SIZE_PX)
            found["images_per_s"] = sight.env_steps * len(self.gels) / sight.seconds["rgb"]
        return found


def gel_signal(model: Model, body: int) -> SignalTactile:
    """Images of a soft body's contact face, which fills them; pixels need not be square."""
    mesh = model.scene.soft_bodies[body].nodal_mesh
    grid = face_grid(mesh, SIZE_PX)
    return SignalTactile(
        mesh, grid, env_count=model.env_count, color_model=color_model(grid),
        background_rgb=background(grid), first_node=model.bodies[body].node_slice.start,
        device=model.device,
    )  # fmt: skip


@dataclass(frozen=True)
class Learning(Suite):
    """FPS as a learning loop has it: own phases, random targets, resets, starts checked."""

    name: ClassVar[str] = "learning"
    what: ClassVar[str] = (
        "Environments x steps / seconds of a learning loop: every environment in its own phase, "
        "random targets, some reset at every step, new starts checked, forces read."
    )
    shown: ClassVar[tuple[str, ...]] = (
        *SHOWN, "beside_steps_ms", "resets_per_step", "newton_p999", "newton_largest_mean",
        "observed: rgb_us_per_env_step", "observed: wrench_us_per_env_step",
        "observed: fps_without",
    )  # fmt: skip
    scene: str = "peg"
    """Scene: peg, press_239, press_2005, press_5215, bolt, hand or squeeze."""
    envs: tuple[int, ...] = (16,)
    """Numbers of environments, a row each."""
    steps: int = 100
    """Timed steps."""
    warm_up: int = 0
    """Steps before, in which each environment gets its own phase; 0: as many as the motion
    has, so that the phases of the timed steps are uniform over it."""
    repeats: int = 1
    """Timed runs, one going on where the other ended; the median counts."""
    reset_share: float = 0.0
    """Part of the environments that begin anew at a step, besides those that have finished. More
    than 0 favours the begin of the motion."""
    offset_mm: float = 0.1
    """Targets of moving bodies are off by up to this along each axis, anew at every step; starts
    are not."""
    pace: tuple[str, ...] = ("together",)
    """together: a step ends when all environments have finished. own: each begins its next step
    when its last one is over, and a call does --iterations of them. A row each."""
    iterations: int = 4
    """Rounds of a call, of environments that go at their own pace."""
    observe: tuple[str, ...] = ()
    """What torch reads of each finished step, on the device: rgb, images of 64 x 64 pixels of each
    gel; wrench, force and torque on each gel, in place of the forces that the host reads."""
    seed: int = 0
    """Seed of phases, offsets and resets."""
    source: str = "auto"
    """Meshes: published, generated, or auto for the published ones where they are."""
    set: tuple[str, ...] = ()
    """Solver settings other than the scene's, e.g. relative_tolerance=1e-5."""

    def settings(self) -> dict[str, Any]:
        return super().settings() | {
            "solver": parse_settings(self.set),
            "clock": clock_name(self.device),
        }

    def measure_rows(self, result: ResultFile) -> None:
        """Few environments before many."""
        require_known("scene", self.scene, SCENES)
        if min(self.steps, self.repeats, *self.envs) < 1 or self.warm_up < 0:
            raise InputError("--envs, --steps and --repeats must be at least 1, --warm-up 0")
        for pace in self.pace:
            require_known("--pace", pace, ("together", "own"))
        if not set(self.observe) <= set(OBSERVED) or len(set(self.observe)) < len(self.observe):
            raise InputError(f"--observe must be rgb, wrench or both, got {' '.join(self.observe)}")
        require_range("--reset-share", self.reset_share, 0, 1)
        for count in self.envs:
            for pace in self.pace:
                row = partial(measure, count, pace, self)
                result.measure(f"{self.scene}, {count}, {pace}", row)


class LearningPhases:
    """Where in the motion each environment stands, and which begin anew."""

    def __init__(
        self, count: int, steps: int, warm_up: int, reset_share: float, random: np.random.Generator
    ) -> None:
        self.steps = steps
        """Steps of the motion."""
        self.warm_up = warm_up or steps
        """Steps after which each environment has begun anew once, at its own step."""
        self.now = np.zeros(count, dtype=np.int64)
        """Steps of the motion that each environment has begun."""
        self._taken = np.zeros(count, dtype=np.int64)
        self._first_reset = random.integers(0, self.warm_up, count)
        self._reset_share = reset_share
        self._random = random

    def begin(self, ready: np.ndarray) -> np.ndarray:
        """Ready environments that begin anew; the others go on. bool, [count]."""
        anew = self._random.random(len(ready)) < self._reset_share
        anew |= (self.now == self.steps) | (self._first_reset == self._taken)
        anew &= ready
        self.now[anew] = 0
        self.now[ready] += 1
        self._taken[ready] += 1
        return anew


class LearningLoop:
    """A scene stepped by an untrained policy, environments in their own phases."""

    def __init__(self, bench: BenchScene, options: Learning, pace: str = "together") -> None:
        self._bench = bench
        self._options = options
        self.model = bench.scene.finalize(options.device)
        self.solver = SolverIPC(self.model, replace(bench.config, check_start=True))
        self.state = initial_state(self.model, bench.targets(0))
        self._forces = None if "wrench" in options.observe else ForceProbe(self.solver)
        self.observer = Observer(self.solver, options.observe) if options.observe else None
        self._clock = clock_of(self.model.device)
        self._random = np.random.default_rng(options.seed)
        self._moves = (np.ptp(bench.path, axis=0) > 0).any(axis=1)
        """Bodies whose targets are off, bool, [kinematic_count]."""
        self.phases = LearningPhases(
            self.model.env_count, bench.steps, options.warm_up, options.reset_share, self._random,
        )  # fmt: skip
        self._ready = np.ones(self.model.env_count, dtype=bool)
        """Environments that are to begin a step."""
        self._own_pace = None
        if pace == "own":
            self._own_pace = ReadySteps(self.solver, self.state, options.iterations)
        self.resets = 0
        """Environments begun anew so far."""
        self.places: list[np.ndarray] = []
        """Places of the steps that ended, as shares of the motion in (0, 1], call by call."""

    def _targets(self) -> np.ndarray:
        """Targets of the phases, with offsets, [env_count, kinematic_count, 7]."""
        targets = self._bench.path[self.phases.now].copy()
        shape = (len(targets), int(self._moves.sum()), 3)
        reach = 1e-3 * self._options.offset_mm
        targets[:, self._moves, :3] += self._random.uniform(-reach, reach, shape)
        return targets

    def run(self, steps: int, progress: Progress = silent) -> BenchmarkMotion:
        """Takes ``steps`` steps of each environment (in the mean, at their own pace) from where the
        loop stands."""
        motion = BenchmarkMotion()
        wp.synchronize_device(self.model.device)
        wanted = steps * self.model.env_count
        while motion.env_steps < wanted:
            # What a policy would decide is not the solver's time.
            ready = self._ready.copy()
            begin = self.phases.begin(ready)
            targets = self._targets()
            started = self._clock()
            if begin.any():
                self.solver.reset(self.state, begin, self._bench.targets(0))
            before = self._clock()
            report = self._step(targets, ready)
            after = self._clock()
            if self._forces is not None:
                self._forces.read(self.state)
            if self.observer is not None:
                self.observer.observe(self.state, None if self._own_pace is None else self._ready)
            motion.add(report, self._clock() - started, after - before)
            self.places.append(self.phases.now[self._ready] / self.phases.steps)
            self.resets += int(begin.sum())
            progress("steps", motion.env_steps // self.model.env_count, steps)
        return motion

    def take_sight(self) -> Sight:
        """What was observed since this was asked last."""
        return Sight.none(()) if self.observer is None else self.observer.take()

    def _step(self, targets: np.ndarray, ready: np.ndarray) -> StepReport:
        """One call; the report of the environments that have finished."""
        if self._own_pace is None:
            return self.solver.step(self.state, targets)
        report = self._own_pace.step_ready(targets, ready)
        self._ready = report.status != EnvStatus.RUNNING
        return report.of(self._ready)


def measure(count: int, pace: str, options: Learning) -> dict[str, Any]:
    """One row."""
    chosen = SceneOptions(count, options.source, parse_settings(options.set))
    bench = build_scene(options.scene, chosen)
    with MemoryMeter(options.device) as meter:
        loop = LearningLoop(bench, options, pace)
        label = f"{options.scene}, {count} environments"
        loop.run(loop.phases.warm_up, Ticker(f"{label}, warming up"))
        loop.places.clear()
        before = loop.resets
        loop.take_sight()
        runs, sights = [], []
        for i in range(options.repeats):
            runs.append(loop.run(options.steps, Ticker(f"{label}, run {i + 1}/{options.repeats}")))
            sights.append(loop.take_sight())
    bytes_used = meter.used_bytes()
    middle = middle_of(runs)
    median, sight = runs[middle], sights[middle]
    beside_s = sum(median.seconds) - sum(median.solver_seconds) - sight.total_s
    observed = None
    if loop.observer is not None:
        observed = loop.observer.figures(sight, median.env_steps, sum(median.seconds))
    thirds = np.histogram(np.concatenate(loop.places), bins=3, range=(0, 1))[0]
    # Of environments at their own pace a call is less than a step.
    calls = [len(run.seconds) / options.steps for run in runs]
    return {
        **figures_of(runs, bench, loop.model),
        "pace": pace,
        "steps": options.steps,
        "ms_per_step": spread([1e3 * sum(run.seconds) / options.steps for run in runs]),
        "calls_per_step": float(np.mean(calls)),
        "beside_steps_ms": 1e3 * beside_s / options.steps,
        "worst_call_ms": 1e3 * max(median.seconds),
        "warm_up_steps": loop.phases.warm_up,
        "motion_steps": bench.steps,
        "phase_thirds": (thirds / thirds.sum()).tolist(),
        "resets_per_step": (loop.resets - before) / (options.steps * options.repeats),
        "newton_largest_mean": median.largest_newton_mean(),
        "memory_mib_per_env": bytes_used / 2**20 / count,
        "observed": observed,
    }


def color_model(grid: PixelGrid) -> ColorModel:
    """Random weights of the real architecture; a press of the benchmark changes tens of levels."""
    rng = np.random.default_rng(3)
    config = ColorModelConfig(
        grid.width_px,
        grid.height_px,
        input_mean=(0.0, 0.0, 0.0, 0.0, 0.97, -0.2),
        input_scale=(0.6, 0.6, 0.15, 0.15, 0.03, 0.25),
    )
    weights = {}
    for name, shape in config.weight_shapes().items():
        spread = 1.6 / np.sqrt(shape[-1]) if len(shape) == 2 else 0.2
        weights[name] = rng.normal(0.0, spread, shape)
    return ColorModel(config, weights)


def background(grid: PixelGrid) -> np.ndarray:
    """Levels of an untouched sensor, [height_px, width_px, 3]."""
    u, v = np.meshgrid(np.linspace(0, 1, grid.width_px), np.linspace(0, 1, grid.height_px))
    return np.round(np.stack([90 + 60 * u, 140 - 40 * v, 110 + 30 * u * v], axis=-1))
