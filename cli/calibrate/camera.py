# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate camera``: boards in, lens, scale and pose of the camera out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.calibration.camera.result import CameraCalibration


@dataclass(frozen=True)
class CalibrateCamera:
    """Fit the camera to views of a calibration board and write a profile.

    Boards held before the camera give the lens (optics block); boards that lie on the gel or are
    pressed into it give mm/px in x and y and the pose of the gel (camera block). Chessboards,
    ChArUco boards, boards of dots and of pins are found, also where points are missing.
    """

    captures: Positional[Path]
    """Capture folder whose captures.toml names [[boards]] (docs/calibration_camera.md)."""
    out: Path
    """Profile folder to write."""
    base: Path | None = None
    """Profile to extend; the catalogue's design of the captures' sensor when left out."""
    report: Path | None = None
    """Folder for the report (HTML, pictures, JSON); <out>_report when left out."""
    maps: Path | None = None
    """File (.npz) for rectification maps: map_u_px and map_v_px for cv2.remap, the pixels that the
    board measured, and the grid's scale."""
    models: tuple[Literal["k1", "fisheye", "pinhole", "rational"], ...] = (
        "k1",
        "fisheye",
        "pinhole",
        "rational",
    )
    """Lenses to choose from by held-out error: one radial term, fisheye (4 coefficients), pinhole
    (5) or rational (8)."""
    folds: int = 5
    """Parts that the views are split into to score the lenses."""
    refraction: Literal["auto", "media", "none"] = "auto"
    """Pose of the gel through the profile's window and gel (media) or with straight sight lines
    (none); auto takes them where the profile describes flat ones, unless the board clearly speaks
    against it. Needs views and a board on the gel; the report gives both poses."""
    json: bool = False
    """Print the figures as JSON instead of a summary."""

    def run(self) -> None:
        from rich.console import Console

        from taccel_lab.calibration.camera.fit import CameraOptions, calibrate_camera
        from taccel_lab.calibration.camera.report import camera_page
        from taccel_lab.cli.calibrate.base import open_job
        from taccel_lab.cli.console import print_json
        from taccel_lab.cli.progress import stage_progress

        if self.maps is not None:
            _require_file(self.maps)
        job = open_job(self.captures, self.out, self.base, self.report)
        folder = job.folder
        with stage_progress(job.console) as progress:
            options = CameraOptions(self.models, self.folds, self.refraction)
            result = calibrate_camera(folder, job.base, options, progress)
        job.write(result, camera_page(result, folder))
        if self.maps is not None:
            result.maps().save(self.maps)
            job.console.print(f"wrote {self.maps}", highlight=False)
        if self.json:
            print_json({"profile": str(self.out), "camera": result.figures()})
        else:
            _print_summary(Console(), result)


def _require_file(path: Path) -> None:
    """Refuse an unusable file name before any long work."""
    from taccel_lab.errors import InputError

    if path.suffix != ".npz" or path.is_dir():
        raise InputError(f"--maps writes one .npz file, got {path}")


def _print_summary(console: Console, result: CameraCalibration) -> None:
    if result.intrinsics is not None:
        found = result.intrinsics
        console.print(
            f"{found.lens.name} lens from {len(found.views)} views: held-out reprojection "
            f"{found.chosen.heldout_all_px:.3f} px (root mean square, {len(found.outliers)} "
            f"outliers counted; {found.chosen.heldout_robust_px:.3f} px robust, "
            f"{found.chosen.heldout_half_px:.3f} px with half of each held-out board)",
            highlight=False,
        )
        for name, value, sigma in zip(
            found.lens.parameter_names,
            found.parameters,
            found.chosen.fit.sigma,
            strict=True,
        ):
            console.print(f"  {name} = {value:.5g} ± {sigma:.2g}", highlight=False)
    if result.on_gel is not None:
        frame = result.on_gel.frame
        console.print(
            f"on the gel: {frame.mm_per_px_x} along x, {frame.mm_per_px_y} along y",
            highlight=False,
        )
