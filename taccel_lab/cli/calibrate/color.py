# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate color``: real captures in, a profile with a colour model out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from taccel_lab.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from calibration.capture import CaptureSet, ContactCircle
    from calibration.color_calibration import ColorCalibration
    from calibration.surfaces import PressSurface
    from taccel_lab.profile import SensorProfile


@dataclass(frozen=True)
class CalibrateColor:
    """Fit the pixel-to-colour model to captured ball presses and write a profile.

    Every press is simulated to get the gel's surface under it; the model then learns the colour
    of each pixel from position, normal and displacement. Figures are of held-out presses.
    """

    captures: Positional[Path]
    """Capture folder with captures.toml (docs/captures.md), or a Taxim dataPack.npz."""
    out: Path
    """Profile folder to write."""
    base: Path | None = None
    """Profile of the designed sensor to extend; the catalogue's design of the sensor when left
    out."""
    sensor: str | None = None
    """Sensor of the catalogue; the captures' own when left out."""
    holdout_every: int = 4
    """Every how-manieth press is held out for the figures; 0 holds none out."""
    circles: Literal["fused", "labels", "detected"] = "fused"
    """Contact circles to simulate: those given, those found in the images, or the better estimate
    from both. A press without a given circle takes the one found. Figures always refer to the
    given circles where there are any."""
    surface: Literal["simulated", "cap", "hertz"] = "simulated"
    """Gel surface under a press: the simulation, or a closed-form baseline for comparison."""
    steps: int = 2000
    """Optimiser steps of the fit."""
    folds: int = 3
    """Folds of the cross-validation over the training presses; 0 skips it."""
    seed: int = 0
    """Seed of the pixel draw, the initial weights and the batches."""
    json: bool = False
    """Print the figures as JSON instead of a table."""

    def run(self) -> None:
        from rich.console import Console

        from calibration.capture import load_captures
        from calibration.color_calibration import calibrate_color
        from calibration.estimators.color import ColorFitOptions
        from sensors.profile import catalogue_profile
        from taccel_lab.cli.console import print_json
        from taccel_lab.cli.progress import fit_progress
        from taccel_lab.profile import load_profile, require_profile_folder, save_profile

        console = Console(stderr=True)
        require_profile_folder(self.out)
        if self.folds == 1 or self.folds < 0:
            raise InputError(f"folds must be 0 or at least 2, got {self.folds}")
        options = ColorFitOptions(steps=self.steps, seed=self.seed)
        captures = load_captures(self.captures)
        captures.split(self.holdout_every)
        if self.sensor is not None and self.sensor != captures.sensor:
            raise InputError(
                f"{captures.source} was captured with sensor {captures.sensor!r}, not "
                f"{self.sensor!r}"
            )
        if self.base is not None:
            base = load_profile(self.base)
        else:
            base = catalogue_profile(captures.sensor)
        base = with_camera_of(base, captures)
        circles = _contact_circles(captures, self.circles, console)
        surfaces = self._surfaces(captures, circles, base, console)
        with fit_progress(console, "fitting the colour model") as progress:
            result = calibrate_color(
                captures,
                circles,
                surfaces,
                holdout_every=self.holdout_every,
                options=options,
                folds=self.folds,
                progress=progress,
            )
        save_profile(result.apply_to(base), self.out)
        if self.json:
            print_json({"profile": str(self.out), "color": result.figures()})
        else:
            _print_figures(Console(), result)
            console.print(f"wrote {self.out}", highlight=False)

    def _surfaces(
        self,
        captures: CaptureSet,
        circles: list[ContactCircle],
        base: SensorProfile,
        console: Console,
    ) -> list[PressSurface]:
        if self.surface == "simulated":
            from calibration.simulate import simulate_presses
            from taccel_lab.cli.progress import count_progress

            with count_progress(console, "simulating the presses") as progress:
                return simulate_presses(captures, circles, base, progress=progress)
        from calibration.surfaces import analytic_surface

        return [
            analytic_surface(circle, captures.grid, captures.ball_radius_mm, skirt=self.surface)
            for circle in circles
        ]


def with_camera_of(profile: SensorProfile, captures: CaptureSet) -> SensorProfile:
    """The profile with the captures' image size and scale."""
    from taccel_lab.profile import CameraBlock, Provenance

    if profile.camera.grid() == captures.grid:
        return profile
    return profile.without("background", "color").with_block(
        CameraBlock.from_grid(
            captures.grid,
            Provenance(
                kind="published",
                method="image size and scale of the captures; the image centre lies over the apex",
                source=captures.provenance.get("source", captures.source),
            ),
        )
    )


def _contact_circles(
    captures: CaptureSet, which: Literal["fused", "labels", "detected"], console: Console
) -> list[ContactCircle]:
    """Circle of every press; detection runs on all of them, so that an empty frame is refused."""
    from calibration.targets import choose_circles, compare_with_labels, resolve_contacts

    with console.status("finding the contact circles"):
        found = resolve_contacts(captures)
    agreement = compare_with_labels(captures, found)
    if agreement is not None:
        console.print(
            f"found circles against {agreement.count} labels, median and 90th percentile: centre "
            f"{agreement.center_median_px:.1f} and {agreement.center_p90_px:.1f} px, radius "
            f"{agreement.radius_median_px:.1f} and {agreement.radius_p90_px:.1f} px",
            highlight=False,
        )
    return choose_circles(captures, found, which)


def _print_figures(console: Console, result: ColorCalibration) -> None:
    from rich.table import Table

    from calibration.evaluate import mean_score

    if not result.heldout:
        console.print("no press was held out, so there are no figures")
        return
    columns = {
        "rendered": mean_score([item.score for item in result.heldout]),
        "drift corrected": mean_score([item.score_drift_corrected for item in result.heldout]),
        "background only": mean_score([item.background_only for item in result.heldout]),
    }
    table = Table(
        "figure",
        *columns,
        title=f"{len(result.heldout)} held-out presses, {len(result.train_names)} fitted",
        title_justify="left",
    )
    for key, label, style in (
        ("crop_psnr_db", "PSNR in the 1.6 r crop [dB]", ".2f"),
        ("crop_ssim", "SSIM in the crop", ".4f"),
        ("disc_l1", "L1 in the contact disc [levels]", ".2f"),
        ("crop_l1", "L1 in the crop [levels]", ".2f"),
        ("full_l1", "L1 over the image [levels]", ".2f"),
    ):
        table.add_row(label, *(format(scores[key], style) for scores in columns.values()))
    console.print(table)
    console.print(
        f"noise floor (captures against background beyond 3 r): {result.noise_floor_l1:.2f} "
        f"levels; fit took {result.fit.seconds:.0f} s",
        highlight=False,
    )
    if result.cross_validated_l1:
        values = list(result.cross_validated_l1.values())
        console.print(
            f"cross-validated L1 in the disc: {sum(values) / len(values):.2f} levels, worst press "
            f"{max(values):.2f}",
            highlight=False,
        )
