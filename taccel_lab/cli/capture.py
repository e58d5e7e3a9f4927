# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab capture``: everything before a fit. What to capture, which cameras there are,
captures of other layouts, what a folder holds and lacks, lenses taken out of images."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from taccel_lab.calibration.import_options import ImportOptions
from taccel_lab.errors import InputError

if TYPE_CHECKING:
    from taccel_lab.calibration.capture import CaptureFolder
    from taccel_lab.calibration.capture.printer import PrinterPlan
    from taccel_lab.calibration.check import CaptureCheck


@dataclass(frozen=True)
class CaptureGuide:
    """Print what to capture of a sensor: steps, counts, minutes, equipment, and why.

    Ends with a captures.toml to fill in. Everything takes less than an hour.
    """

    sensor: Positional[str]
    """Sensor of the catalogue (taccel-lab sensors list), or the folder of a profile; flat_pad for
    any other."""
    printer: str | None = None
    """Write the ball presses as G-code as well, for a 3D printer that holds the ball: ender3,
    prusa_mk4, or the build volume, such as 220x220x250. Needs --touch and --out."""
    touch: tuple[float, float, float] | None = None
    """X, Y and Z of the printer when the ball just touches the middle of the gel (M114)."""
    out: Path | None = None
    """Write the captures.toml to this file as well; an existing file is never overwritten. With
    --printer: folder for presses.gcode and printer_presses.csv."""
    json: bool = False
    """Print the plan as JSON."""

    def run(self) -> None:
        from dataclasses import asdict

        from taccel_lab.calibration.capture.guide import capture_plan
        from taccel_lab.calibration.capture.printer import GCODE, PRESSES_TABLE
        from taccel_lab.cli.console import print_json, print_table, results
        from taccel_lab.files.atomic_file import atomic_file
        from taccel_lab.files.output_folder import atomic_directory

        plan = capture_plan(self.sensor)
        printer = self._printer()
        if printer is not None and self.out is not None:
            with atomic_directory(self.out) as folder:
                (folder / GCODE).write_text(printer.gcode(), encoding="utf-8")
                (folder / PRESSES_TABLE).write_text(printer.table(), encoding="utf-8")
        elif self.out is not None:
            if self.out.exists():
                raise InputError(f"{self.out} exists; name a file that does not")
            with atomic_file(self.out) as staging:
                staging.write_text(plan.manifest, encoding="utf-8")
        if self.json:
            values = {**asdict(plan), "minutes": plan.minutes}
            if printer is not None:
                values["printer"] = {**asdict(printer), "minutes": printer.minutes}
            print_json(values)
            return
        console = results()
        console.print(f"{plan.title}\n{plan.minutes} minutes in all\n")
        rows = [
            (
                f"{number} {step.title}" + (" (optional)" if step.optional else ""),
                *(step.block, step.count, str(step.minutes), step.equipment),
            )
            for number, step in enumerate(plan.steps, 1)
        ]
        print_table(("step", "for", "count", "min", "equipment"), rows)
        for number, step in enumerate(plan.steps, 1):
            console.print(f"\n{number} {step.title}", style="bold")
            console.print(step.how)
            console.print(f"Why: {step.why}")
        console.print("\ncaptures.toml to fill in, beside the images:\n")
        console.print(plan.manifest, soft_wrap=True)
        console.print("Then: taccel-lab capture check FOLDER")
        if printer is not None and self.out is not None:
            at = self.out / PRESSES_TABLE
            console.print(
                f"The printer makes {len(printer.presses)} presses in {printer.minutes:.0f} "
                f"minutes; its program says what to do before. Meanwhile:\n"
                f"taccel-lab capture record {self.sensor} --radius-mm {plan.ball_radius_mm:g} "
                f"--scale later --table {at} ...",
                soft_wrap=True,
            )
        if self.out is not None:
            console.print(f"wrote {self.out}")

    def _printer(self) -> PrinterPlan | None:
        from taccel_lab.calibration.capture.printer import parse_printer, printer_plan

        if self.printer is None:
            if self.touch is not None:
                raise InputError("--touch was given without --printer; name the printer as well")
            return None
        bed = parse_printer(self.printer)
        if self.touch is None or self.out is None:
            raise InputError(
                "--printer needs --touch X Y Z and --out, a folder. --touch is what M114 says when "
                "the ball just touches the middle of the gel"
            )
        return printer_plan(self.sensor, bed, self.touch)


