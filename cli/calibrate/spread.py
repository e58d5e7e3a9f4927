# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate spread``: how far days and units differ, for domain randomisation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional


@dataclass(frozen=True)
class CalibrateSpread:
    """Measure how much frames drift and units differ, for domain randomisation.

    The light of every frame (gain, offset, gradient) is fitted against the background; with
    --units the images at rest, scales and materials of other units of this design are compared
    too. The block ``perturbation`` holds the standard deviations;
    taccel_lab.signals.perturbation.draw_perturbation draws sensors from it.
    """

    captures: Positional[Path]
    """Capture folder with captures.toml: its untouched images are compared, or else its presses."""
    out: Path
    """Profile folder to write."""
    base: Path | None = None
    """Profile to extend; the catalogue's design of the sensor when left out."""
    units: tuple[Path, ...] = ()
    """Profiles of other units of the same design; the base counts as one when it is given."""
    report: Path | None = None
    """Folder for the report; <out>_report when left out."""
    json: bool = False
    """Print the figures as JSON."""

    def run(self) -> None:
        from taccel_lab.calibration.spread.fit import SpreadOptions, calibrate_spread
        from taccel_lab.calibration.spread.report import spread_page
        from taccel_lab.cli.calibrate.base import open_job
        from taccel_lab.cli.console import print_json
        from taccel_lab.cli.progress import stage_progress
        from taccel_lab.profile import load_profile

        job = open_job(self.captures, self.out, self.base, self.report)
        units = [load_profile(path) for path in self.units]
        if units and self.base is not None:
            units.insert(0, job.base)
        with stage_progress(job.console) as progress:
            result = calibrate_spread(job.folder, job.base, SpreadOptions(tuple(units)), progress)
        job.write(result, spread_page(result))
        if self.json:
            print_json({"profile": str(self.out), "spread": result.figures()})
