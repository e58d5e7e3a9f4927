# SPDX-License-Identifier: Apache-2.0
"""What the calibration commands share: the profile to start from, and where results go."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING

from taccel_lab.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from calibration.report import Page
    from calibration.result import CalibrationResult
    from taccel_lab.profile import SensorProfile


def base_profile(base: Path | None, sensor: str) -> SensorProfile:
    """The profile in the folder ``base``, or the catalogue's design of ``sensor``."""
    from sensors.profile import catalogue_profile
    from taccel_lab.profile import load_profile

    if base is None:
        return catalogue_profile(sensor)
    profile = load_profile(base)
    if profile.sensor.family != sensor:
        raise InputError(
            f"the captures are of a {sensor}, the profile {base} is of a {profile.sensor.family}"
        )
    return profile


def report_folder(out: Path, report: Path | None) -> Path:
    """Where the report goes: the folder asked for, or ``<out>_report`` beside the profile."""
    return report if report is not None else out.with_name(out.name + "_report")


def require_outputs(out: Path, report: Path) -> None:
    """Refuse unusable output folders before any long work."""
    from taccel_lab.output import require_replaceable
    from taccel_lab.profile import require_profile_folder

    require_profile_folder(out)
    require_replaceable(report)


_within_all: ContextVar[bool] = ContextVar("within_all", default=False)


@contextmanager
def stage_of_all() -> Iterator[None]:
    """Commands that run inside do not name the folders they write: these are scratch."""
    token = _within_all.set(True)
    try:
        yield
    finally:
        _within_all.reset(token)


def write_results(
    result: CalibrationResult,
    page: Page,
    base: SensorProfile,
    out: Path,
    report: Path,
    console: Console,
) -> None:
    """Save the extended profile and the report, and say the verdict with its remarks."""
    from calibration.report import write_page
    from calibration.result import judge
    from taccel_lab.profile import save_profile

    save_profile(result.apply_to(base), out)
    write_page(page, report)
    for remark in result.remarks:
        console.print(str(remark), highlight=False)
    console.print(f"verdict: {judge(result.remarks)}", highlight=False)
    if not _within_all.get():
        console.print(f"wrote {out} and {report / 'report.html'}", highlight=False)
