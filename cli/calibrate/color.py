# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate color``: real captures in, a profile with a colour model out."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from tyro.conf import Positional

from taccel_lab.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rich.console import Console

    from taccel_lab.calibration.capture import CaptureSet, ContactCircle
    from taccel_lab.calibration.color.result import ColorCalibration
    from taccel_lab.calibration.result import Remark
    from taccel_lab.calibration.surfaces import PressSurface
    from taccel_lab.calibration.surfaces.between import SharedLaw
    from taccel_lab.profile import SensorProfile

ASKED_ELSEWHERE = frozenset({"sensor_unknown"})
"""Findings of the check that the calibration says in its own words."""


@dataclass(frozen=True)
class CalibrateColor:
    """Fit the pixel-to-colour model to captured ball presses and write a profile.

    Every press is simulated to get the gel's surface under it; the model then learns the colour
    of each pixel from position, normal and displacement. Figures are of presses that were chosen
    before any image was read, and are looked at when the model is frozen. Simulations are kept, so
    that a second run takes the fit only.
    """

    captures: Positional[Path]
    """Capture folder with captures.toml (docs/captures.md), or a Taxim dataPack.npz."""
    out: Path
    """Profile folder to write."""
    base: Path | None = None
    """Profile of the designed sensor to extend; the catalogue's design of the sensor, turned as the
    images are, when left out. A sensor that the catalogue does not know is taken as a flat pad."""
    report: Path | None = None
    """Folder of the report; <out>_report when left out."""
    sensor: str | None = None
    """Sensor of the catalogue; the captures' own when left out."""
    set: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE")] = field(default=())
    """Dimensions of the gel that differ from the catalogue's, such as thickness_mm=2.5; not with
    --base."""
    holdout_every: int = 4
    """One press in this many is held out to score the result, chosen by position and by the hash
    of the names; 0 holds none out. [split] in captures.toml takes precedence."""
    circles: Literal["fused", "labels", "detected"] = "fused"
    """Contact circles to start from: those given, those found in the images, or the better estimate
    from both. A press without a given circle takes the one found. Held-out presses take no part:
    their given circles alone place them for the figures, or half of their pixels."""
    register: bool = True
    """Read the circles again with the colours of the other fitted presses; needs 8 of them."""
    surface: Literal["simulated", "each", "cap", "hertz"] = "simulated"
    """Gel surface under a press: the simulation of the presses that span all others, from which the
    others are read where one law holds; the simulation of each; or a closed form."""
    cache: bool = True
    """Keep contacts and simulated presses in the user's cache folder, and take what is there."""
    drift: Literal["auto", "on", "off"] = "auto"
    """Take the drift of the light off each frame: on for cameras with automatic white balance;
    auto compares both on left-out presses."""
    loss: Literal["huber", "l1", "ssim"] = "huber"
    """Loss of the fit: nearly L1 and smooth, L1, or the first with structural similarity."""
    position_bands: int = 0
    """Bands of the positional encoding: sines and cosines of the pixel's place for light that
    changes within parts of the image. 0 to 8; 0 gives the network the place alone."""
    steps: int = 2000
    """Optimiser steps of the fit."""
    batch_pixels: int = 1024
    """Pixels in each step; the time of a fit is proportional to them."""
    validation_every: int = 0
    """One fitted press in this many is kept back to stop the fit early; 0 keeps none back."""
    ensemble: int = 3
    """Fits that each leave some of the fitted presses out: they name captures that are off, and
    their spread says how sure the model is; 0 skips them."""
    table: bool = True
    """Fit Taxim's table too: the report shows its figures, and the table is written beside it, as
    polycalib.npz, for `taccel-lab export --to taxim --table`."""
    seed: int = 0
    """Seed of the pixel draw, the initial weights and the batches."""
    json: bool = False
    """Print the figures as JSON instead of a table."""

    def run(self) -> None:
        import warp as wp
        from rich.console import Console

        from taccel_lab.calibration.check.block_findings import refusing_with
        from taccel_lab.calibration.color.fit import ColorPlan, HeldoutSet, calibrate_color
        from taccel_lab.calibration.color.options import ColorFitOptions
        from taccel_lab.calibration.color.report import color_page
        from taccel_lab.cli.calibrate.base import report_folder, require_outputs, write_results
        from taccel_lab.cli.calibrate.contacts import contact_circles
        from taccel_lab.cli.console import print_json
        from taccel_lab.cli.progress import count_progress, fit_progress

        wp.config.log_level = wp.LOG_ERROR  # no driver, no GPU: none is needed here
        console = Console(stderr=True)
        report = report_folder(self.out, self.report)
        require_outputs(self.out, report)
        if self.ensemble == 1 or self.ensemble < 0:
            raise InputError(f"ensemble must be 0 or at least 2, got {self.ensemble}")
        options = ColorFitOptions(
            steps=self.steps,
            batch_pixels=self.batch_pixels,
            seed=self.seed,
            loss=self.loss,
            validation_every=self.validation_every,
            position_bands=self.position_bands,
        )
        captures, base, remarks = self._captures(console)
        split = captures.split(self.holdout_every)
        with refusing_with(remarks):
            training, circles, left_out = contact_circles(
                captures.only(split.train), self.circles, console, cache=self.cache
            )
        surfaces = Surfaces(self.surface, base, self.cache)
        with count_progress(console, "simulating the presses") as progress:
            simulated = surfaces(training, circles, progress)
        with fit_progress(console, "fitting the colour model") as progress:
            result = calibrate_color(
                training,
                circles,
                simulated,
                HeldoutSet.of(captures, split, surfaces),
                options=options,
                plan=ColorPlan(
                    drift=self.drift,
                    register=self.register,
                    folds=min(self.ensemble, len(training.presses)),
                    table=self.table,
                ),
                remarks=(*remarks, *left_out),
                progress=progress,
                stage=lambda text: console.print(text, highlight=False),
            )
        write_results(result, color_page(result), base, self.out, report, console)
        if self.json:
            print_json({"profile": str(self.out), "color": result.figures()})
        else:
            _print_figures(Console(), result)

    def _captures(self, console: Console) -> tuple[CaptureSet, SensorProfile, list[Remark]]:
        """The presses, the designed sensor with their camera, and what is weak or assumed; what
        cannot be used is refused with all reasons."""
        from taccel_lab.cad.parameters import parse_overrides
        from taccel_lab.calibration.base_profile import (
            base_profile,
            lost_blocks,
            on_grid,
            presses_on_camera,
        )
        from taccel_lab.calibration.capture import load_capture_folder
        from taccel_lab.calibration.check.block_findings import capture_findings
        from taccel_lab.calibration.surfaces.design import fitted_design
        from taccel_lab.cli.progress import stage_progress
        from taccel_lab.sensors.registry import sensor_family

        folder = load_capture_folder(self.captures)
        if self.sensor is not None and self.sensor != folder.sensor:
            raise InputError(
                f"{folder.source} was captured with sensor {folder.sensor!r}, not {self.sensor!r}"
            )
        if self.base is not None and self.set:
            raise InputError("--set changes the catalogue's design and cannot go with --base")
        overrides = parse_overrides(self.set)
        sensor_family(folder.sensor)
        base = None if self.base is None else base_profile(self.base, folder)
        fault, captures, lost = None, None, []
        try:
            if base is None:
                captures = folder.ball_presses()
            else:
                given = base
                captures, base = presses_on_camera(folder, given)
                lost = lost_blocks(given, base)
        except InputError as error:
            fault = error
        with stage_progress(console) as progress:
            found = capture_findings(folder, "color", progress)
        findings = [finding for finding in found if finding.code not in ASKED_ELSEWHERE]
        if captures is None:
            also = [f"- {finding.message}" for finding in findings]
            heading = ["the captures have more faults:"] if also else []
            raise InputError("\n".join([str(fault), *heading, *also]))
        if base is not None:
            return captures, base, [*lost, *findings]
        design = fitted_design(captures.sensor, captures.grid, overrides)
        base = on_grid(design.profile, captures.grid, captures.provenance)
        return captures, base, [*findings, *design.remarks]


