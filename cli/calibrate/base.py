# SPDX-License-Identifier: Apache-2.0
"""What the calibration commands share: from what was fitted to profile and report."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tyro.conf import Positional

from taccel_lab.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.calibration.report import Page
    from taccel_lab.calibration.result import CalibrationResult
    from taccel_lab.profile import SensorProfile
    from taccel_lab.progress import Progress


def report_folder(out: Path, report: Path | None) -> Path:
    """Where the report goes: the folder asked for, or ``<out>_report`` beside the profile."""
    if report is not None:
        return report
    if out.name in ("", ".."):  # These have no name of their own.
        out = Path(os.path.abspath(out))
    if not out.name:
        raise InputError(f"{out} cannot be a profile folder; name a new or empty folder")
    return out.with_name(out.name + "_report")


def require_outputs(out: Path, report: Path) -> None:
    """Refuse unusable output folders before any long work."""
    from taccel_lab.output_folder import require_growable, require_replaceable
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


def _nothing() -> None: ...


@dataclass(frozen=True)
class CalibrationFiles:
    """What every calibration of captures reads and writes."""

    captures: Positional[Path]
    """Capture folder with captures.toml (docs/captures.md)."""
    out: Path
    """Profile folder to write."""
    base: Path | None = None
    """Profile to extend; when left out, the one that the captures name as their sensor, or the
    catalogue's design of it."""
    report: Path | None = None
    """Folder for the report (HTML, pictures, JSON); <out>_report when left out."""
    json: bool = False
    """Print the figures as JSON instead of a summary."""


@dataclass(frozen=True)
class Fitted:
    """What a command found."""

    name: str
    """Of the block."""
    profile: SensorProfile
    """Extended by the block."""
    result: CalibrationResult
    page: Page
    files: Mapping[Path, Callable[[Path], None]] = field(default_factory=dict)
    """Further files that were asked for, with what writes them."""
    forget: Callable[[], None] = _nothing
    """Takes away what was kept for an interrupt; called when all is written."""


class ProfileCommand:
    """A command that writes a profile with one more block, and a report of it. The fields are
    declared again by the sub-classes, in the order of their help."""

    out: Path
    """Profile folder to write."""
    report: Path | None
    """Folder for the report; <out>_report when left out."""
    json: bool
    """Whether the figures are printed as JSON."""

    def check(self) -> None:
        """Refuse options that cannot be used before anything is read."""

    def read(self) -> Any:
        """What the fit starts from."""
        raise NotImplementedError

    def fit(self, given: Any, progress: Progress, console: Console) -> Fitted:
        """Calibrate with what was read."""
        raise NotImplementedError

    def run(self) -> None:
        """Refuse unusable outputs, fit, and write profile, report and figures."""
        from taccel_lab.cli.console import notes
        from taccel_lab.cli.progress import stage_progress
        from taccel_lab.warp_output import quiet_warp

        quiet_warp()
        self.check()
        report = report_folder(self.out, self.report)
        require_outputs(self.out, report)
        console = notes()
        given = self.read()
        with stage_progress(console) as progress:
            fitted = self.fit(given, progress, console)
        self._write(fitted, report, console)
        fitted.forget()

    def _write(self, fitted: Fitted, report: Path, console: Console) -> None:
        """Save the profile and the report, say the verdict with its remarks, and give the figures:
        on standard output, as JSON or for people."""
        from taccel_lab.calibration.report import write_page
        from taccel_lab.calibration.result import judge
        from taccel_lab.cli.console import print_json, results
        from taccel_lab.profile import save_profile

        result = fitted.result
        save_profile(fitted.profile, self.out)
        write_page(fitted.page, report)
        for path, write in fitted.files.items():
            write(path)
        for remark in result.remarks:
            console.print(str(remark))
        console.print(f"verdict: {judge(result.remarks)}")
        wrote = " and ".join(
            str(path) for path in (self.out, report / "report.html", *fitted.files)
        )
        console.print(f"wrote {wrote}")
        if self.json:
            print_json({"profile": str(self.out), fitted.name: result.figures()})
        else:
            _show(fitted.page, results())


def _show(page: Page, console: Console) -> None:
    """The paragraph of a page and its first table."""
    from rich.table import Table

    from taccel_lab.report.build import format_number

    console.print(page.summary)
    for table in (table.shown() for table in page.tables[:1]):
        drawn = Table(*table.columns, title=table.title, title_justify="left")
        for row in table.rows:
            drawn.add_row(*map(format_number, row))
        console.print(drawn)
