# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate normals``: ball presses in, a profile that reads surfaces out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from taccel_lab.calibration.normals.options import NormalOptions

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.calibration.normals.result import NormalCalibration


@dataclass(frozen=True)
class CalibrateNormals(NormalOptions):
    """Fit the model from colour to surface normal to captured ball presses and write a profile.

    Inside a contact the ball gives the normal of every pixel; a small ensemble of networks learns
    it from the change of colour around the pixel, with its own uncertainty. Figures are of
    presses that were chosen before any image was read, and are looked at when the model is frozen.
    `taccel-lab depth` then reads height maps from images.
    """

    captures: Positional[Path]
    """Capture folder with captures.toml (docs/captures.md), or a Taxim dataPack.npz."""
    out: Path
    """Profile folder to write."""
    base: Path | None = None
    """Profile to extend; the catalogue's design of the captures' sensor when left out."""
    report: Path | None = None
    """Folder for the report (HTML, pictures, JSON); <out>_report when left out."""
    json: bool = False
    """Print the figures as JSON instead of a summary."""

    def run(self) -> None:
        import warp as wp
        from rich.console import Console

        from taccel_lab.calibration.normals.fit import calibrate_normals
        from taccel_lab.calibration.normals.report import normals_page
        from taccel_lab.cli.calibrate.base import open_job
        from taccel_lab.cli.console import print_json
        from taccel_lab.cli.progress import stage_progress

        wp.config.log_level = wp.LOG_ERROR  # no driver, no GPU: none is needed here
        job = open_job(self.captures, self.out, self.base, self.report)
        with stage_progress(job.console) as progress:
            result = calibrate_normals(job.folder, job.base, self, progress)
        job.write(result, normals_page(result))
        if self.json:
            print_json({"profile": str(self.out), "normals": result.figures()})
        else:
            _print_summary(Console(), result)


def _print_summary(console: Console, result: NormalCalibration) -> None:
    if not result.heldout:
        console.print("no press was held out, so there are no figures")
        return
    used = result.heldout_means("used")
    given = result.heldout_means("given")
    console.print(
        f"{len(result.heldout)} held-out presses, {len(result.train_names)} fitted in "
        f"{result.fit.seconds:.0f} s",
        highlight=False,
    )
    console.print(
        f"  normals off by {used['mean_deg']:.2f} deg ({given['mean_deg']:.2f} in the given "
        f"circles; a flat guess {used['flat_deg']:.1f}, colour of the pixel alone "
        f"{result.baseline_deg or float('nan'):.2f})",
        highlight=False,
    )
    console.print(
        f"  depth off by {used['depth_mae_mm']:.3f} mm of {used['depth_mm']:.2f} mm",
        highlight=False,
    )
    if result.reliability is not None:
        console.print(
            f"  {result.reliability.within_68:.0%} of errors within the 68 % radius, "
            f"{result.reliability.within_95:.0%} within the 95 % radius",
            highlight=False,
        )
