# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate normals``: ball presses in, a profile that reads surfaces out."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from taccel_lab.calibration.normals.options import NormalOptions
from taccel_lab.cli.calibrate.base import BlockCommand, Fitted

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.calibration.capture.folder import CaptureFolder
    from taccel_lab.calibration.normals.result import NormalCalibration
    from taccel_lab.progress import Progress


@dataclass(frozen=True)
class CalibrateNormals(BlockCommand, NormalOptions):
    """Fit the model from colour to surface normal to captured ball presses and write a profile.

    Inside a contact the ball gives the normal of every pixel; a small ensemble of networks learns
    it from the change of colour around the pixel, with its own uncertainty. Figures are of
    presses that were chosen before any image was read, and are looked at when the model is frozen.
    `taccel-lab depth` then reads height maps from images.
    """

    captures: Positional[Path]
    """Capture folder with captures.toml (docs/captures.md), or a Taxim dataPack.npz."""

    def fit(self, folder: CaptureFolder, progress: Progress) -> Fitted:
        """Train the ensemble."""
        from taccel_lab.calibration.normals.fit import calibrate_normals
        from taccel_lab.calibration.normals.report import normals_page

        base = self.profile_to_extend(folder)
        result = calibrate_normals(folder, base, self, progress)
        return Fitted(
            "normals", base, result, normals_page(result), partial(_print_summary, result)
        )


def _print_summary(result: NormalCalibration, console: Console) -> None:
    if not result.heldout:
        console.print("no press was held out, so there are no figures")
        return
    used = result.heldout_means("used")
    given = result.heldout_means("given")
    console.print(
        f"{len(result.heldout)} held-out presses, {len(result.train_names)} fitted in "
        f"{result.fit.seconds:.0f} s",
    )
    console.print(
        f"  normals off by {used['mean_deg']:.2f} deg ({given['mean_deg']:.2f} in the given "
        f"circles; a flat guess {used['flat_deg']:.1f}, colour of the pixel alone "
        f"{result.baseline_deg or float('nan'):.2f})",
    )
    absolute = result.absolute_means()
    if absolute is not None:
        console.print(
            f"  depth off by {absolute['mae_mm']:.3f} mm of {absolute['wanted_mm']:.2f} mm, "
            f"against the ball pressed into the pad; {absolute['within_68']:.0%} within one "
            f"standard deviation, {absolute['within_95']:.0%} within two",
        )
    console.print(
        f"  aligned on the circle, depth off by {used['depth_mae_mm']:.3f} mm of "
        f"{used['depth_mm']:.2f} mm",
    )
    if result.practised is not None:
        console.print(
            f"  depth off by {result.practised.rmse_mm:.3f} mm rms on "
            f"{result.practised.count} simulated presses of other tools",
        )
    if result.reliability is not None:
        console.print(
            f"  {result.reliability.within_68:.0%} of errors within the 68 % radius, "
            f"{result.reliability.within_95:.0%} within the 95 % radius",
        )
