# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate scale``: anything of known length in, mm/px in x and y out."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from taccel_lab.cli.calibrate.base import BlockCommand, Fitted

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.calibration.capture.folder import CaptureFolder
    from taccel_lab.calibration.scale.result import ScaleCalibration
    from taccel_lab.progress import Progress


@dataclass(frozen=True)
class CalibrateScale(BlockCommand):
    """Measure mm/px along x and y from whatever of known length was captured.

    Boards on the gel, presses of a straight edge, markers of known pitch, landmarks, and ball
    presses with depths each give a scale with its uncertainty; they are compared and, where they
    agree, averaged. Ball presses without depths give an upper limit only.
    """

    captures: Positional[Path]
    """Capture folder (docs/calibration_camera.md)."""

    def fit(self, folder: CaptureFolder, progress: Progress) -> Fitted:
        """Measure every known length."""
        from taccel_lab.calibration.scale.fit import calibrate_scale
        from taccel_lab.calibration.scale.report import scale_page

        base = self.profile_to_extend(folder)
        result = calibrate_scale(folder, base, progress)
        page = scale_page(result, folder)
        return Fitted("scale", base, result, page, partial(_print_summary, result))


def _print_summary(result: ScaleCalibration, console: Console) -> None:
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
