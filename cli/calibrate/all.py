# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate all``: every block that a capture folder has captures for, in order.

Each stage is the command of its block, run on the profile that the stage before it wrote. A stage
without captures is skipped, a stage that refuses its captures is told and passed over; the profile
then keeps what the catalogue or the base says of that block.
"""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tyro.conf import Positional

from taccel_lab.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.calibration.capture import CaptureFolder
    from taccel_lab.calibration.check.run import CaptureCheck
    from taccel_lab.cli.app import Command


UNFIT = ("blocked", "refused")
"""States of a stage whose captures are there and cannot be used."""


@dataclass(frozen=True)
class Stage:
    """One block's calibration: a command that takes captures, out, base and report."""

    name: str
    command: Callable[..., Command]


@dataclass(frozen=True)
class StageOutcome:
    """How a stage ended."""

    name: str
    state: str
    """``done``; ``skipped`` for want of captures, ``blocked`` by the check of the captures, or
    ``refused`` by the calibration."""
    message: str
    seconds: float


@dataclass(frozen=True)
class CalibrateAll:
    """Fit every block that the captures allow and write one profile and one report.

    The captures are checked first (taccel-lab capture check). Then camera, scale, background,
    colour, normals, depth, markers, material and spread, in this order; blocks without captures are
    skipped and named, with what would have to be captured. After a board on the gel the images are
    rectified, as the profile's camera sees them; the maps lie in the report. Exits with 1 when the
    captures of a block were unfit.
    """

    captures: Positional[Path]
    """Capture folder with captures.toml (docs/captures.md)."""
    out: Path
    """Profile folder to write."""
    base: Path | None = None
    """Profile of the designed sensor to extend; the catalogue's design when left out."""
    report: Path | None = None
    """Folder for the reports, one a stage and an index; <out>_report when left out."""
    only: tuple[str, ...] = ()
    """Stages to run, by name; all when left out."""
    json: bool = False
    """Print the outcome of each stage as JSON."""

    def run(self) -> None:
        import warp as wp
        from rich.console import Console

        from taccel_lab.calibration.base_profile import base_profile
        from taccel_lab.calibration.capture import load_capture_folder
        from taccel_lab.calibration.check.block_findings import capture_check, shared_checks
        from taccel_lab.cli.calibrate.base import report_folder, require_outputs
        from taccel_lab.cli.console import print_json
        from taccel_lab.cli.progress import stage_progress
        from taccel_lab.output import atomic_directory
        from taccel_lab.profile import load_profile, save_profile

        wp.config.log_level = wp.LOG_ERROR
        console = Console(stderr=True)
        stages = [s for s in all_stages() if not self.only or s.name in self.only]
        known = [s.name for s in all_stages()]
        unknown = [name for name in self.only if name not in known]
        if unknown:
            raise InputError(f"no stage {', '.join(unknown)}; there are {', '.join(known)}")
        report = report_folder(self.out, self.report)
        require_outputs(self.out, report)
        folder = load_capture_folder(self.captures)
        profile = base_profile(self.base, folder)
        outcomes: list[StageOutcome] = []
        captures = self.captures
        with tempfile.TemporaryDirectory(prefix="taccel_lab_") as scratch, shared_checks():
            with stage_progress(console) as progress:
                checked = capture_check(folder, progress)
            states = stage_states(checked)
            work = Path(scratch)
            current = work / "base"
            save_profile(profile, current)
            for stage in stages:
                state, reason = states[stage.name]
                if stage.name == "scale" and captures != self.captures:
                    state, reason = "skipped", "the board on the gel gave the scale"
                if state != "run":
                    outcomes.append(StageOutcome(stage.name, state, reason, 0.0))
                    continue
                on_gel = any(board.entry.on_gel for board in folder.boards)
                maps = work / "maps.npz" if stage.name == "camera" and on_gel else None
                outcome = _run_stage(stage, captures, current, work, console, maps)
                outcomes.append(outcome)
                if outcome.state == "done":
                    current = work / stage.name
                    if maps is not None and folder.background is not None:
                        captures = work / "captures"
                        _rectify(folder, maps, captures, console)
            if not any(outcome.state == "done" for outcome in outcomes):
                lines = "\n".join(f"  {o.name}: {o.message}" for o in outcomes)
                raise InputError(f"{folder.source}: nothing could be calibrated\n{lines}")
            profile = load_profile(current)
            with atomic_directory(report) as staging:
                if (work / "maps.npz").is_file():
                    shutil.copyfile(work / "maps.npz", staging / "maps.npz")
                for outcome in outcomes:
                    page = work / f"{outcome.name}_report"
                    if page.is_dir():
                        shutil.copytree(page, staging / outcome.name)
                _write_index(profile, outcomes, staging)
            save_profile(profile, self.out)
        if self.json:
            print_json({"profile": str(self.out), "stages": [vars(o) for o in outcomes]})
        else:
            _print_outcomes(Console(), outcomes)
        console.print(f"wrote {self.out} and {report / 'report.html'}", highlight=False)
        if any(outcome.state in UNFIT for outcome in outcomes):
            raise SystemExit(1)


