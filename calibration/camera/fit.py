# SPDX-License-Identifier: Apache-2.0
"""Calibration of a sensor's camera from the boards of a capture folder."""

from __future__ import annotations

from taccel_lab.calibration.camera import remarks
from taccel_lab.calibration.camera.board import hashes_by_name
from taccel_lab.calibration.camera.board_on_gel import OnGel, fit_on_gel
from taccel_lab.calibration.camera.find_boards import Detections, detect_views
from taccel_lab.calibration.camera.intrinsics import (
    Intrinsics,
    calibrate_intrinsics,
    require_choices,
)
from taccel_lab.calibration.camera.options import CameraOptions
from taccel_lab.calibration.camera.result import (
    CameraCalibration,
    origin_px,
    stated_scale_remarks,
    tactile_size,
)
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.camera.refraction import OUTSIDE_INDEX, FlatMedia
from taccel_lab.errors import InputError
from taccel_lab.profile import SensorProfile
from taccel_lab.progress import Progress, silent
from taccel_lab.report.remark import Remark


def calibrate_camera(
    folder: CaptureFolder,
    base: SensorProfile,
    options: CameraOptions = CameraOptions(),
    progress: Progress = silent,
) -> CameraCalibration:
    """Fit everything that the boards of a capture folder give.

    Args:
        folder: Its ``boards``: those with ``on_gel`` give scale and pose, the others the lens.
        base: The designed sensor: its pixel grid's middle, and what lies before the gel.

    Raises:
        InputError: No boards, none found, or too few views; says what to add.
    """
    require_choices(options.models, options.folds)
    air = [board for board in folder.boards if not board.entry.on_gel]
    gel = [board for board in folder.boards if board.entry.on_gel]
    if not folder.boards:
        raise InputError(
            f"{folder.source} names no boards; give [[boards]] with kind, columns, rows and "
            "images (docs/calibration_camera.md)"
        )
    shown = detect_views(air, "finding boards", progress)
    laid = detect_views(gel, "finding boards on the gel", progress)
    intrinsics = on_gel = None
    if air:
        intrinsics = calibrate_intrinsics(
            shown.views,
            models=options.models,
            folds=options.folds,
            refused=shown.refused,
            progress=progress,
        )
    if gel:
        size = laid.views[0].size_px
        on_gel = fit_on_gel(
            laid.views,
            center_px=origin_px(base, size),
            tactile_px=tactile_size(base, size),
            intrinsics=intrinsics,
            media=_media_before_gel(base),
        )
    detections = Detections(shown.views + laid.views, shown.refused + laid.refused)
    return CameraCalibration(
        folder.source,
        intrinsics,
        on_gel,
        detections,
        hashes_by_name(detections.views),
        folder.provenance,
        tuple(_remarks(detections, intrinsics, on_gel, folder)),
    )


def _media_before_gel(profile: SensorProfile) -> FlatMedia | None:
    """Window and gel before the contact face z = 0, seen from the air; None where they are unknown
    or domed."""
    optics, window = profile.optics, profile.window
    if optics is None or (window is not None and window.shape != "plate"):
        return None
    back = -profile.gel.thickness_mm
    planes, indices = [back], [OUTSIDE_INDEX, optics.gel_refractive_index]
    if window is not None:
        planes.insert(0, back - window.thickness_mm)
        indices.insert(1, window.refractive_index)
    return FlatMedia(tuple(planes), tuple(indices))


def _remarks(
    detections: Detections,
    intrinsics: Intrinsics | None,
    on_gel: OnGel | None,
    folder: CaptureFolder,
) -> list[Remark]:
    said = []
    if detections.refused:
        count, total = len(detections.refused), len(detections.refused) + len(detections.views)
        reasons = "; ".join(detections.refused[:3]) + ("; ..." if count > 3 else "")
        said.append(
            remarks.BOARDS_REFUSED(
                count=count, total=total, reasons=reasons, grave=count * 3 > total
            )
        )
    if intrinsics is not None:
        said += intrinsics.remarks
    if on_gel is not None:
        said += on_gel.remarks
        raw, grid = on_gel.views[0].size_px, on_gel.grid
        if folder.background is not None:
            high, wide = folder.background.image().shape[:2]
            if (wide, high) != raw:
                said.append(
                    remarks.SIZE_DIFFERS(
                        width=raw[0], height=raw[1], background_width=wide, background_height=high
                    )
                )
        if (grid.width_px, grid.height_px) == raw:
            frame = on_gel.frame
            measured = {"x": frame.mm_per_px_x, "y": frame.mm_per_px_y}
            said += stated_scale_remarks(folder, measured)
    return said
