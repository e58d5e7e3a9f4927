# SPDX-License-Identifier: Apache-2.0
"""``taccel-lab calibrate camera``: boards in, lens, scale and pose of the camera out."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from taccel_lab.calibration.camera.options import CameraOptions
from taccel_lab.cli.calibrate.base import BlockCommand, Fitted

if TYPE_CHECKING:
    from rich.console import Console

    from taccel_lab.calibration.camera.result import CameraCalibration
    from taccel_lab.calibration.capture.folder import CaptureFolder
    from taccel_lab.progress import Progress


@dataclass(frozen=True)
class CalibrateCamera(BlockCommand, CameraOptions):
    """Fit the camera to views of a calibration board and write a profile.

    Boards held before the camera give the lens (optics block); boards that lie on the gel or are
    pressed into it give mm/px in x and y and the pose of the gel (camera block). Chessboards,
    ChArUco boards, boards of dots and of pins are found, also where points are missing.
    """

    captures: Positional[Path]
    """Capture folder whose captures.toml names [[boards]] (docs/calibration_camera.md)."""
    maps: Path | None = None
    """File (.npz) for rectification maps: map_u_px and map_v_px for cv2.remap, the pixels that the
    board measured, and the grid's scale."""

    def check(self) -> None:
        """Refuse a file of maps that cannot be written."""
        if self.maps is not None:
            _require_file(self.maps)

    def fit(self, folder: CaptureFolder, progress: Progress) -> Fitted:
        """Fit lens, scale and pose."""
        from taccel_lab.calibration.camera.fit import calibrate_camera
        from taccel_lab.calibration.camera.report import camera_page

        base = self.profile_to_extend(folder)
        result = calibrate_camera(folder, base, self, progress)
        files = {} if self.maps is None else {self.maps: lambda path: result.maps().save(path)}
        page = camera_page(result, folder)
        return Fitted("camera", base, result, page, partial(_print_summary, result), files)


def _require_file(path: Path) -> None:
    """Refuse an unusable file name before any long work."""
    from taccel_lab.errors import InputError

    if path.suffix != ".npz" or path.is_dir():
        raise InputError(f"--maps writes one .npz file, got {path}")


def _print_summary(result: CameraCalibration, console: Console) -> None:
    if result.intrinsics is not None:
        found = result.intrinsics
        console.print(
            f"{found.lens.name} lens from {len(found.views)} views: held-out reprojection "
            f"{found.chosen.heldout_all_px:.3f} px (root mean square, {len(found.outliers)} "
            f"outliers counted; {found.chosen.heldout_robust_px:.3f} px robust, "
            f"{found.chosen.heldout_half_px:.3f} px with half of each held-out board)",
        )
        for name, value, sigma in zip(
            found.lens.parameter_names,
            found.parameters,
            found.chosen.fit.sigma,
            strict=True,
        ):
            console.print(f"  {name} = {value:.5g} ± {sigma:.2g}")
    if result.on_gel is not None:
        frame = result.on_gel.frame
        console.print(
            f"on the gel: {frame.mm_per_px_x} along x, {frame.mm_per_px_y} along y",
        )
