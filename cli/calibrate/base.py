# SPDX-License-Identifier: Apache-2.0
"""What the calibration commands share: the profile to start from, and where results go."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from taccel_lab.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.calibration.capture import CaptureFolder, CaptureSet
    from taccel_lab.calibration.report import Page
    from taccel_lab.calibration.result import CalibrationResult
    from taccel_lab.geometry import PixelGrid
    from taccel_lab.profile import SensorProfile


MEASURED = ("calibrated", "measured")
"""Kinds of blocks that say something about the unit at hand."""


def base_profile(base: Path | None, folder: CaptureFolder) -> SensorProfile:
    """The profile in the folder ``base``, or the catalogue's design that fits the captures."""
    from taccel_lab.calibration.surfaces.design import fitted_design
    from taccel_lab.profile import load_profile
    from taccel_lab.sensors.profile import catalogue_profile

    if base is None:
        if folder.mm_per_px is not None and folder.background is not None:
            grid = folder.grid()
            return on_grid(fitted_design(folder.sensor, grid).profile, grid, folder.provenance)
        return catalogue_profile(folder.sensor)
    profile = load_profile(base)
    if profile.sensor.family != folder.sensor:
        raise InputError(
            f"the captures are of a {folder.sensor}, the profile {base} is of a "
            f"{profile.sensor.family}"
        )
    return profile


def presses_on_camera(
    folder: CaptureFolder, base: SensorProfile
) -> tuple[CaptureSet, SensorProfile]:
    """Ball presses and profile on one pixel grid.

    The grid is the profile's where its camera was measured on this unit and shows images of this
    size; else the one that the captures state.
    """
    from dataclasses import replace

    if base.camera.provenance.kind in MEASURED:
        grid = base.camera.grid()
        captures = folder.ball_presses((grid.mm_per_px_x, grid.mm_per_px_y))
        if (captures.grid.width_px, captures.grid.height_px) == (grid.width_px, grid.height_px):
            return replace(captures, grid=grid), base
    captures = folder.ball_presses()
    return captures, on_grid(base, captures.grid, captures.provenance)


def on_grid(
    profile: SensorProfile, grid: PixelGrid, provenance: Mapping[str, str]
) -> SensorProfile:
    """The profile with the captures' image size and scale; as it is where it has them."""
    from taccel_lab.profile import CameraBlock, Provenance

    if profile.camera.grid() == grid:
        return profile
    return profile.without("background", "color", "normals").with_block(
        CameraBlock.from_grid(
            grid,
            Provenance(
                kind="published",
                method="image size and scale of the captures; the image centre lies over the apex",
                source=provenance.get("source", "captures.toml"),
            ),
        )
    )


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
    from taccel_lab.output import require_replaceable
    from taccel_lab.profile import require_profile_folder

    inner, outer = Path(os.path.abspath(report)), Path(os.path.abspath(out))
    if inner == outer or outer in inner.parents:
        raise InputError(
            f"the report {report} would lie in the profile {out}, which holds nothing else; name "
            "another folder with --report"
        )
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


@dataclass(frozen=True)
class Job:
    """What one calibration command starts from, and where its results go."""

    folder: CaptureFolder
    base: SensorProfile
    out: Path
    report: Path
    console: Console
    """For people; standard output is for figures."""

    @property
    def is_stage(self) -> bool:
        """Whether this is a stage of ``calibrate all``, whose folders are scratch."""
        return _within_all.get()

    def write(self, result: CalibrationResult, page: Page) -> None:
        """Save the extended profile and the report."""
        write_results(result, page, self.base, self.out, self.report, self.console)


def open_job(captures: Path, out: Path, base: Path | None, report: Path | None) -> Job:
    """Refuse unusable outputs, then load the captures and the profile to extend."""
    from rich.console import Console

    from taccel_lab.calibration.capture import load_capture_folder

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
    if not _within_all.get():
        console.print(f"wrote {out} and {report / 'report.html'}", highlight=False)
