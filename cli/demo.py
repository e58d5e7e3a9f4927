# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab demo``: the main job, end to end, on real captures."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from taccel_lab.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.calibration.surfaces.between import SharedLaw
    from taccel_lab.cli.demo_report import DemoResults

DEMO_SENSOR = "gelsight"
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

    def run(self) -> None:
        import warp as wp
        from rich.console import Console

        from taccel_lab.cli.demo_report import build_report
        from taccel_lab.output import atomic_directory, require_replaceable
        from taccel_lab.report import write_report

        wp.config.log_level = wp.LOG_WARNING
        console = Console(stderr=True)
        require_replaceable(self.out)
        clock = StageClock(console)
        with atomic_directory(self.out) as folder:
            results = self._work(folder, console, clock)
            with clock.stage("writing the report"):
                report = build_report(results, clock.seconds)
            values = write_report(report, folder)
        _print_summary(console, values, clock)
        console.print(f"report: {self.out / 'report.html'}", highlight=False)

    def _work(self, folder: Path, console: Console, clock: StageClock) -> DemoResults:
        from taccel_lab.calibration.capture import find_taxim_pack, load_captures
        from taccel_lab.calibration.capture.split import HOLDOUT_EVERY
        from taccel_lab.calibration.color.fit import HeldoutSet, calibrate_color
        from taccel_lab.calibration.color.options import ColorFitOptions
        from taccel_lab.calibration.contacts import choose_circles, resolve_contacts
        from taccel_lab.calibration.simulate import simulate_presses
        from taccel_lab.cli.calibrate.base import on_grid
        from taccel_lab.cli.demo_report import DemoResults
        from taccel_lab.cli.progress import count_progress, fit_progress
        from taccel_lab.envs import PressPath
        from taccel_lab.envs.press import check_depth
        from taccel_lab.profile import save_profile
        from taccel_lab.sensors.design import design_sensor
        from taccel_lab.sensors.profile import load_sensor
        from taccel_lab.sensors.registry import sensor_family

        # What can be refused is refused before minutes of work.
        options = ColorFitOptions(steps=self.steps, seed=self.seed)
        PressPath(self.depth_mm)
        check_depth(self.depth_mm, load_sensor(DEMO_SENSOR))
        with clock.stage("loading the captures"):
            captures = load_captures(self.captures or find_taxim_pack())
            split = captures.split(HOLDOUT_EVERY)
            training = captures.only(split.train)
        if captures.sensor != DEMO_SENSOR:
            raise InputError(
                f"{captures.source} was captured with sensor {captures.sensor!r}; the demo takes "
                f"captures of a {DEMO_SENSOR!r}"
            )
        with clock.stage("designing the gel pad"):
            design = design_sensor(sensor_family(DEMO_SENSOR), None, folder / "design")
            base = on_grid(design.profile, captures.grid, captures.provenance)
        with clock.stage("finding the contact circles"):
            contacts = resolve_contacts(training)
            circles = choose_circles(training, contacts)
        with (
            clock.stage("simulating the presses", spinner=False),
            count_progress(console, "simulating the presses") as progress,
        ):
            # As calibrate color does: one law serves the others, the held-out presses too.
            laws: dict[float, SharedLaw] = {}
            simulated = partial(simulate_presses, profile=base, share=True, laws=laws)
            surfaces = simulated(training, circles, progress=progress)
        with (
            clock.stage("fitting the colour model and scoring it", spinner=False),
            fit_progress(console, "fitting the colour model") as fit_bar,
        ):
            calibration = calibrate_color(
                training,
                circles,
                surfaces,
                HeldoutSet.of(captures, split, simulated),
                options=options,
                progress=fit_bar,
            )
        profile = calibration.apply_to(base)
        with clock.stage("exporting the profile"):
            save_profile(profile, folder / "profile")
        with clock.stage("pressing the calibrated sensor", spinner=False):
            outcome, image = self._press(folder / "profile", folder / "press", console)
        return DemoResults(
            captures=training,
            design=design,
            contacts=contacts,
            circles=circles,
            surfaces=surfaces,
            calibration=calibration,
            profile=profile,
            outcome=outcome,
            image=image,
        )

    def _press(self, profile: Path, out: Path, console: Console):
        from taccel_lab.cli.press import Press

        return Press(
            sensor=str(profile),
            out=out,
            depth_mm=self.depth_mm,
            indenter=DEMO_INDENTER,
            at_mm=DEMO_AT_MM,
        ).execute(console)


@dataclass
class StageClock:
    """Times the stages of a job and says which one runs."""

    console: Console
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str, *, spinner: bool = True) -> Iterator[None]:
        """Time a stage; with a spinner where the stage has no bar of its own."""
        started = time.perf_counter()
        if spinner:
            with self.console.status(name):
                yield
        else:
            yield
        self.seconds[name] = time.perf_counter() - started
        self.console.print(f"{name}: {self.seconds[name]:.1f} s", highlight=False)


def _print_summary(console: Console, values: dict, clock: StageClock) -> None:
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
    console.print(f"{sum(clock.seconds.values()):.0f} s in all", highlight=False)