@dataclass(frozen=True)
class Surfaces:
    """Surfaces of presses in circles; one law of simulated presses serves later ones too."""

    kind: Literal["simulated", "each", "cap", "hertz"]
    base: SensorProfile
    cache: bool = True
    laws: dict[float, SharedLaw] = field(default_factory=dict)

    def __call__(
        self,
        captures: CaptureSet,
        circles: Sequence[ContactCircle],
        progress: Callable[[int, int], None] | None = None,
    ) -> list[PressSurface]:
        if self.kind in ("simulated", "each"):
            from taccel_lab.calibration.simulate import simulate_presses

            return simulate_presses(
                captures,
                circles,
                self.base,
                cache=self.cache,
                share=self.kind == "simulated",
                laws=self.laws,
                progress=progress,
            )
        from taccel_lab.calibration.surfaces import analytic_surface

        return [
            analytic_surface(
                circle,
                captures.grid,
                press.radius_mm or captures.ball_radius_mm,
                skirt=self.kind,
            )
            for press, circle in zip(captures.presses, circles, strict=True)
        ]


def _print_figures(console: Console, result: ColorCalibration) -> None:
    from rich.table import Table

    from taccel_lab.calibration.color.report import FIGURES, figure_columns

    columns = figure_columns(result)
    if not result.has_scores:
        console.print("no press was held out, so there are no figures of held-out presses")
    if not columns:
        return
    table = Table(
        "figure",
        *columns,
        title=f"{len(result.heldout) + len(result.failures)} held-out presses, "
        f"{len(result.failures)} failed, {len(result.train_names)} fitted",
        title_justify="left",
    )
    for key, label in FIGURES:
        style = ".4f" if key == "crop_ssim" else ".2f"
        table.add_row(label, *(format(scores[key], style) for scores in columns.values()))
    console.print(table)
    console.print(
        f"noise floor (captures against background beyond 3 r): {result.noise_floor_l1:.2f} "
        f"levels; fit took {result.fit.seconds:.0f} s",
        highlight=False,
    )
