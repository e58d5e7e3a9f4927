# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab demo``: the main job, end to end, on real captures."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

DEMO_INDENTER = "sphere:2.0"
DEMO_AT_MM = (1.0, -0.5)
"""A place where no capture was taken."""


@dataclass(frozen=True)
class Demo:
    """Real GelSight captures in, calibrated sensor profile and report out; takes some minutes.

    Designs the gel pad, finds the contact circles, simulates the captured presses, fits the colour
    model (a quarter of the presses is held out before any image is read), exports the
    profile, presses the calibrated sensor once more and writes report.html and report.json. The
    captures are the GelSight ball presses of the PyPI package taxim.
    """

    out: Path = Path("out/demo")
    """Folder to write; an earlier one is replaced when everything is done."""
    captures: Path | None = None
    """Capture folder (docs/captures.md) of a gelsight; the captures of taxim when left out."""
    depth_mm: float = 0.8
    """Depth of the last press [mm]."""
    steps: int = 2000
    """Optimiser steps of the colour fit."""
    seed: int = 0
    """Seed of the colour fit."""
    json: bool = False
    """Print the figures of the report as JSON instead of a table."""

    def run(self) -> None:
        from taccel_lab.cad.mesh.quality_measures import dihedral_angles_deg
        from taccel_lab.calibration.color.fit_options import ColorFitOptions
        from taccel_lab.calibration.demo import BATCH_PIXELS, DEMO_SENSOR, calibrate_demo
        from taccel_lab.calibration.demo_report import build_report
        from taccel_lab.cli.console import notes, print_json
        from taccel_lab.cli.press import Press
        from taccel_lab.cli.progress import stage_progress
        from taccel_lab.envs import PressPath
        from taccel_lab.envs.press import check_depth
        from taccel_lab.output_folder import atomic_directory, require_replaceable
        from taccel_lab.report import write_report
        from taccel_lab.sensors.profile import load_sensor
        from taccel_lab.warp_output import quiet_warp

        quiet_warp()
        console = notes()
        require_replaceable(self.out)
        # What can be refused is refused before minutes of work.
        options = ColorFitOptions(steps=self.steps, batch_pixels=BATCH_PIXELS, seed=self.seed)
        PressPath(self.depth_mm)
        check_depth(self.depth_mm, load_sensor(DEMO_SENSOR))
        with atomic_directory(self.out) as folder:
            with stage_progress(console) as progress:
                results = calibrate_demo(self.captures, folder, options, progress)
            started = time.perf_counter()
            outcome, image = Press(
                sensor=str(folder / "profile"),
                out=folder / "press",
                depth_mm=self.depth_mm,
                indenter=DEMO_INDENTER,
                at_mm=DEMO_AT_MM,
            ).execute(console)
            pressing = {"pressing the calibrated sensor": time.perf_counter() - started}
            seconds = results.seconds | pressing
            for stage, value in seconds.items():
                console.print(f"{stage}: {value:.1f} s")
            mesh = results.design.mesh
            angles = dihedral_angles_deg(mesh.nodes_m, mesh.tets)
            values = write_report(build_report(results, outcome, image, angles, seconds), folder)
        if self.json:
            print_json(values)
        else:
            _print_summary(console, values, seconds)
        console.print(f"report: {self.out / 'report.html'}")


def _print_summary(console: Console, values: dict, seconds: dict[str, float]) -> None:
    from rich.table import Table

    held, bare = values["color"]["heldout"], values["color"]["background_only"]
    table = Table("held-out presses", "rendered", "background only", title_justify="left")
    for key, label, style in (
        ("crop_psnr_db", "PSNR in the 1.6 r crop [dB]", ".2f"),
        ("crop_ssim", "SSIM in the crop", ".4f"),
        ("disc_l1", "L1 in the contact disc [levels]", ".2f"),
        ("full_l1", "L1 over the image [levels]", ".2f"),
    ):
        table.add_row(label, format(held[key], style), format(bare[key], style))
    console.print(table)
    console.print(f"held-out presses are {values['color']['facts']['held-out presses']}")
    console.print(f"{sum(seconds.values()):.0f} s in all")
