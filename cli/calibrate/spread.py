# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate spread``: how far days and units differ, for domain randomisation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

if TYPE_CHECKING:
    from taccel_lab.calibration.background.result import BackgroundCalibration, FrameLight
    from taccel_lab.calibration.report import Page
    from taccel_lab.calibration.spread import SpreadCalibration


@dataclass(frozen=True)
class CalibrateSpread:
    """Measure how much captures drift and units differ, for domain randomisation.

    The light of every frame (gain, offset, gradient) is fitted against the background; with
    --units the images at rest, scales and materials of other units of this design are compared
    too. The block ``perturbation`` holds the standard deviations; draw sensors from it with
    taccel_lab.signals.perturbation.draw_perturbation.
    """

    captures: Positional[Path]
    """Capture folder with captures.toml: its untouched images, else its presses."""
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
        from taccel_lab.calibration.background.fit import calibrate_background
        from taccel_lab.calibration.spread import calibrate_spread, spread_of_units
        from taccel_lab.cli.calibrate.base import open_job
        from taccel_lab.cli.console import print_json
        from taccel_lab.cli.progress import stage_progress
        from taccel_lab.profile import load_profile

        job = open_job(self.captures, self.out, self.base, self.report)
        folder = job.folder
        units = None
        if self.units:
            others = [load_profile(path) for path in self.units]
            units = spread_of_units([job.base, *others] if self.base is not None else others)
        with stage_progress(job.console) as progress:
            light = calibrate_background(folder, progress)
        result = calibrate_spread(
            [frame.drift for frame in compared_frames(light)],
            units,
            light.image,
            inputs=light.inputs,
            source=light.source,
            noise_levels=light.noise_levels,
        )
        page = spread_page(result, folder.sensor)
        job.write(result, page)
        if self.json:
            print_json({"profile": str(self.out), "spread": result.figures()})


def compared_frames(light: BackgroundCalibration) -> list[FrameLight]:
    """The untouched frames, or the presses where there are fewer than two of them."""
    untouched = [frame for frame in light.frames if frame.kind == "untouched"]
    presses = [frame for frame in light.frames if frame.kind == "press"]
    return untouched if len(untouched) > 1 else presses


def spread_page(result: SpreadCalibration, sensor: str) -> Page:
    """The spread as a page: table of standard deviations, frames over time."""
    from taccel_lab.calibration.report import Page, Picture, Table
    from taccel_lab.calibration.spread.figures import draw_lights

    rows = []
    for name, value in result.values().items():
        cells = value if isinstance(value, tuple) else (value, None, None)
        rows.append((name, *cells))
    pictures = []
    if result.lights:
        pictures.append(
            Picture(
                "lights",
                lambda: draw_lights(result.lights, result.pivot),
                "Light of each frame (or unit) against the mean image, by channel.",
            )
        )
    return Page(
        title=f"Spread of captures: {sensor}",
        summary=f"{len(result.frame_drifts)} frames of this unit, "
        f"{0 if result.units is None else result.units.unit_count} units compared.",
        remarks=result.remarks,
        tables=[Table("Standard deviations", ("quantity", "red or value", "green", "blue"), rows)],
        pictures=pictures,
        figures=result.figures(),
    )
