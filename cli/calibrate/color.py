# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate color``: real captures in, a profile with a colour model out."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from taccel_lab.calibration.color.options import ColorOptions
from taccel_lab.cli.calibrate.base import BlockCommand, Fitted

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.calibration.capture.folder import CaptureFolder
    from taccel_lab.calibration.color.result import ColorCalibration
    from taccel_lab.progress import Progress


@dataclass(frozen=True)
class CalibrateColor(BlockCommand, ColorOptions):
    """Fit the pixel-to-colour model to captured ball presses and write a profile.

    Every press is simulated to get the gel's surface under it; the model then learns the colour
    of each pixel from position, normal and displacement. Figures are of presses that were chosen
    before any image was read, and are looked at when the model is frozen. Simulations are kept, so
    that a second run takes the fit only.
    """

    captures: Positional[Path]
    """Capture folder with captures.toml (docs/captures.md), or a Taxim dataPack.npz."""
    base: Path | None = None
    """Profile of the designed sensor to extend; the catalogue's design of the sensor, turned as the
    images are, when left out. A sensor that the catalogue does not know is taken as a flat pad."""

    def fit(self, folder: CaptureFolder, progress: Progress) -> Fitted:
        """Simulate the presses and train the model."""
        from taccel_lab.calibration.color.fit import calibrate_color
        from taccel_lab.calibration.color.report import color_page

        base = self.profile_to_extend(folder)
        result = calibrate_color(folder, base, self, progress)
        page = color_page(result)
        return Fitted("color", base, result, page, partial(_print_figures, result))


def _print_figures(result: ColorCalibration, console: Console) -> None:
    from rich.table import Table

    from taccel_lab.calibration.color.report import FIGURES, figure_columns

    columns = figure_columns(result)
    if not result.has_scores:
        console.print("no press was held out, so there are no figures of held-out presses")
    if not columns:
        return
    table = Table(
        "figure",
        *columns,
        title=f"{len(result.heldout) + len(result.failures)} held-out presses, "
        f"{len(result.failures)} failed, {len(result.train_names)} fitted",
        title_justify="left",
    )
    for key, label in FIGURES:
        style = ".4f" if key == "crop_ssim" else ".2f"
        table.add_row(label, *(format(scores[key], style) for scores in columns.values()))
    console.print(table)
    console.print(
        f"noise floor (captures against background beyond 3 r): {result.noise_floor_l1:.2f} "
        f"levels; fit took {result.fit.seconds:.0f} s",
    )
