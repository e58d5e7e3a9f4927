# SPDX-License-Identifier: Apache-2.0
"""The suite ``scaling``: time and memory by environments, nodes, contacts and sensors, with the
exponents of power laws fitted to the larger half of each series."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np

from taccel_lab.benchmarks.clock import clock_name
from taccel_lab.benchmarks.front import power_law
from taccel_lab.benchmarks.memory import MemoryMeter
from taccel_lab.benchmarks.results import ResultFile, spread
from taccel_lab.benchmarks.runner import Motion, Runner
from taccel_lab.benchmarks.scenes import SceneOptions, build_scene
from taccel_lab.benchmarks.scenes.base import BenchScene, make_config, straight
from taccel_lab.benchmarks.suite import Suite
from taccel_lab.geometry.block import block_mesh
from taccel_lab.scene import Ball, Element, KinematicBody, Scene, SoftBody, box_mesh
from taccel_lab.tasks.peg_scene import GEL

SPACING_M = 40e-3
"""Between the sensors of a row."""
FRICTION = 0.5
DHAT_M = 2e-5


@dataclass(frozen=True)
class Scaling(Suite):
    """Time and memory by environments, nodes, contacts and sensors, with fitted exponents."""

    name: ClassVar[str] = "scaling"
    what: ClassVar[str] = "Time and memory by environments, nodes, contacts and sensors."
    envs: tuple[int, ...] = (1, 2, 4, 8, 16)
    """Environments of the peg scene."""
    cells: tuple[int, ...] = (3, 4, 6, 8, 10, 12)
    """Layers of a block under a ball; nodes go with the third power."""
    punch_mm: tuple[float, ...] = (2, 4, 8, 12, 16, 20)
    """Sides of a flat punch; contacts go with its area."""
    sensors: tuple[int, ...] = (1, 2, 4, 8, 16)
    """Gels in an environment."""
    steps: int | None = 30
    """First steps of the peg scene's motion."""
    repeats: int = 3
    """Runs of each row; the median counts."""
    source: str = "auto"
    """Meshes: published, generated, or auto for the published ones where they are."""

    def settings(self) -> dict[str, Any]:
        return {
            "clock": clock_name(self.device),
            "repeats": self.repeats,
            "steps": self.steps,
            "source": self.source,
        }

    def measure_rows(self, result: ResultFile) -> None:
        """All points, then the fits."""
        for point in all_points(self):
            row = partial(measure, point, self.device, self.repeats)
            result.measure(f"{point.series}, {point.size}", row, describe)
        result.put("fits", fit(result.rows))


@dataclass(frozen=True)
class Point:
    """One scene of a series."""

    series: str
    size: int
    """Environments, nodes, contacts wanted, or sensors."""
    bench: BenchScene
    steps: int | None = None


def all_points(options: Scaling) -> Iterator[Point]:
    """Every series, small sizes first."""
    for count in options.envs:
        bench = build_scene("peg", SceneOptions(count, options.source))
        yield Point("environments", count, bench, options.steps)
    for cells in options.cells:
        bench = press_scene((2 * cells, 2 * cells, cells), ball_m=8e-3)
        yield Point("nodes", _nodes(bench), bench)
    for side_mm in options.punch_mm:
        yield Point("contacts", 0, punch_scene(1e-3 * side_mm))
    for count in options.sensors:
        yield Point("sensors", count, row_of_sensors(count))


def press_scene(cells: tuple[int, int, int], ball_m: float) -> BenchScene:
    """A ball on a block of 24 x 24 x 6 mm."""
    gel = SoftBody(
        block_mesh(cells, (24e-3, 24e-3, 6e-3), jitter=0.1, seed=1), GEL, element=Element.LINEAR
    )
    scene = Scene(gel, KinematicBody(Ball(ball_m), FRICTION, name="ball"))
    path = _down(ball_m, 1e-3, 5)[:, None]
    return BenchScene("press", "a ball on a block", scene, _config(), path, "generated")


def punch_scene(side_m: float) -> BenchScene:
    """A flat punch of a given side on a fine block: contacts grow with its area."""
    cells, size = (24, 24, 3), (24e-3, 24e-3, 4e-3)
    gel = SoftBody(block_mesh(cells, size, jitter=0.1, seed=1), GEL, element=Element.LINEAR)
    punch = box_mesh((side_m, side_m, 4e-3))
    scene = Scene(gel, KinematicBody(punch, FRICTION, name="punch"))
    path = _down(2e-3, 0.2e-3, 4)[:, None]
    return BenchScene("punch", "a flat punch on a block", scene, _config(), path, "generated")


