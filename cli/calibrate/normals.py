# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate normals``: ball presses in, a profile that reads surfaces out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.calibration.capture import CaptureSet, ContactCircle
    from taccel_lab.calibration.normals.fit import NormalCalibration
    from taccel_lab.calibration.surfaces import PressSurface
    from taccel_lab.profile import SensorProfile


@dataclass(frozen=True)
class CalibrateNormals:
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
    holdout_every: int = 4
    """One press in this many is held out to score the result, chosen by position and by the hash
    of the names; 0 holds none out. [split] in captures.toml takes precedence."""
    circles: Literal["fused", "labels", "detected"] = "fused"
    """Contact circles to train with: those given, those found in the images, or the better estimate
    from both. A press without a given circle takes the one found. Held-out presses are judged in
    their given circles."""
    skirt: Literal["hertz", "simulated", "none"] = "hertz"
    """Normals of the gel that sinks around a contact: a closed form; the simulation of every press
    (minutes), which absolute depths need most; or none, which leaves those pixels out."""
    drift: Literal["auto", "on", "off"] = "auto"
    """Bring the light of each frame to the background's first; auto does it where that takes away
    at least a quarter of the difference between untouched gel and background."""
    position_bands: int = 0
    """Bands of the positional encoding among the features: sines and cosines of the pixel's place.
    0 to 8; 0 gives the networks the place alone."""
    steps: int = 1000
    """Optimiser steps; each network keeps its best ones."""
    seed: int = 0
    """Seed of the pixel draw, the initial weights and the batches."""
    json: bool = False
    """Print the figures as JSON instead of a summary."""

    def run(self) -> None:
        from dataclasses import replace

        import warp as wp
        from rich.console import Console

        from taccel_lab.calibration.base_profile import lost_blocks, presses_on_camera
        from taccel_lab.calibration.check.block_findings import (
            capture_findings,
            joined,
            refusing_with,
        )
        from taccel_lab.calibration.normals.fit import calibrate_normals
        from taccel_lab.calibration.normals.network_fit import InverseFitOptions
        from taccel_lab.calibration.normals.report import normals_page
        from taccel_lab.calibration.normals.samples import Scene
        from taccel_lab.cli.calibrate.base import open_job
        from taccel_lab.cli.calibrate.contacts import contact_circles
        from taccel_lab.cli.console import print_json
        from taccel_lab.cli.progress import fit_progress, stage_progress
        from taccel_lab.signals.rest_surface import rest_surface

        wp.config.log_level = wp.LOG_ERROR  # no driver, no GPU: none is needed here
        options = InverseFitOptions(
            steps=self.steps, seed=self.seed, position_bands=self.position_bands
        )
        job = open_job(self.captures, self.out, self.base, self.report)
        captures, base = presses_on_camera(job.folder, job.base)
        split = captures.split(self.holdout_every)
        heldout = captures.only(split.heldout) if split.heldout else None
        lost = lost_blocks(job.base, base)
        with stage_progress(job.console) as progress:
            findings = capture_findings(job.folder, "normals", progress)
        rest = rest_surface(base.mesh, captures.grid)
        with refusing_with(findings):
            captures, circles, left_out = contact_circles(
                captures.only(split.train), self.circles, job.console
            )
        surfaces = self._surfaces(captures, circles, base, job.console)
        with fit_progress(job.console, "fitting the inverse model") as progress:
            result = calibrate_normals(
                captures,
                circles,
                surfaces,
                heldout,
                split=split,
                rest_normals=None if rest.is_flat else rest.normals,
                options=options,
                drift=self.drift,
                circle_source=self.circles,
                progress=progress,
            )
        result = replace(result, remarks=(*lost, *joined(findings, (*left_out, *result.remarks))))
        scene = Scene(
            captures.background,
            captures.grid,
            captures.ball_radius_mm,
            captures.mask,
            None if rest.is_flat else rest.normals,
        )
        replace(job, base=base).write(result, normals_page(result, scene))
        if self.json:
            print_json({"profile": str(self.out), "normals": result.figures()})
        else:
            _print_summary(Console(), result)

    def _surfaces(
        self,
        captures: CaptureSet,
        circles: list[ContactCircle],
        base: SensorProfile,
        console: Console,
    ) -> list[PressSurface] | None:
        if self.skirt == "none":
            return None
        if self.skirt == "simulated":
            from taccel_lab.calibration.simulate import simulate_presses
            from taccel_lab.cli.progress import count_progress

            with count_progress(console, "simulating the presses") as progress:
                return simulate_presses(captures, circles, base, cache=True, progress=progress)
        from taccel_lab.calibration.normals.skirt import hertz_skirts

        return hertz_skirts(captures, circles)


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