def all_stages() -> list[Stage]:
    """The stages in the order in which one builds on another."""
    from taccel_lab.cli.calibrate.background import CalibrateBackground
    from taccel_lab.cli.calibrate.camera import CalibrateCamera
    from taccel_lab.cli.calibrate.color import CalibrateColor
    from taccel_lab.cli.calibrate.depth import CalibrateDepth
    from taccel_lab.cli.calibrate.markers import CalibrateMarkers
    from taccel_lab.cli.calibrate.material import CalibrateMaterial
    from taccel_lab.cli.calibrate.normals import CalibrateNormals
    from taccel_lab.cli.calibrate.scale import CalibrateScale
    from taccel_lab.cli.calibrate.spread import CalibrateSpread

    return [
        Stage("camera", CalibrateCamera),
        Stage("scale", CalibrateScale),
        Stage("background", CalibrateBackground),
        Stage("color", CalibrateColor),
        Stage("normals", CalibrateNormals),
        Stage("depth", CalibrateDepth),
        Stage("markers", CalibrateMarkers),
        Stage("material", CalibrateMaterial),
        Stage("spread", CalibrateSpread),
    ]


def stage_states(check: CaptureCheck) -> dict[str, tuple[str, str]]:
    """What the check lets every stage do: ``run``, ``skipped`` or ``blocked``, and why."""
    from taccel_lab.calibration.check.content import Readiness

    states = {}
    for block in check.blocks:
        if block.readiness is Readiness.ABSENT:
            states[block.command] = ("skipped", f"needs {block.missing}")
        elif block.readiness is Readiness.BLOCKED:
            causes = [f.message for f in check.findings if block.command in f.blocks]
            states[block.command] = ("blocked", "; ".join([block.missing, *causes]).strip("; "))
        else:
            states[block.command] = ("run", block.found)
    folder = check.folder
    several = len(folder.untouched) > 1 or len(folder.presses) > 1
    states["spread"] = (
        ("run", "") if several and folder.background else ("skipped", "needs several frames")
    )
    return states


def _rectify(folder: CaptureFolder, maps: Path, out: Path, console: Console) -> None:
    """The stages after a board on the gel see the images that the profile's camera describes."""
    from taccel_lab.calibration.camera.rectification import RectificationMaps
    from taccel_lab.calibration.camera.rectify_captures import rectify_captures

    with console.status("rectifying the images"):
        notes = rectify_captures(folder, RectificationMaps.load(maps), out)
    for note in notes:
        console.print(f"note: {note}", highlight=False)


def _run_stage(
    stage: Stage, captures: Path, current: Path, work: Path, console: Console, maps: Path | None
) -> StageOutcome:
    from taccel_lab.cli.calibrate.base import stage_of_all

    console.rule(stage.name, align="left")
    started = time.perf_counter()
    report = work / f"{stage.name}_report"
    try:
        out = work / stage.name
        with stage_of_all():
            options = {} if maps is None else {"maps": maps}
            stage.command(captures=captures, out=out, base=current, report=report, **options).run()
    except InputError as error:
        console.print(f"refused: {error}", highlight=False)
        return StageOutcome(stage.name, "refused", str(error), time.perf_counter() - started)
    verdict = _verdict(report)
    return StageOutcome(stage.name, "done", verdict, time.perf_counter() - started)


def _verdict(report: Path) -> str:
    import json

    path = report / "report.json"
    if not path.is_file():
        return ""
    return str(json.loads(path.read_text(encoding="utf-8")).get("verdict", ""))


def _write_index(profile: Any, outcomes: list[StageOutcome], staging: Path) -> None:
    """``report.html`` of the whole: the stages, then the profile's own page."""
    from dataclasses import replace

    from taccel_lab.calibration.report import Table, write_page
    from taccel_lab.calibration.report.profile_page import profile_page
    from taccel_lab.calibration.result import Remark, Severity

    page = profile_page(profile)
    refused = [
        Remark(Severity.ERROR, "stage_refused", f"{o.name} {o.state}: {o.message}")
        for o in outcomes
        if o.state in UNFIT
    ]
    rows = [(o.name, o.state, o.message, o.seconds or None) for o in outcomes]
    stages = Table(
        "Stages",
        ("stage", "state", "verdict or reason", "seconds"),
        rows,
        caption="The report of each stage lies in the folder of its name beside this page.",
    )
    page = replace(
        page,
        remarks=(*refused, *page.remarks),
        tables=(stages, *page.tables),
        figures={**page.figures, "stages": [vars(o) for o in outcomes]},
    )
    inner = staging / "index"
    write_page(page, inner)
    for path in inner.iterdir():
        if path.name.startswith("."):
            path.unlink()
        else:
            shutil.move(path, staging / path.name)
    inner.rmdir()


def _print_outcomes(console: Console, outcomes: list[StageOutcome]) -> None:
    from rich.table import Table

    table = Table("stage", "state", "verdict or reason", "seconds")
    for outcome in outcomes:
        table.add_row(outcome.name, outcome.state, outcome.message, f"{outcome.seconds:.0f}")
    console.print(table)
