# SPDX-License-Identifier: Apache-2.0
"""What the calibration commands share: their files, and the way from captures to a profile."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from taccel_lab.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.calibration.capture.folder import CaptureFolder
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


@dataclass(frozen=True)
class Fitted:
    """What a command found, and how it is shown."""

    name: str
    """Of the block."""
    base: SensorProfile
    """Profile that was extended."""
    result: CalibrationResult
    page: Page
    summarise: Callable[[Console], None] | None = None
    """Prints the figures for people; None where the report says all."""
    files: Mapping[Path, Callable[[Path], None]] = field(default_factory=dict)
    """Further files that were asked for, with what writes them."""


@dataclass(frozen=True)
class CalibrationFiles:
    """What every calibration reads and writes."""

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
class BlockCommand(CalibrationFiles):
    """Captures and a profile to extend in, the extended profile and a report out."""

    def check(self) -> None:
        """Refuse options that cannot be used before anything is read."""

    def profile_to_extend(self, folder: CaptureFolder) -> SensorProfile:
        """The base profile, or the catalogue's design of the captures' sensor."""
        from taccel_lab.calibration.base_profile import base_profile

        return base_profile(self.base, folder)

    def fit(self, folder: CaptureFolder, progress: Progress) -> Fitted:
        """Calibrate the block."""
        raise NotImplementedError

    def run(self) -> None:
        """Refuse unusable outputs, fit, and write profile, report and figures."""

        from taccel_lab.calibration.capture.load import load_capture_folder
        from taccel_lab.calibration.recorded import with_session
        from taccel_lab.cli.console import notes
        from taccel_lab.cli.progress import stage_progress
        from taccel_lab.warp_output import quiet_warp

        quiet_warp()
        self.check()
        report = report_folder(self.out, self.report)
        require_outputs(self.out, report)
        console = notes()
        folder = load_capture_folder(self.captures)
        with stage_progress(console) as progress:
            fitted = self.fit(folder, progress)
        before = None if self.base is None else self.profile_to_extend(folder)
        profile = with_session(before, fitted.result.apply_to(fitted.base), folder)
        write_results(fitted, profile, self.out, report, console, json=self.json)


def write_results(
    fitted: Fitted,
    profile: SensorProfile,
    out: Path,
    report: Path,
    console: Console,
    *,
    json: bool,
) -> None:
    """Save the extended profile and the report, say the verdict with its remarks, and give the
    figures: on standard output, as JSON or for people."""
    from taccel_lab.calibration.report import write_page
    from taccel_lab.calibration.result import judge
    from taccel_lab.cli.console import print_json, results
    from taccel_lab.profile import save_profile

    result = fitted.result
    save_profile(profile, out)
    write_page(fitted.page, report)
    for path, write in fitted.files.items():
        write(path)
    for remark in result.remarks:
        console.print(str(remark))
    console.print(f"verdict: {judge(result.remarks)}")
    wrote = " and ".join(str(path) for path in (out, report / "report.html", *fitted.files))
    console.print(f"wrote {wrote}")
    if json:
        print_json({"profile": str(out), fitted.name: result.figures()})
    elif fitted.summarise is not None:
        fitted.summarise(results())
