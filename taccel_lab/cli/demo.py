# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab demo``: calibrate with real captures, then simulate photos that were held out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Demo:
    """Calibrate a real GelSight and simulate its photos: captures in, one page out; takes some
    minutes.

    Runs calibrate all and press --like. It checks the captures and fits every block that they
    allow. A quarter of the presses is held out before any image is read. Two of those photos are
    then simulated. The page shows them beside their simulations, with depths, forces and errors,
    and links to everything else. The captures are the GelSight ball presses of the PyPI package
    taxim. Finished blocks are kept in <out>_unfinished, where the same command continues after a
    crash. Exits with 1 when the captures of a block cannot be used, or no photo can be simulated.
    """

    out: Path = Path("out/demo")
    """Folder to write: report, profile, photos and presses. An earlier one is replaced when
    everything is done."""
    captures: Path | None = None
    """Capture folder with ball presses (docs/captures.md). Default: the captures of taxim."""
    json: bool = False
    """Print the figures as JSON instead of summaries."""

    def run(self) -> None:
        from taccel_lab.api.demonstration import (
            REPORT,
            shown_presses,
            simulate_photos,
            write_demonstration,
        )
        from taccel_lab.calibration.calibrate import calibrate
        from taccel_lab.calibration.capture import find_taxim_pack
        from taccel_lab.calibration.capture.load import load_capture_folder
        from taccel_lab.cli.console import kept_blocks, notes, print_json, results, working
        from taccel_lab.files.output_folder import atomic_directory, require_replaceable
        from taccel_lab.progress import stage_progress

        console = notes()
        require_replaceable(self.out)
        folder = load_capture_folder(self.captures or find_taxim_pack())
        # What can be rejected is rejected before minutes of work.
        presses = shown_presses(folder)
        with kept_blocks(self.out) as unfinished, atomic_directory(self.out) as staging:
            with stage_progress(console) as progress:
                found = calibrate(folder, progress=progress, unfinished=unfinished)
                photos = simulate_photos(found, presses, staging, progress)
            with working(console, "writing the reports"):
                write_demonstration(found, photos, staging)
        if found.unfinished is not None:
            found.unfinished.remove()
        if self.json:
            figures = {photo.name: photo.figures for photo in photos}
            print_json({"blocks": found.figures(), "presses": figures})
        else:
            for said in (repr(found), *(photo.said for photo in photos if photo.strip)):
                results().print(said, soft_wrap=True)
        for photo in photos:
            if photo.strip is None:
                console.print(f"{photo.name} was not simulated: {photo.said}")
        console.print(f"look at {self.out / REPORT / 'report.html'}")
        if found.unfit or not any(photo.strip for photo in photos):
            raise SystemExit(1)
