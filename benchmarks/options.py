# SPDX-License-Identifier: Apache-2.0
"""What each suite can be asked, for ``taccel-lab bench`` and ``python -m taccel_lab.benchmarks``
alike.

Nothing heavy is imported before ``run``. Field docstrings are the help of both command lines.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

_ROOT = Path(__file__).resolve().parents[1]
RESULTS = (
    _ROOT / "benchmarks" / "results"
    if (_ROOT / "pyproject.toml").is_file()
    else Path("out/benchmarks")
)
"""Of a checkout, or a folder of the caller's where the package is installed."""


@dataclass(frozen=True)
class Speed:
    """FPS = environments x steps / seconds, end to end, at a stated force residual."""

    name: ClassVar[str] = "speed"
    scene: tuple[str, ...] = ("peg",)
    """Scenes: peg, press_239, press_2005, press_5215, bolt, hand, squeeze, or all."""
    envs: tuple[int, ...] = (1,)
    """Numbers of environments, a row each."""
    steps: int | None = None
    """First steps of the motion; all of it by default."""
    repeats: int = 5
    """Runs of each row; the median counts."""
    budget_s: float | None = None
    """Seconds after which no new row or repeat is started."""
    source: str = "auto"
    """Meshes: published, generated, or auto for the published ones where they are."""
    set: tuple[str, ...] = ()
    """Solver settings other than the scene's, e.g. relative_tolerance=1e-5."""
    lag: int = 0
    """Environment e is e modulo (LAG + 1) steps behind, so that they differ; 0: all do the same."""
    startup: bool = True
    """Time import to first step, with a warm and a cold kernel cache, in processes of their own."""
    check: bool = False
    """Look for intersections after the last step (slow: the referee is numpy)."""
    device: str = "cpu"
    """cpu, cuda:0, ..."""
    out: Path = RESULTS
    """Folder of the result, or a JSON file."""

    def run(self) -> None:
        from taccel_lab.benchmarks.speed import run_speed

        run_speed(self)


@dataclass(frozen=True)
class Error:
    """Run time against error: mesh, element, dt, dhat, tolerance, friction eps, solver choices."""

    name: ClassVar[str] = "error"
    repeats: int = 3
    """Runs of each row; the median time counts."""
    quick: bool = False
    """Coarse meshes and a few rows, to see that it works."""
    budget_s: float | None = None
    """Seconds after which no new row is started."""
    device: str = "cpu"
    """cpu, cuda:0, ..."""
    out: Path = RESULTS
    """Folder of the result, or a JSON file."""

    def run(self) -> None:
        from taccel_lab.benchmarks.error import run_error

        run_error(self)


@dataclass(frozen=True)
class Scaling:
    """Time and memory by environments, nodes, contacts and sensors, with fitted exponents."""

    name: ClassVar[str] = "scaling"
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
    budget_s: float | None = None
    """Seconds after which no new row is started."""
    device: str = "cpu"
    """cpu, cuda:0, ..."""
    out: Path = RESULTS
    """Folder of the result, or a JSON file."""

    def run(self) -> None:
        from taccel_lab.benchmarks.scaling import run_scaling

        run_scaling(self)


@dataclass(frozen=True)
class Skips:
    """What each part of the plan that a scene does not need would cost, on and off in one run."""

    name: ClassVar[str] = "skips"
    repeats: int = 5
    """Runs of each side, in turns; the median counts."""
    source: str = "auto"
    """Meshes: published, generated, or auto for the published ones where they are."""
    budget_s: float | None = None
    """Seconds after which no new row is started."""
    device: str = "cpu"
    """cpu, cuda:0, ..."""
    out: Path = RESULTS
    """Folder of the result, or a JSON file."""

    def run(self) -> None:
        from taccel_lab.benchmarks.skips import run_skips

        run_skips(self)


@dataclass(frozen=True)
class Stress:
    """Hundreds of random scenes over extremes; no failure may be silent (benchmarks/stress)."""

    name: ClassVar[str] = "stress"
    count: int = 200
    """Scenes."""
    seed: int = 0
    """Of the first scene; the same seed gives the same scenes."""
    device: str = "cpu"
    """cpu, cuda:0, ..."""
    out: Path = RESULTS
    """Folder of the result, or a JSON file."""

    def run(self) -> None:
        from taccel_lab.benchmarks.results import result_path
        from taccel_lab.benchmarks.stress import run, table

        record = run(self.count, self.seed, result_path("stress", self.out), self.device)
        print(table(record["summary"]))


