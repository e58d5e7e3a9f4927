# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate background``: the image of the untouched sensor, and what its light did"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional


@dataclass(frozen=True)
class CalibrateBackground:
    """Average all frames to a quieter background, the drift of each frame's light taken off.

    Uses the background, the further untouched images and the untouched parts of the presses; with
    no untouched image at all, the median of five or more presses. Reports the drift over the
    frames, whether the white balance was automatic, the noise of the pixels, and dust. Writes the
    block ``background``, and dust.png beside the report, which serves as the captures' mask.
    """

    captures: Positional[Path]
    """Capture folder with captures.toml (docs/captures.md)."""
    out: Path
    """Profile folder to write."""
    base: Path | None = None
    """Profile to extend; the catalogue's design of the sensor when left out."""
    report: Path | None = None
    """Folder for the report; <out>_report when left out."""
    json: bool = False
    """Print the figures as JSON."""

    def run(self) -> None:
        from taccel_lab.calibration.background.fit import calibrate_background
        from taccel_lab.calibration.background.report import background_page
        from taccel_lab.cli.calibrate.base import open_job
        from taccel_lab.cli.console import print_json
        from taccel_lab.cli.progress import stage_progress

        job = open_job(self.captures, self.out, self.base, self.report)
        with stage_progress(job.console) as progress:
            result = calibrate_background(job.folder, job.base, progress)
        job.write(result, background_page(result))
        if self.json:
            print_json({"profile": str(self.out), "background": result.figures()})
