# SPDX-License-Identifier: Apache-2.0
"""What the calibration commands share: captures and profile to start from, where results go."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from taccel_lab.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.calibration.capture.folder import CaptureFolder
    from taccel_lab.calibration.report import Page
    from taccel_lab.calibration.result import CalibrationResult
    from taccel_lab.profile import SensorProfile


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
    from taccel_lab.output_folder import require_replaceable
    from taccel_lab.profile import require_profile_folder

    inner, outer = Path(os.path.abspath(report)), Path(os.path.abspath(out))
    if inner == outer or outer in inner.parents:
        raise InputError(
            f"the report {report} would be inside the profile folder {out}, which may hold nothing "
            "else; name another folder with --report"
        )
    require_profile_folder(out)
    require_replaceable(report)


@dataclass(frozen=True)
class Job:
    """What one calibration command starts from, and where its results go."""

    folder: CaptureFolder
    base: SensorProfile
    out: Path
    report: Path
    console: Console
    """For people; standard output is for figures."""

    def write(self, result: CalibrationResult, page: Page) -> None:
        """Save the extended profile and the report."""
        write_results(result, page, self.base, self.out, self.report, self.console)


def open_job(captures: Path, out: Path, base: Path | None, report: Path | None) -> Job:
    """Refuse unusable outputs, then load the captures and the profile to extend."""
    from rich.console import Console

    from taccel_lab.calibration.base_profile import base_profile
    from taccel_lab.calibration.capture.load import load_capture_folder

    report = report_folder(out, report)
    require_outputs(out, report)
    folder = load_capture_folder(captures)
    return Job(folder, base_profile(base, folder), out, report, Console(stderr=True))


def write_results(
    result: CalibrationResult,
    page: Page,
    base: SensorProfile,
    out: Path,
    report: Path,
    console: Console,
) -> None:
    """Save the extended profile and the report, and say the verdict with its remarks."""
    from taccel_lab.calibration.report import write_page
    from taccel_lab.calibration.result import judge
    from taccel_lab.profile import save_profile

    save_profile(result.apply_to(base), out)
    write_page(page, report)
    for remark in result.remarks:
        console.print(str(remark), highlight=False)
    console.print(f"verdict: {judge(result.remarks)}", highlight=False)
    console.print(f"wrote {out} and {report / 'report.html'}", highlight=False)
