# SPDX-License-Identifier: Apache-2.0
"""Calibration of a sensor's camera from the boards of a capture folder."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from taccel_lab.calibration.camera.blocks import (
    camera_block,
    optics_block,
    tactile_size,
    with_camera_block,
)
from taccel_lab.calibration.camera.board import BoardView
from taccel_lab.calibration.camera.bundle_search import MIN_VIEWS
from taccel_lab.calibration.camera.detect import Detections, detect_views
from taccel_lab.calibration.camera.intrinsics import (
    Intrinsics,
    calibrate_intrinsics,
    require_choices,
)
from taccel_lab.calibration.camera.lens import LENSES
from taccel_lab.calibration.camera.media import profile_media
from taccel_lab.calibration.camera.on_gel import OnGel, fit_on_gel
from taccel_lab.calibration.camera.rectification import RectificationMaps, gel_maps, lens_maps
from taccel_lab.calibration.camera.stated_scale import stated_scale_remarks
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.result import Remark, Severity
from taccel_lab.errors import InputError
from taccel_lab.profile import SensorProfile

Progress = Callable[[str, int, int], None]
"""Told what is going on, how many steps are done, and of how many."""
Refraction = Literal["auto", "media", "none"]


@dataclass(frozen=True)
class CameraCalibration:
    """Lens, pose and scale, as far as the boards give them."""

    source: str
    intrinsics: Intrinsics | None
    on_gel: OnGel | None
    detections: Detections
    inputs: dict[str, str]
    provenance: dict[str, str]
    remarks: tuple[Remark, ...]

    def figures(self) -> dict[str, Any]:
        """Everything measured, ready for JSON."""
        found: dict[str, Any] = {
            "views_found": len(self.detections.views),
            "views_refused": list(self.detections.refused),
        }
        if self.intrinsics is not None:
            found["intrinsics"] = _intrinsics_figures(self.intrinsics)
        if self.on_gel is not None:
            found["on_gel"] = _on_gel_figures(self.on_gel)
        return found

    def maps(self) -> RectificationMaps:
        """Maps to the gel's pixel grid, or, without a board on the gel, of the lens alone."""
        if self.on_gel is not None:
            return gel_maps(self.on_gel)
        assert self.intrinsics is not None
        return lens_maps(self.intrinsics)

    def apply_to(self, profile: SensorProfile) -> SensorProfile:
        """``profile`` with the camera block (boards on the gel) and the optics block (views)."""
        if self.on_gel is not None:
            profile = with_camera_block(profile, camera_block(self))
        if self.intrinsics is not None:
            profile = profile.with_block(optics_block(self, profile))
        return profile


def calibrate_camera(
    folder: CaptureFolder,
    profile: SensorProfile,
    *,
    models: Sequence[str] = tuple(LENSES),
    folds: int = 5,
    refraction: Refraction = "auto",
    progress: Progress | None = None,
) -> CameraCalibration:
    """Fit everything that the boards of a capture folder give.

    Args:
        folder: Its ``boards``: those with ``on_gel`` give scale and pose, the others the lens.
        profile: Of the designed sensor: its pixel grid's middle, and what lies before the gel.
        models: Lenses to choose from.
        folds: Of the cross-validation over views.
        refraction: ``media`` fits the pose through the profile's window and gel, ``none`` in air;
            ``auto`` through them where the profile describes them and the board does not clearly
            speak against it.

    Raises:
        InputError: No boards, none found, or too few views; says what to add.
    """
    require_choices(models, folds)
    air = [board for board in folder.boards if not board.entry.on_gel]
    gel = [board for board in folder.boards if board.entry.on_gel]
    if not folder.boards:
        raise InputError(
            f"{folder.source} names no boards; give [[boards]] with kind, columns, rows and "
            "images (docs/calibration_camera.md)"
        )

    def stage(name: str) -> Callable[[int, int], None]:
        return lambda done, total: progress(name, done, total) if progress is not None else None

    shown = detect_views(air, progress=stage("finding boards")) if air else Detections(())
    laid = detect_views(gel, progress=stage("finding boards on the gel")) if gel else Detections(())
    intrinsics = None
    if air:
        _require_views(shown)
        intrinsics = calibrate_intrinsics(
            shown.views, models=models, folds=folds, progress=stage("fitting the lens")
        )
    on_gel = None
    if gel:
        media = None
        if intrinsics is not None and (
            refraction == "media" or (refraction == "auto" and _has_flat_media(profile))
        ):
            media = profile_media(profile)
        on_gel = fit_on_gel(
            laid.views,
            center_px=_middle(profile, laid.views[0]),
            tactile_px=tactile_size(profile, laid.views[0].size_px),
            intrinsics=intrinsics,
            media=media,
            media_if_better=refraction == "auto",
        )
    detections = Detections(
        shown.views + laid.views, shown.refused + laid.refused, shown.warnings + laid.warnings
    )
    return CameraCalibration(
        folder.source,
        intrinsics,
        on_gel,
        detections,
        _hashes(detections.views),
        folder.provenance,
        tuple(_remarks(detections, intrinsics, on_gel, folder)),
    )