@dataclass(frozen=True)
class Peers:
    """Run another simulator's driver of the peg scene, and keep the figures it prints."""

    name: ClassVar[str] = "peers"
    driver: Path
    """Script that prints a line RESULT NAME ... N=16 ... FPS=123.4 for each row."""
    arguments: str = ""
    """Its arguments in quotes, as in --arguments="--N 1,16"."""
    stop: str = "not stated"
    """When its steps end, for the table."""
    device: str = "cpu"
    """Device that it runs on: names the machine in the result."""
    out: Path = RESULTS
    """Folder of the result, or a JSON file."""

    def run(self) -> None:
        from taccel_lab.benchmarks.peers import run_peers

        run_peers(self)


@dataclass(frozen=True)
class Study:
    """Designs a minute: every design meshed, pressed in the standard ways and judged."""

    name: ClassVar[str] = "study"
    sensor: str = "gelsight_mini"
    """Sensor of the catalogue."""
    vary: str = "thickness_mm"
    """Dimension in which the designs differ, by up to a fifth of its default."""
    designs: tuple[int, ...] = (8,)
    """Numbers of designs, a row each."""
    budget_s: float | None = None
    """Seconds after which no new row is started."""
    reference: Path | None = None
    """Result of another device, whose forces are compared with."""
    device: str = "cpu"
    """cpu, cuda:0, ..."""
    out: Path = RESULTS
    """Folder of the result, or a JSON file."""

    def run(self) -> None:
        from taccel_lab.benchmarks.design_study import run_study

        run_study(self)


@dataclass(frozen=True)
class Captures:
    """Accuracy and time of every calibration on published captures of real sensors, CPU."""

    name: ClassVar[str] = "captures"
    only: tuple[str, ...] = ()
    """Commands to run: contacts, color, normals, camera, markers, material; all when left out."""
    out: Path = RESULTS
    """Folder of the result, or a JSON file."""

    def run(self) -> None:
        from taccel_lab.benchmarks.capture_sets import run_capture_sets

        run_capture_sets(self)


@dataclass(frozen=True)
class Quick:
    """Figures that noise cannot move (iterations, launches, forces) against the baseline, CPU."""

    name: ClassVar[str] = "quick"
    update: bool = False
    """Write the baseline anew instead of comparing with it."""

    def run(self) -> None:
        from taccel_lab.benchmarks.quick import run_quick

        if not run_quick(self):
            raise SystemExit(1)


@dataclass(frozen=True)
class Compare:
    """Say what changed from one result to another, beyond their spread."""

    name: ClassVar[str] = "compare"
    first: Path
    """Result of before (JSON)."""
    second: Path
    """Result of after, of the same suite."""

    def run(self) -> None:
        from taccel_lab.benchmarks.compare import run_compare

        run_compare(self)


@dataclass(frozen=True)
class Report:
    """Make docs/benchmarks.md and its pictures from the results."""

    name: ClassVar[str] = "report"
    results: Path = RESULTS
    """Folder of the results."""
    pictures: bool = True
    """Draw the pictures, too."""
    scenes: bool = False
    """Run the scenes and draw them, too (a minute)."""

    def run(self) -> None:
        from taccel_lab.benchmarks.report import run_report

        for path in run_report(self.results, self.pictures, self.scenes):
            print(path)


@dataclass(frozen=True)
class Scenes:
    """List the scenes: bodies, unknowns, steps, where their meshes are from."""

    name: ClassVar[str] = "scenes"
    source: str = "auto"
    """Meshes: published, generated, or auto for the published ones where they are."""

    def run(self) -> None:
        from taccel_lab.benchmarks.scenes import SCENES, SceneOptions, build_scene

        for name in SCENES:
            bench = build_scene(name, SceneOptions(source=self.source))
            print(f"{name:<11} {bench.steps:>4} steps, {bench.source:<9}  {bench.what}")


SUITES: tuple[type, ...] = (
    Speed,
    Error,
    Scaling,
    Skips,
    Stress,
    Peers,
    Study,
    Captures,
    Quick,
)
"""Suites in the order of their help."""
COMMANDS: tuple[type, ...] = (Compare, Report, Scenes)
"""Commands about results and scenes."""
