# SPDX-License-Identifier: Apache-2.0
"""The page ``docs/evidence/benchmarks.md``, its pictures and tables of other pages.

Each page has text of its own; what stands between ``<!-- begin NAME -->`` and ``<!-- end NAME -->``
is replaced. Only files that follow the schema of ``taccel_lab.benchmarks.results`` are read.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from taccel_lab.benchmarks.results import SCHEMA
from taccel_lab.benchmarks.runner import Runner
from taccel_lab.benchmarks.scenes import build_scene
from taccel_lab.files.atomic_file import atomic_file, write_by
from taccel_lab.report.markdown import with_parts
from taccel_lab.studies.report.figures import plain_log_ticks
from taccel_lab.tasks.scene_picture import draw_bodies
from tools.bench.report.sections import (
    HEADLINE,
    SECTIONS,
    VERIFICATION,
    Results,
    Section,
    has_speeds,
    read_peers,
    scene_of,
)

_ROOT = Path(__file__).resolve().parents[3]
PAGE, README = _ROOT / "docs" / "evidence" / "benchmarks.md", _ROOT / "README.md"
FOLDER = _ROOT / "benchmarks" / "results"
PAGES: dict[Path, dict[str, Section]] = {
    PAGE: SECTIONS,
    README: HEADLINE,
    PAGE.with_name("verification.md"): VERIFICATION,
}
"""Generated parts of each page."""
IMAGES = _ROOT / "docs" / "images" / "benchmarks"


def read_results(folder: Path = FOLDER) -> Results:
    """Result documents by suite; each knows its file's name as ``file``."""
    found: Results = {}
    for path in sorted(folder.glob("*.json")):
        document = json.loads(path.read_text(encoding="utf-8"))
        if isinstance(document, dict) and document.get("schema") == SCHEMA:
            found.setdefault(document["suite"], []).append(document | {"file": path.name})
    return found


def render(text: str, sections: dict[str, Section], results: Results) -> str:
    """A page with its generated parts made anew."""
    return with_parts(text, {name: section(results) for name, section in sections.items()})


@dataclass(frozen=True)
class Report:
    """Make docs/evidence/benchmarks.md, its pictures and other pages' tables from the results."""

    results: Path = FOLDER
    """Folder of the results."""
    scenes: bool = False
    """Run the scenes and draw them, too (a minute)."""

    def run(self) -> None:
        results = read_results(self.results)
        written = []
        for page, sections in PAGES.items():
            text = render(page.read_text(encoding="utf-8"), sections, results)
            with atomic_file(page) as target:
                target.write_text(text, encoding="utf-8")
            written.append(page)
        written += draw_all(results, IMAGES)
        if self.scenes:
            written.append(draw_scenes(IMAGES / "scenes.png"))
        for path in written:
            print(path)


def draw_all(results: Results, folder: Path) -> list[Path]:
    """Every picture that there is a result for."""
    written = []
    if has_speeds(results):
        written.append(save(draw_speed(results), folder / "speed.png"))
    for document in results.get("stress", []):
        name = f"stress_{Path(document['file']).stem}.png"
        written.append(save(draw_stress(document), folder / name))
    return written


def save(figure: Figure, path: Path) -> Path:
    """Write a picture, whole or not at all."""
    write_by(path, lambda file: figure.savefig(file, dpi=110))
    plt.close(figure)
    return path


def draw_speed(results: Results) -> Figure:
    """FPS by environments; the field's figures on the peg scene as dashed lines."""
    figure, axis = plt.subplots(figsize=(8.5, 6), layout="constrained")
    for document in results.get("speed", []):
        device = document["run"]["device"].replace("NVIDIA ", "")
        for scene in dict.fromkeys(map(scene_of, document["rows"])):
            rows = [row for row in document["rows"] if scene_of(row) == scene]
            if len(rows) < 2:
                continue
            x = [row["envs"] for row in rows]
            y = np.array([row["fps"]["median"] for row in rows])
            low = y - [row["fps"]["min"] for row in rows]
            high = [row["fps"]["max"] for row in rows] - y
            axis.errorbar(
                x,
                y,
                [low, high],
                marker="o",
                ms=4,
                label=f"{scene}, {device}",
            )
    for entry in read_peers()["peg"]:
        x = [int(count) for count in entry["fps"]]
        label = f"{entry['name']}, {entry['device']} ({entry['stop'].split(';')[0]})"
        axis.plot(x, list(entry["fps"].values()), "--", marker="x", lw=0.9, ms=5, label=label)
    axis.set(xlabel="environments", ylabel="FPS, all environments", xscale="log", yscale="log")
    axis.set_title("Environments x steps / seconds; dashed: peg scene, others")
    plain_log_ticks(axis)
    axis.grid(True, which="major", lw=0.3)
    axis.legend(fontsize=7)
    return figure


def draw_stress(document: dict[str, Any]) -> Figure:
    """Outcomes by family, and Newton iterations of all steps by family."""
    families = document["summary"]["families"]
    names = list(families)[::-1]
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(11, 0.3 * len(names) + 1.6), sharey=True, layout="constrained"
    )
    colours = {
        "converged": "#4c9f70",
        "refused": "#9cc5a1",
        "failed": "#e0a030",
        "budget": "#b0b0b0",
        "silent": "#c0392b",
        "broken": "#6c3483",
    }
    places, start = np.arange(len(names)), np.zeros(len(names))
    for kind, colour in colours.items():
        widths = np.array([families[name][kind] for name in names], dtype=float)
        if widths.any():
            left.barh(places, widths, left=start, color=colour, label=kind)
        start += widths
    left.set_yticks(places, names)
    left.set_xlabel("cases")
    left.set_ylim(-0.6, len(names) - 0.4)
    left.legend(loc="lower left", bbox_to_anchor=(0, 1), ncol=6, frameon=False, fontsize=8)
    for place, name in zip(places, names, strict=True):
        mine = [case for case in document["cases"] if case["family"] == name]
        newton = np.array([n + 1 for case in mine for n in case.get("newton_iterations", [])])
        spread = np.random.default_rng(0).uniform(-0.3, 0.3, len(newton))
        right.plot(newton, place + spread, ".", ms=3, alpha=0.4, color="#34495e")
    right.set_xscale("log")
    right.set_xlabel("Newton iterations of a step + 1")
    for axis in (left, right):
        axis.spines[["top", "right"]].set_visible(False)
    return figure


MOMENTS = {
    "peg": (160, (1.3, -1.0, 0.6)),
    "press_5215": (20, (0.5, -1.0, 0.55)),
    "bolt": (40, (1.0, -1.2, 0.5)),
    "hand": (14, (1.0, 0.9, 0.5)),
    "squeeze": (36, (1.0, -0.55, 0.3)),
}
"""Step, and direction that it is looked at from."""


def draw_scenes(path: Path) -> Path:
    """Run each scene to its moment, render it, and put the pictures side by side."""
    figure, axes = plt.subplots(1, len(MOMENTS), figsize=(15, 3.6), layout="constrained")
    for axis, (name, (step, direction)) in zip(axes, MOMENTS.items(), strict=True):
        runner = Runner(build_scene(name))
        runner.run(step)
        positions = runner.state.positions.numpy()[0]
        axis.imshow(draw_bodies(runner.model, positions, direction))
        axis.set_title(f"{name}, step {step}", fontsize=10)
        axis.axis("off")
    return save(figure, path)
