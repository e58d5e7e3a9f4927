# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab demo``: the main job, end to end, on real captures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

DEMO_INDENTER = "sphere:2.0"
DEMO_AT_MM = (1.0, -0.5)
"""A place where no capture was taken."""


@dataclass(frozen=True)
class Demo:
    """Calibrate a real GelSight and press it: captures in, profile and report out; takes some
    minutes.

    Runs calibrate all and press. It checks the captures, fits every block that they allow, and
    writes profile and report. A quarter of the presses is held out before any image is read. Then
    it presses the calibrated sensor at a position that was never captured. The captures are the
    GelSight ball presses of the PyPI package taxim. Finished blocks are kept in <out>_unfinished,
    where the same command continues after a crash.
    """

    out: Path = Path("out/demo")
    """Folder to write: profile, report and press. An earlier one is replaced when everything is
    done."""
    captures: Path | None = None
    """Capture folder (docs/captures.md). Default: the captures of taxim."""
    depth_mm: float = 0.8
    """Depth of the last press [mm]."""
    only: tuple[str, ...] = ()
    """Blocks to fit, by name. Default: all."""
    json: bool = False
    """Print the figures as JSON instead of summaries."""

    def run(self) -> None:
        from taccel_lab.api.press_options import PressOptions
        from taccel_lab.api.press_run import PressRun, step_progress
        from taccel_lab.calibration.base_profile import base_profile
        from taccel_lab.calibration.calibrate import calibrate
        from taccel_lab.calibration.capture import find_taxim_pack
        from taccel_lab.calibration.capture.load import load_capture_folder
        from taccel_lab.cli.console import kept_blocks, notes, print_json, results, working
        from taccel_lab.files.output_folder import atomic_directory, require_replaceable
        from taccel_lab.progress import stage_progress

        console = notes()
        require_replaceable(self.out)
        folder = load_capture_folder(self.captures or find_taxim_pack())
        options = PressOptions(self.depth_mm, indenter=DEMO_INDENTER, at_mm=DEMO_AT_MM)
        # What can be rejected is rejected before minutes of work.
        PressRun.plan(base_profile(None, folder), options)
        with kept_blocks(self.out) as unfinished, atomic_directory(self.out) as staging:
            with stage_progress(console) as progress:
                found = calibrate(folder, only=self.only, progress=progress, unfinished=unfinished)
            with working(console, "writing the reports"):
                found.write_report(staging / "report")
            found.save(staging / "profile")
            with step_progress(console, "pressing the calibrated sensor") as bar:
                pressed = PressRun.plan(found, options).run(bar)
            pressed.save(staging / "press")
        if found.unfinished is not None:
            found.unfinished.remove()
        if self.json:
            print_json({"blocks": found.figures(), "press": pressed.figures()})
        else:
            results().print(f"{found!r}\n{pressed!r}", soft_wrap=True)
        console.print(f"report: {self.out / 'report' / 'report.html'}")