def _require_views(shown: Detections) -> None:
    """Refuse fewer views than a lens needs, with what was wrong with the others."""
    if len(shown.views) >= MIN_VIEWS or not shown.refused:
        return
    reasons = "\n".join(shown.refused[:5])
    raise InputError(
        f"{len(shown.views)} views of the board are left, at least {MIN_VIEWS} are needed, better "
        f"20, from different sides and tilted by 20 to 45 degrees; not used:\n{reasons}"
    )


def _hashes(views: Sequence[BoardView]) -> dict[str, str]:
    """SHA-256 of each image by its name, with its folder where two are named alike."""
    names = Counter(view.name for view in views)
    return {
        view.name if names[view.name] == 1 else "/".join(Path(view.source).parts[-2:]): view.sha256
        for view in views
        if view.sha256
    }


def _has_flat_media(profile: SensorProfile) -> bool:
    window = profile.window
    return profile.optics is not None and (window is None or window.shape == "plate")


def _middle(profile: SensorProfile, view: BoardView) -> tuple[float, float] | None:
    """Where the profile has its gel frame's origin, if its image has the size of this one."""
    camera = profile.camera
    if (camera.width_px, camera.height_px) != view.size_px:
        return None
    return camera.center_u_px, camera.center_v_px


def _remarks(
    detections: Detections,
    intrinsics: Intrinsics | None,
    on_gel: OnGel | None,
    folder: CaptureFolder,
) -> list[Remark]:
    remarks = []
    if detections.refused:
        count, total = len(detections.refused), len(detections.refused) + len(detections.views)
        remarks.append(
            Remark(
                Severity.WARNING if count * 3 > total else Severity.INFO,
                "boards_refused",
                f"the board was not used in {count} of {total} images: "
                + "; ".join(detections.refused[:3])
                + ("; ..." if count > 3 else ""),
            )
        )
    for warning in detections.warnings:
        remarks.append(Remark(Severity.WARNING, "maybe_mirrored", warning))
    if intrinsics is not None:
        remarks += intrinsics.remarks
        if on_gel is None:
            remarks.append(
                Remark(
                    Severity.INFO,
                    "no_board_on_gel",
                    "no board lies on the gel (on_gel = true): the lens is calibrated; mm/px and "
                    "the camera's pose are those of the profile it was applied to",
                )
            )
    if on_gel is not None:
        remarks += on_gel.remarks
        if intrinsics is None:
            remarks.append(
                Remark(
                    Severity.INFO,
                    "no_views",
                    "no views of a board in air: the scale is calibrated; focal length and pose "
                    "of the camera stay as designed, one flat board cannot tell them apart",
                )
            )
        remarks += _size_remarks(on_gel, folder)
        if (on_gel.grid.width_px, on_gel.grid.height_px) == on_gel.views[0].size_px:
            frame = on_gel.frame
            measured = {"x": frame.mm_per_px_x, "y": frame.mm_per_px_y}
            remarks += stated_scale_remarks(folder, measured)
        size, raw = (on_gel.grid.width_px, on_gel.grid.height_px), on_gel.views[0].size_px
        if size != raw:
            remarks.append(
                Remark(
                    Severity.INFO,
                    "cropped",
                    f"the pixel grid is that of the rectified image of {size[0]}x{size[1]} px, cut "
                    f"out of {raw[0]}x{raw[1]} px as the profile says; --maps writes the maps",
                )
            )
    return remarks