@dataclass(frozen=True)
class CaptureDevices:
    """List the cameras that are plugged in, by the id that capture record and live take.

    Ids stay with the camera: maker, model and serial number (GelSight Mini and DIGIT have one).
    """

    json: bool = False
    """Print the list as JSON."""

    def run(self) -> None:
        from taccel_lab.calibration.capture.camera.uvc import list_devices
        from taccel_lab.cli.console import print_json, print_table, results

        devices = list_devices()
        if self.json:
            print_json({"cameras": [asdict(device) for device in devices]})
            return
        if not devices:
            results().print("no camera is plugged in")
            return
        rows = [(one.id, one.name, one.serial or "-", one.node) for one in devices]
        print_table(("--camera", "name", "serial", "node"), rows)


@dataclass(frozen=True)
class CaptureImport(ImportOptions):
    """Write captures of another project's layout, or a plain folder, as a capture folder.

    Image files are copied unchanged. Assumptions are printed, and kept in captures.toml and in
    every profile that is calibrated with it. Skipped files are listed with the reason. A source of
    several sensors or sets becomes one folder for each.
    """

    source: Positional[Path]
    """Folder, dataPack.npz or video to read."""
    out: Positional[Path]
    """Capture folder to write."""
    layout: str = "auto"
    """Layout of the source: auto, taxim, 9dtact, gs-sdk, printer, markers, plain, another
    published set (docs/capture_import.md), or a script, mine.py, which is run."""
    replace: bool = False
    """Put these captures in the place of earlier ones, unless somebody has changed those."""
    json: bool = False
    """Print what was written as JSON."""

    def run(self) -> None:
        from taccel_lab.calibration.capture.folder import contents_in_words
        from taccel_lab.calibration.capture.importers import (
            AUTO,
            detect_layout,
            import_folders,
        )
        from taccel_lab.cli.console import notes, print_json, results, working
        from taccel_lab.files.output_folder import require_replaceable
        from taccel_lab.sensors import sensor_family

        if self.sensor is not None:
            sensor_family(self.sensor)
        require_replaceable(self.out, captures=self.replace)
        layout = self.layout if self.layout != AUTO else detect_layout(self.source).name
        console = notes() if self.json else results()
        with working(console, f"importing {self.source} as {layout}"):
            folders = import_folders(self.source, self.out, layout, self, replace=self.replace)
        found = []
        for folder in folders:
            origin = {key: folder.provenance[key] for key in ("source", "license")}
            found.append(
                {
                    "path": str(folder.path),
                    "contents": folder.contents,
                    "assumed": folder.assumed,
                    "notes": list(folder.notes),
                    **origin,
                }
            )
            contents = contents_in_words(folder.contents) or "nothing that calibrates"
            console.print(f"wrote {folder.path}: {contents}")
            said = [
                *(f"{key}: {text}" for key, text in origin.items()),
                *(f"assumed {name}: {text}" for name, text in folder.assumed.items()),
                *folder.notes,
            ]
            for text in said:
                console.print(f"  {text}")
        for folder in folders:
            console.print(
                f"next: taccel-lab capture check {shlex.quote(str(folder.path))}",
            )
        if self.json:
            print_json({"layout": layout, "folders": found})


@dataclass(frozen=True)
class CaptureCheckCommand:
    """Report what a capture folder holds, what is missing for which command, and what is weak.

    Checks the light (white balance, saturation, channel order), the contacts (found, coverage,
    blur, duplicates, labels against the images), the background (framing), the ball and the scale,
    boards, markers and force records. Exit code 0: usable; 1: something stops a calibration or
    makes it wrong; 2: the folder cannot be read.
    """

    captures: Positional[Path]
    """Capture folder with captures.toml, or captures in any layout that capture import reads."""
    report: Path | None = None
    """Folder for report.html with a picture of each press, worst first, and contacts.toml with the
    circles found, to copy into the capture folder and edit; taccel-lab capture label does that by
    clicks. Default: none."""
    json: bool = False
    """Print everything found as JSON."""

    def run(self) -> None:
        from taccel_lab.calibration.check import check_captures, check_page
        from taccel_lab.cli.console import notes, print_json
        from taccel_lab.files.output_folder import atomic_directory, require_replaceable
        from taccel_lab.progress import stage_progress
        from taccel_lab.report.page import write_page, write_page_into

        console = notes()
        if self.report is not None:
            require_replaceable(self.report)
        checks, pages = [], []
        with (
            _opened(self.captures) as parts,
            nullcontext() if self.report is None else atomic_directory(self.report) as staging,
        ):
            for name, folder, said in parts:
                with stage_progress(console) as progress:
                    check = check_captures(folder, notes=said, progress=progress)
                checks.append(check)
                if not self.json:
                    _print_check(check)
                if self.report is None or staging is None:
                    continue
                if len(parts) == 1:
                    write_page_into(check_page(check), staging)
                    pages.append(self.report / "report.html")
                else:
                    write_page(check_page(check), staging / name)
                    pages.append(self.report / name / "report.html")
        for page in pages:
            console.print(f"wrote {page}")
        if self.json:
            figures = [check.figures() for check in checks]
            print_json(figures[0] if len(figures) == 1 else {"parts": figures})
        if not all(check.usable for check in checks):
            sys.exit(1)


