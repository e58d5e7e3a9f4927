# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab capture check``: what a capture folder holds and lacks, and where it is weak."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.calibration.capture import CaptureFolder
    from taccel_lab.calibration.check import CaptureCheck


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
    circles found. Correct that file where it is wrong and copy it into the capture folder; all
    commands then use your circles. Default: none."""
    json: bool = False
    """Print everything found as JSON."""

    def run(self) -> None:
        from taccel_lab.calibration.check import check_captures, check_page
        from taccel_lab.cli.console import notes, print_json, results
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
                    _print_check(results(), check)
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


def _print_check(console: Console, check: CaptureCheck) -> None:
    from rich.table import Table
    from rich.text import Text

    console.print(f"{check.folder.source} ({check.folder.sensor})")
    for note in check.notes:
        console.print(f"note: {note}")
    table = Table("command", "state", "found", "missing")
    colors = {"ready": "green", "weak": "yellow", "blocked": "red"}
    absent = [block for block in check.blocks if block.readiness == "absent"]
    for block in check.blocks:
        if block in absent:
            continue
        table.add_row(
            f"calibrate {block.command}",
            Text(block.readiness, style=colors[block.readiness]),
            block.found,
            block.missing,
        )
    if len(absent) < len(check.blocks):
        console.print(table)
    for block in absent:
        console.print(f"calibrate {block.command} needs {block.missing}")
    for finding in check.findings:
        console.print(str(finding))
    if not check.findings:
        console.print("no findings")
