# SPDX-License-Identifier: Apache-2.0
"""What the calibration commands share: their files, and the way from captures to a profile."""

from __future__ import annotations

import os
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from tyro.conf import Positional

from taccel_lab.calibration.block import Block, BlockWords, Files
from taccel_lab.errors import InputError

if TYPE_CHECKING:
    from taccel_lab.calibration.result import BlockResult
    from taccel_lab.profile import SensorProfile
    from taccel_lab.report.page import Page

_MOST_ROWS = 24
"""Most rows of a table that are printed."""


def report_folder(out: Path, report: Path | None) -> Path:
    """Where the report goes: the folder asked for, or ``<out>_report`` beside the profile."""
    if report is not None:
        return report
    if out.name in ("", ".."):  # These have no name.
        out = Path(os.path.abspath(out))
    if not out.name:
        raise InputError(f"{out} cannot be a profile folder; name a new or empty folder")
    return out.with_name(out.name + "_report")


def require_outputs(out: Path, report: Path) -> None:
    """Refuse unusable output folders before any long work."""
    from taccel_lab.files.output_folder import require_growable, require_replaceable
    from taccel_lab.profile import require_profile_folder

    inner, outer = Path(os.path.abspath(report)), Path(os.path.abspath(out))
    if inner == outer or outer in inner.parents:
        raise InputError(
            f"the report {report} would be inside the profile folder {out}, which may hold nothing "
            "else; name another folder with --report"
        )
    require_profile_folder(out)
    require_growable(out)
    require_replaceable(report)


@dataclass(frozen=True)
class CalibrationFiles:
    """What every calibration reads and writes."""

    captures: Positional[Path]
    """Capture folder with captures.toml (docs/captures.md), or a Taxim dataPack.npz."""
    out: Path
    """Profile folder to write."""
    base: Path | None = None
    """Profile folder to extend, or a sensor of the catalogue. Default: the sensor that the
    captures name."""
    report: Path | None = None
    """Folder for the report (HTML, pictures, JSON). Default: <out>_report."""
    json: bool = False
    """Print the figures as JSON instead of a summary."""


@dataclass(frozen=True)
class BlockCommand(CalibrationFiles, BlockWords):
    """Run one block: captures and a profile in, the extended profile and a report out."""

    block: ClassVar[Block]

    def run(self) -> None:
        """Refuse unusable outputs, fit, and write profile, report and figures."""
        from taccel_lab.calibration.base_profile import base_profile, with_session
        from taccel_lab.calibration.capture.load import load_capture_folder
        from taccel_lab.cli.console import notes
        from taccel_lab.progress import stage_progress

        self.check()
        report = report_folder(self.out, self.report)
        require_outputs(self.out, report)
        block = self.block
        folder = load_capture_folder(self.captures)
        with stage_progress(notes()) as progress:
            base = base_profile(self.base, folder)
            before = None if self.base is None else base
            options = None if block.options is None else self.options(before)
            result = block.fit(folder, base, options, progress)
            page = block.page(result, folder)
        profile = with_session(before, result.apply_to(base), folder)
        saved = profile, self.out
        write_results(block.name, result, page, saved, report, self.json, self.files(result))


def write_results(
    name: str,
    result: BlockResult,
    page: Page,
    saved: tuple[SensorProfile, Path],
    report: Path,
    as_json: bool,
    files: Files | None = None,
) -> None:
    """Save the extended profile and the report of a block, say the verdict with its remarks, and
    give the figures on standard output: as JSON, or the page's summary and first table.

    ``saved``: the profile, and its folder; ``files``: further ones, with what writes them.
    """
    from taccel_lab.cli.console import notes, print_json
    from taccel_lab.files.atomic_file import atomic_file
    from taccel_lab.profile.io import profile_saved
    from taccel_lab.report.page import write_page
    from taccel_lab.report.remark import judge

    profile, out = saved
    files, console = files or {}, notes()
    # All of it is on disk before anything of it takes the place of an earlier one.
    with ExitStack() as stack:
        stack.enter_context(profile_saved(profile, out))
        beside = {path: write for path, write in files.items() if report not in path.parents}
        for path, write in beside.items():
            write(stack.enter_context(atomic_file(path)))
        write_page(page, report)
        for path in files.keys() - beside.keys():
            files[path](path)
    for remark in result.remarks:
        console.print(str(remark))
    console.print(f"verdict: {judge(result.remarks)}")
    wrote = " and ".join(str(path) for path in (out, report / "report.html", *files))
    console.print(f"wrote {wrote}")
    if as_json:
        print_json({"profile": str(out), name: result.figures()})
    else:
        _print_page(page)


def _print_page(page: Page) -> None:
    from taccel_lab.cli.console import print_table, results
    from taccel_lab.report.page import format_number

    results().print(page.summary)
    if not page.tables or page.tables[0].folded:
        return
    table = page.tables[0].shown()
    rows = [[format_number(value) for value in row] for row in table.rows[:_MOST_ROWS]]
    print_table(table.columns, rows, table.title)
    if len(table.rows) > _MOST_ROWS:
        results().print(f"{len(table.rows) - _MOST_ROWS} more rows stand in the report")