@contextmanager
def _opened(path: Path) -> Iterator[list[tuple[str, CaptureFolder, tuple[str, ...]]]]:
    """The folders to check by their names, with what an importer assumed where there is no
    manifest: there the folder is a passing one, and its name is of what was read."""
    from contextlib import ExitStack

    from taccel_lab.calibration.capture import load_capture_folder
    from taccel_lab.calibration.capture.importers import read_drafts
    from taccel_lab.calibration.capture.schema import MANIFEST_NAME
    from taccel_lab.files.inner_path import inner_path

    if not path.exists() or path.name == MANIFEST_NAME or (path / MANIFEST_NAME).is_file():
        yield [(path.name, load_capture_folder(path), ())]
        return
    found = sorted(place.relative_to(path).as_posix() for place in path.glob(f"*/{MANIFEST_NAME}"))
    below = [inner_path(path, name).parent for name in found]
    if below:
        yield [(place.name, load_capture_folder(place), ()) for place in below]
        return
    with ExitStack() as stack:
        layout, drafts = read_drafts(path)
        parts = []
        for draft in drafts:
            notes = (f"read as {layout.name}: {layout.title}", *draft.remarks())
            parts.append((draft.part, stack.enter_context(draft.opened()), notes))
        yield parts


def _print_check(check: CaptureCheck) -> None:
    from rich.text import Text

    from taccel_lab.cli.console import print_table, results

    console = results()
    console.print(f"{check.folder.source} ({check.folder.sensor})")
    for note in check.notes:
        console.print(f"note: {note}")
    colors = {"ready": "green", "weak": "yellow", "blocked": "red"}
    absent = [block for block in check.blocks if block.readiness == "absent"]
    rows = [
        (
            f"calibrate {block.command}",
            Text(block.readiness, style=colors[block.readiness]),
            *(block.found, block.missing),
        )
        for block in check.blocks
        if block not in absent
    ]
    if rows:
        print_table(("command", "state", "found", "missing"), rows)
    for block in absent:
        console.print(f"calibrate {block.command} needs {block.missing}")
    for finding in check.findings:
        console.print(str(finding))
    if not check.findings:
        console.print("no findings")


@dataclass(frozen=True)
class CaptureRectify:
    """Rectify every image of a capture folder, so that one scale holds everywhere.

    The maps come from a board on the gel (taccel-lab calibrate camera --maps). Contact circles are
    left out, since they are positions in the raw images; they are found again.
    """

    captures: Positional[Path]
    """Capture folder with captures.toml."""
    maps: Positional[Path]
    """Rectification maps (.npz) of `taccel-lab calibrate camera --maps`."""
    out: Positional[Path]
    """Capture folder to write."""
    replace: bool = False
    """Put these captures in the place of earlier ones, unless somebody has changed those."""
    json: bool = False
    """Print size, scale and notes as JSON."""

    def run(self) -> None:
        from taccel_lab.calibration.camera.rectification import RectificationMaps, rectify_captures
        from taccel_lab.calibration.capture import load_capture_folder
        from taccel_lab.cli.console import notes, print_json, working
        from taccel_lab.files.output_folder import require_replaceable

        require_replaceable(self.out, captures=self.replace)
        console = notes()
        folder, maps = load_capture_folder(self.captures), RectificationMaps.load(self.maps)
        with working(console, "rectifying the images"):
            remarks = rectify_captures(folder, maps, self.out, replace=self.replace)
        for remark in remarks:
            console.print(f"note: {remark}")
        grid = maps.require_grid()
        console.print(
            f"wrote {self.out}: {grid.width_px}x{grid.height_px} px at {grid.mm_per_px_x:.5g} x "
            f"{grid.mm_per_px_y:.5g} mm/px",
        )
        if self.json:
            print_json({"folder": str(self.out), **asdict(grid), "notes": remarks})