def row_of_sensors(count: int) -> BenchScene:
    """Gels side by side in one environment, a ball on each."""
    mesh = block_mesh((8, 8, 3), (24e-3, 24e-3, 6e-3), jitter=0.1, seed=1)
    places = SPACING_M * np.arange(count)
    gels, bodies, paths = [], [], []
    for i, x in enumerate(places):
        frame = KinematicBody(None, name=f"mount {i}")
        gels.append(SoftBody(mesh, GEL, name=f"gel {i}", mount=frame.name, element=Element.LINEAR))
        bodies += [frame, KinematicBody(Ball(8e-3), FRICTION, name=f"ball {i}")]
        down = _down(8e-3, 1e-3, 5)
        down[:, 0] += x
        still = np.tile([x, 0, 0, 0, 0, 0, 1.0], (len(down), 1))
        paths += [still, down]
    scene = Scene(gels, bodies)
    path = np.stack(paths, axis=1)
    return BenchScene("sensors", f"{count} gels in a row", scene, _config(), path, "generated")


def _down(reach_m: float, depth_m: float, steps: int) -> np.ndarray:
    """Straight down from just above the gel, [steps + 1, 7]."""
    start, end = reach_m + 5e-5, reach_m - depth_m
    points = np.array([[3e-4, -2e-4, z, 0, 0, 0, 1.0] for z in (start, end)])
    return straight(points, [steps])


def _config() -> Any:
    return make_config({"dhat_m": DHAT_M, "friction_eps_m": 1e-6}, {})


def _nodes(bench: BenchScene) -> int:
    return sum(body.mesh.node_count for body in bench.scene.soft_bodies)


def measure(point: Point, device: str, repeats: int) -> dict[str, Any]:
    """One row."""
    with MemoryMeter(device) as meter:
        runner = Runner(point.bench, device)
        runner.run(point.steps)
    runs: list[Motion] = []
    contacts: list[float] = []

    def count(step: int, report: Any) -> None:
        contacts.append(float(runner.contact_counts().mean()))

    for repeat in range(repeats):
        runner.reset()
        runs.append(runner.run(point.steps, after_step=count if repeat == 0 else None))
    median = sorted(runs, key=lambda run: run.fps)[len(runs) // 2]
    seconds = [float(np.mean(run.solver_seconds)) for run in runs]
    newton = float(np.sum(median.newton_max))
    return {
        "series": point.series,
        "size": point.size or round(max(contacts)),
        "scene": point.bench.name,
        "envs": runner.model.env_count,
        "nodes": runner.model.soft_count,
        "contacts": max(contacts),
        "steps": len(median.seconds),
        "ms_per_step": spread([1e3 * s for s in seconds]),
        "ms_per_newton": 1e3 * sum(median.solver_seconds) / max(newton, 1.0),
        "memory_mib": meter.used_bytes() / 2**20,
        "residual": median.residual(),
        **median.work(),
    }


def describe(row: dict[str, Any]) -> str:
    """A line for the person who waits."""
    return (
        f"{row['series']} {row['size']:,}: {row['ms_per_step']['median']:.2f} ms a step, "
        f"{row['memory_mib']:.2f} MiB, Newton {row['newton_mean']:.1f}, "
        f"{row['contacts']:.0f} contacts"
    )


def fit(rows: list[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Exponents of time a step, time a Newton iteration and memory, by series."""
    fits = {}
    for series in dict.fromkeys(row["series"] for row in rows):
        mine = [row for row in rows if row["series"] == series]
        mine = mine[min(len(mine) // 2, max(len(mine) - 3, 0)) :]
        sizes = np.array([row["size"] for row in mine], dtype=np.float64)
        if len(np.unique(sizes)) < 2:
            continue
        values = {
            "time": [row["ms_per_step"]["median"] for row in mine],
            "time_per_newton": [row["ms_per_newton"] for row in mine],
            "memory": [row["memory_mib"] for row in mine],
        }
        fits[series] = {
            name: round(power_law(sizes, np.array(value))[0], 3) for name, value in values.items()
        } | {"from": float(sizes.min()), "to": float(sizes.max())}
    return fits
