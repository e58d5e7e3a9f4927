# SPDX-License-Identifier: Apache-2.0
"""The suite ``skips``: what leaving out a part of the plan saves, on and off in one run.

The two sides of a row are the same scene with and without the part. Their physics differ too
(friction changes the iterations), so time a Newton iteration stands beside time a step. Repeats
alternate between the sides, so that a slow moment of the machine meets both.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
import warp as wp

from taccel_lab.benchmarks.clock import clock_name
from taccel_lab.benchmarks.results import ResultFile, spread
from taccel_lab.benchmarks.runner import Motion, Runner
from taccel_lab.benchmarks.scenes import SceneOptions, build_scene
from taccel_lab.benchmarks.scenes.base import BenchScene
from taccel_lab.benchmarks.suite import Suite
from taccel_lab.geometry import PixelGrid
from taccel_lab.scene import AffineBody, KinematicBody, Scene, Surface, TimeStepping, box_mesh
from taccel_lab.tasks.peg_scene import generated_parts, peg_scene

AfterStep = Callable[[Runner], Callable[[], None]]
"""Of a runner: what is done after each of its steps."""


@dataclass(frozen=True)
class Skips(Suite):
    """What each part of the plan that a scene does not need would cost, on and off in one run."""

    name: ClassVar[str] = "skips"
    what: ClassVar[str] = (
        "What each part that a scene does not need would cost: the same scene with and without."
    )
    repeats: int = 5
    """Runs of each side, in turns; the median counts."""
    source: str = "auto"
    """Meshes: published, generated, or auto for the published ones where they are."""

    def settings(self) -> dict[str, Any]:
        return {
            "clock": clock_name(self.device),
            "repeats": self.repeats,
            "source": self.source,
        }

    def measure_rows(self, result: ResultFile) -> None:
        for skip in all_skips(self.source):
            result.measure(skip.name, partial(measure, skip, self.device, self.repeats), describe)


@dataclass(frozen=True)
class Side:
    """A scene, and what is read after each step."""

    bench: BenchScene
    steps: int | None = None
    after: AfterStep | None = None


@dataclass(frozen=True)
class Skip:
    """With and without a part."""

    name: str
    what: str
    on: Side
    off: Side


def all_skips(source: str) -> Iterator[Skip]:
    """A row each."""
    press = build_scene("press_239", SceneOptions(1, source))
    yield Skip(
        "no friction",
        "a press with shear: friction 0.5 and none",
        Side(press),
        Side(_with(press, kinematic_bodies=[_rubless(b) for b in press.scene.kinematic_bodies])),
    )
    dynamic = TimeStepping(quasi_static=False, dt_s=0.02)
    moving = _with(press, time=dynamic)
    yield Skip(
        "quasi-static",
        "a press with shear: with inertia and without",
        Side(moving),
        Side(press),
    )
    # It floats beside the gel, out of everything's way and layer.
    floating = AffineBody(
        box_mesh((5e-3, 5e-3, 5e-3)),
        initial_pose=np.array([0.1, 0, 0, 0, 0, 0, 1.0]),
        surface=Surface(layer=2, collides_with=2),
    )
    yield Skip(
        "no affine body",
        "a press with shear: with a free stiff body that touches nothing, and without",
        Side(_with(moving, affine_bodies=[floating])),
        Side(moving),
    )
    peg = build_scene("peg", SceneOptions(1, source))
    held = peg_scene(generated_parts(), hole_is_affine=True)
    fixed = peg_scene(generated_parts())
    path = peg.path
    yield Skip(
        "kinematic instead of affine",
        "the peg scene: the hole an affine body on a fixed joint, or kinematic",
        Side(replace(peg, scene=held, path=path[:, :2]), 30),
        Side(replace(peg, scene=fixed), 30),
    )
    yield Skip(
        "settled environments",
        "16 presses: all move, or one does and 15 stay",
        Side(_many(press, 16)),
        Side(_settled(press, 16)),
    )
    bear = build_scene("squeeze", SceneOptions(1, source))
    soft = bear.scene.soft_bodies
    yield Skip(
        "no self-contact",
        "two gels lift a bear: with self-contact of the bear and without",
        Side(_with(bear, soft_bodies=[replace(soft[0], self_contact=True), *soft[1:]])),
        Side(bear),
    )
    yield Skip(
        "no eager launches",
        "a press with shear: every kernel launched from the host, or the step as one graph",
        Side(replace(press, config=replace(press.config, capture=False))),
        Side(press),
    )
    yield Skip(
        "no signal",
        "a press with shear: height map and normals of 320 x 240 pixels read each step, or not",
        Side(press, after=_read_height_map),
        Side(press),
    )


def _with(bench: BenchScene, **parts: Any) -> BenchScene:
    """The same motion of a scene with other parts."""
    scene = bench.scene
    fields = ("soft_bodies", "kinematic_bodies", "env_count", "time", "affine_bodies", "planes")
    given = {name: getattr(scene, name) for name in fields} | parts
    return replace(bench, scene=Scene(**given, joints=scene.joints))


def _rubless(body: KinematicBody) -> KinematicBody:
    return replace(body, friction_coefficient=0.0)


def _many(bench: BenchScene, count: int) -> BenchScene:
    return _with(bench, env_count=count)


@dataclass(frozen=True)
class _OneMoves(BenchScene):
    """Only the first environment goes along the path; the others stay at its start."""

    def targets(self, step: int) -> np.ndarray:
        poses = super().targets(0).copy()
        poses[0] = self.path[step]
        return poses


def _settled(bench: BenchScene, count: int) -> BenchScene:
    many = _many(bench, count)
    return _OneMoves(
        many.name, many.what, many.scene, many.config, many.path, many.source, many.notes
    )


def _read_height_map(runner: Runner) -> Callable[[], None]:
    """Height and normals of the gel on a sensor's pixels."""
    from taccel_lab.signals import SignalTactile

    device = str(runner.model.device)
    mesh = runner.bench.scene.soft_bodies[0].mesh
    grid = PixelGrid(320, 240, 0.08, 0.08)
    signal = SignalTactile(mesh, grid, env_count=runner.model.env_count, device=device)

    def read() -> None:
        signal.update(runner.state.positions)
        signal.read("height_m", "normals")
        wp.synchronize_device(device)

    return read


