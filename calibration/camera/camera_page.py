# SPDX-License-Identifier: Apache-2.0
"""The report of a calibrated camera."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from taccel_lab.calibration.camera.pictures import (
    draw_on_gel,
    draw_rectified,
    draw_residuals,
    draw_views,
)
from taccel_lab.calibration.camera.result import CameraCalibration
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.report.page import Page, Picture, Table


def camera_page(result: CameraCalibration, folder: CaptureFolder) -> Page:
    """Describe a calibration; pictures read the images of ``folder`` when they are drawn."""
    tables: list[Table] = []
    pictures: list[Picture] = []
    if result.intrinsics is not None:
        tables += _lens_tables(result)
        pictures += [
            Picture(
                "views",
                partial(draw_views, result.intrinsics),
                "Left: every point of every view. Right: root mean square error of each view when "
                "the lens was fitted without it; the bar is the root mean square of all.",
            ),
            Picture(
                "residuals",
                partial(draw_residuals, result.intrinsics),
                "Seen minus projected points. A pattern that repeats from view to view is a lens "
                "that the model does not reach; random arrows are noise of the detection.",
            ),
        ]
    if result.on_gel is not None:
        tables += _gel_tables(result)
        image = _image(folder, result.on_gel.views[0].source)
        pictures += [
            Picture(
                "board_on_gel",
                partial(draw_on_gel, result.on_gel, image),
                "Points of the board, what the fitted map leaves there, and the gel frame's grid "
                "as the camera sees it; the cross is the gel frame's origin.",
            ),
            Picture(
                "rectified",
                partial(draw_rectified, result.maps(), image),
                "The board's picture before and after rectification to the gel's pixel grid.",
            ),
        ]
    elif result.intrinsics is not None:
        image = _image(folder, result.intrinsics.views[0].source)
        pictures.append(
            Picture(
                "rectified",
                partial(draw_rectified, result.maps(), image),
                "One view before and after the lens's distortion is removed.",
            )
        )
    return Page(
        f"Camera of {folder.sensor}" + (f" {folder.unit}" if folder.unit else ""),
        _summary(result),
        result.remarks,
        tables,
        pictures,
        result.figures(),
    )


def _image(folder: CaptureFolder, source: str) -> np.ndarray:
    frames = (frame for board in folder.boards for frame in board.frames)
    return next(frame for frame in frames if frame.source == source).image()


def _summary(result: CameraCalibration) -> str:
    parts = []
    if result.intrinsics is not None:
        found = result.intrinsics
        parts.append(
            f"A {found.lens.name} lens was chosen from {len(found.views)} views of a board; views "
            f"that the fit did not see are {found.chosen.heldout_px:.3f} px off (root mean square "
            f"over all, {len(found.outliers)} outliers too; "
            f"{found.chosen.heldout_robust_px:.3f} px robust)."
        )
    if result.on_gel is not None:
        frame = result.on_gel.frame
        parts.append(
            f"On the gel, a pixel is {frame.mm_per_px_x} wide and {frame.mm_per_px_y} high; points "
            f"of the board that were left out are {result.on_gel.fit.heldout_px:.3f} px off."
        )
        if len(result.on_gel.poses) == 2:
            air, pose = result.on_gel.poses
            rise = np.subtract(pose.position_mm, air.position_mm)
            parts.append(
                f"Refraction in window and gel puts the camera {np.linalg.norm(rise):.2f} mm from "
                f"where straight sight lines would ({rise[2]:+.2f} mm along z)."
            )
    return " ".join(parts)


def _lens_tables(result: CameraCalibration) -> list[Table]:
    found = result.intrinsics
    assert found is not None
    fit = found.chosen.fit
    return [
        Table(
            "Lens",
            ("parameter", "value", "standard deviation"),
            [
                (name, float(value), float(sigma))
                for name, value, sigma in zip(
                    found.lens.parameter_names, fit.parameters, fit.sigma, strict=True
                )
            ],
            "Coefficients in OpenCV's order; pixel (0, 0) is the centre of the top left pixel.",
        ),
        Table(
            "Lenses compared [px]",
            ("lens", "fit", "held out", "robust", "worse by [px²]", "± [px²]"),
            [
                (
                    score.lens.name + (" (chosen)" if score is found.chosen else ""),
                    *score.errors_px().values(),
                    score.excess,
                    score.excess_error,
                )
                for score in found.scores
            ],
            f"{found.folds}-fold over views, all of them scored, also those that no fit takes "
            "(robust: by the median error). Of a held-out view only the pose is fitted. "
            "The simplest lens within one standard error of the best is chosen.",
        ),
    ]


def _gel_tables(result: CameraCalibration) -> list[Table]:
    found = result.on_gel
    assert found is not None
    frame = found.frame
    rows: list[tuple[str, Any, Any, str]] = [
        ("mm/px along x", frame.mm_per_px_x.value, frame.mm_per_px_x.sigma, "mm/px"),
        ("mm/px along y", frame.mm_per_px_y.value, frame.mm_per_px_y.sigma, "mm/px"),
        ("shear", float(np.degrees(frame.shear)), "", "deg"),
        ("least scale under the board", found.scale_range[0], "", "of its middle"),
        ("largest scale under the board", found.scale_range[1], "", "of its middle"),
    ]
    for pose in found.poses:
        name = " with refraction" if pose.refracted else " with straight sight lines"
        name += " (used)" if pose is found.pose else ""
        rows += [
            (f"camera {axis}{name}", value, sigma, "mm")
            for axis, value, sigma in zip(
                "xyz", pose.position_mm, pose.position_sigma_mm, strict=True
            )
        ]
        rows.append((f"tilt{name}", pose.tilt_deg, "", "deg"))
    return [
        Table("Gel", ("quantity", "value", "standard deviation", "unit"), rows),
        Table(
            "Maps from the gel to the image compared [px]",
            ("map", "fit", "held out"),
            [
                (
                    fit.model.name + (" (chosen)" if fit.model == found.fit.model else ""),
                    fit.rms_px,
                    fit.heldout_px,
                )
                for fit in found.fits
            ],
            "Points of the board are left out in five parts.",
        ),
    ]