def _size_remarks(on_gel: OnGel, folder: CaptureFolder) -> list[Remark]:
    if folder.background is None:
        return []
    height, width = folder.background.image().shape[:2]
    size = on_gel.views[0].size_px
    if (width, height) == size:
        return []
    return [
        Remark(
            Severity.ERROR,
            "size_differs",
            f"the board was seen in images of {size[0]}x{size[1]} px, the background has "
            f"{width}x{height} px: the scale holds for images of the board's size only",
        )
    ]


def _intrinsics_figures(found: Intrinsics) -> dict[str, Any]:
    fit, lens = found.chosen.fit, found.lens
    return {
        "model": lens.name,
        "image_px": list(found.size_px),
        "parameters": {
            name: {"value": float(value), "sigma": float(sigma)}
            for name, value, sigma in zip(
                lens.parameter_names, fit.parameters, fit.sigma, strict=True
            )
        },
        "fit_rms_px": fit.rms_px,
        "heldout_rms_px": found.chosen.heldout_all_px,
        "heldout_robust_rms_px": found.chosen.heldout_robust_px,
        "heldout_half_board_rms_px": found.chosen.heldout_half_px,
        "folds": found.folds,
        "views": len(found.views),
        "views_held_out": len(found.views) + len(found.outliers),
        "outlier_views": list(found.outliers),
        "coverage": found.coverage,
        "tilt_deg": list(found.tilt_deg),
        "models": {
            score.lens.name: {
                "fit_rms_px": score.fit.rms_px,
                "heldout_rms_px": score.heldout_all_px,
                "heldout_robust_rms_px": score.heldout_robust_px,
                "heldout_half_board_rms_px": score.heldout_half_px,
                "excess_mse_px2": score.excess,
                "excess_standard_error_px2": score.excess_error,
            }
            for score in found.scores
        },
    }


def _on_gel_figures(found: OnGel) -> dict[str, Any]:
    frame = found.frame
    figures: dict[str, Any] = {
        "model": found.fit.model.name,
        "image_px": list(found.views[0].size_px),
        "mm_per_px_x": {"value": frame.mm_per_px_x.value, "sigma": frame.mm_per_px_x.sigma},
        "mm_per_px_y": {"value": frame.mm_per_px_y.value, "sigma": frame.mm_per_px_y.sigma},
        "correlation": frame.correlation,
        "shear_deg": float(np.degrees(frame.shear)),
        "board_angle_deg": float(-np.degrees(frame.angle_rad)),
        "points": [len(view.index) for view in found.views],
        "points_on_board": [view.expected for view in found.views],
        "fit_rms_px": found.fit.rms_px,
        "heldout_rms_px": found.fit.heldout_px,
        "spline": None if found.fit.correction is None else found.fit.correction.smoothing,
        "scale_range": list(found.scale_range),
        "models": {
            fit.model.name: {"fit_rms_px": fit.rms_px, "heldout_rms_px": fit.heldout_px}
            for fit in found.fits
        },
    }
    for name, pose in (
        ("pose", found.pose),
        ("pose_in_air", found.pose_in_air),
        ("pose_refracted", found.pose_refracted),
    ):
        if pose is not None:
            figures[name] = {
                "position_mm": list(pose.position_mm),
                "position_sigma_mm": list(pose.position_sigma_mm),
                "rotation_xyzw": list(pose.rotation),
                "tilt_deg": pose.tilt_deg,
                "refracted": pose.refracted,
                "heldout_rms_px": pose.fit.heldout_px,
            }
    if found.pose_refracted is not None and found.pose_in_air is not None:
        moved = np.subtract(found.pose_refracted.position_mm, found.pose_in_air.position_mm)
        figures["refraction_moves_camera_mm"] = [float(v) for v in moved]
    return figures