def measure(skip: Skip, device: str, repeats: int) -> dict[str, Any]:
    """One row."""
    sides = {"on": skip.on, "off": skip.off}
    runners = {name: Runner(side.bench, device) for name, side in sides.items()}
    readers = {
        name: side.after(runners[name]) if side.after else None for name, side in sides.items()
    }
    times: dict[str, list[float]] = {name: [] for name in sides}
    motions: dict[str, Motion] = {}
    for repeat in range(repeats + 1):
        for name, side in sides.items():
            runners[name].reset()
            motion, seconds = _timed(runners[name], side.steps, readers[name])
            # The first round compiles and grows buffers.
            if repeat > 0:
                times[name].append(1e3 * seconds / len(motion.seconds))
                motions[name] = motion
    row: dict[str, Any] = {"skip": skip.name, "what": skip.what}
    for name, motion in motions.items():
        newton = float(np.sum(motion.newton_max))
        row[name] = {
            "ms_per_step": spread(times[name]),
            "ms_per_newton": float(np.median(times[name])) * len(motion.seconds) / max(newton, 1),
            "residual": motion.residual(),
            **motion.work(),
        }
    on, off = (row[name]["ms_per_step"]["median"] for name in ("on", "off"))
    row["saved_percent"] = 100 * (1 - off / on)
    return row


def describe(row: dict[str, Any]) -> str:
    """A line for the person who waits."""
    return (
        f"{row['skip']}: {row['on']['ms_per_step']['median']:.2f} ms a step with, "
        f"{row['off']['ms_per_step']['median']:.2f} without: saves {row['saved_percent']:.0f} %"
    )


def _timed(
    runner: Runner, steps: int | None, reader: Callable[[], None] | None
) -> tuple[Motion, float]:
    """A run, and its seconds with what is read."""
    spent = 0.0

    def after(step: int, report: Any) -> None:
        nonlocal spent
        if reader is not None:
            started = runner.clock()
            reader()
            spent += runner.clock() - started

    motion = runner.run(steps, after_step=after)
    return motion, sum(motion.seconds) + spent
