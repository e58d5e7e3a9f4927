# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate scale``: anything of known length in, mm/px in x and y out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.calibration.scale.result import ScaleCalibration


@dataclass(frozen=True)
class CalibrateScale:
    """Measure mm/px along x and y from whatever of known length was captured.

    Boards on the gel, presses of a straight edge, markers of known pitch, landmarks, and ball
    presses with depths each give a scale with its uncertainty; they are compared and, where they
    agree, averaged. Ball presses without depths give an upper limit only.
    """

    captures: Positional[Path]
    """Capture folder (docs/calibration_camera.md)."""
    out: Path
    """Profile folder to write."""
    base: Path | None = None
    """Profile to extend; the catalogue's design of the captures' sensor when left out."""
    report: Path | None = None
    """Folder for the report (HTML, pictures, JSON); <out>_report when left out."""
    json: bool = False
    """Print the figures as JSON instead of a summary."""

    def run(self) -> None:
        from rich.console import Console

        from taccel_lab.calibration.scale.fit import calibrate_scale
        from taccel_lab.calibration.scale.report import scale_page
        from taccel_lab.cli.calibrate.base import open_job
        from taccel_lab.cli.console import print_json
        from taccel_lab.cli.progress import stage_progress

        job = open_job(self.captures, self.out, self.base, self.report)
        with stage_progress(job.console) as progress:
            result = calibrate_scale(job.folder, job.base, progress)
        job.write(result, scale_page(result, job.folder))
        if self.json:
            print_json({"profile": str(self.out), "scale": result.figures()})
        else:
            _print_summary(Console(), result)


def _print_summary(console: Console, result: ScaleCalibration) -> None:
    from rich.table import Table

    table = Table("method", "along x [mm/px]", "along y [mm/px]", title_justify="left")
    for estimate in result.estimates:
        limit = "" if estimate.upper_x is None else f"at most {estimate.upper_x:.5f}"
        table.add_row(estimate.method, _cell(estimate.x) or limit, _cell(estimate.y))
    x, y = result.axes.get("x"), result.axes.get("y")
    table.add_row("mean", _cell(x and x.estimate), _cell(y and y.estimate))
    console.print(table)


def _cell(estimate: object | None) -> str:
    return "" if estimate is None else str(estimate).removesuffix(" mm/px")
