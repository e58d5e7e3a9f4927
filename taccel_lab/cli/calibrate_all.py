# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate all``: every block that a capture folder has captures for, in order."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taccel_lab.calibration.blocks import all_blocks
from taccel_lab.calibration.press_options import ThicknessMode
from taccel_lab.cli.calibration_outputs import CalibrationFiles, report_folder, require_outputs

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.calibration.calibrate import Calibration


@dataclass(frozen=True)
class CalibrateAll(CalibrationFiles):
    """Fit every block that the captures allow and write one profile and one report.

    The captures are checked first (taccel-lab capture check), which names the blocks in the order
    in which they are fitted then. Blocks without captures are skipped, and the report says what to
    capture. After a board on the gel the images are rectified; the maps are in the report. Finished
    blocks are kept in <report>_unfinished, where the same command continues after a crash. Exits
    with 1 when the captures of a block cannot be used.
    """

    report: Path | None = None
    """Folder for the reports: one of the whole and one for each block; <out>_report when left
    out."""
    only: tuple[str, ...] = ()
    """Blocks to fit, by name. Default: all."""
    holdout_every: int = 4
    """One press in this many is held out to score color and normals; 0 holds none out."""
    thickness: ThicknessMode = "auto"
    """Thickness of the gel, for color and normals: auto fits an unmeasured one, and rejects a
    stated one that the presses contradict. fit always fits it."""

    def run(self) -> None:
        from taccel_lab.calibration.calibrate import calibrate
        from taccel_lab.cli.console import kept_blocks, notes, print_json, print_table, working
        from taccel_lab.profile.io import profile_saved
        from taccel_lab.progress import stage_progress

        console = notes()
        report = report_folder(self.out, self.report)
        require_outputs(self.out, report)
        with kept_blocks(report) as unfinished:
            with stage_progress(console) as progress:
                found = calibrate(
                    self.captures,
                    self.base,
                    self.only,
                    self._options(),
                    progress=progress,
                    unfinished=unfinished,
                )
            with working(console, "writing the reports"), profile_saved(found.profile, self.out):
                found.write_report(report)
        if found.unfinished is not None:
            found.unfinished.remove()
        _print_remarks(console, found)
        if self.json:
            outcomes = [outcome.figures() for outcome in found.blocks]
            print_json({"profile": str(self.out), "blocks": outcomes})
        else:
            rows = [(b.name, str(b.state), b.message, f"{b.seconds:.0f}") for b in found.blocks]
            print_table(("block", "state", "verdict or reason", "seconds"), rows)
        console.print(f"wrote {self.out} and {report / 'report.html'}")
        if found.unfit:
            raise SystemExit(1)

    def _options(self) -> dict[str, Any]:
        """Options of the blocks that hold presses out."""
        from taccel_lab.calibration.press_options import BallPressOptions

        chosen = {"holdout_every": self.holdout_every, "thickness": self.thickness}
        named = {block.name: block.options for block in all_blocks()}
        return {
            name: options(**chosen)
            for name, options in named.items()
            if options is not None and issubclass(options, BallPressOptions)
        }


def _print_remarks(console: Console, found: Calibration) -> None:
    for note in found.notes:
        console.print(f"note: {note}")
    for outcome in found.blocks:
        if outcome.page is not None:
            console.rule(outcome.name, align="left")
            for remark in outcome.page.remarks:
                console.print(str(remark))
            console.print(f"verdict: {outcome.message}")
