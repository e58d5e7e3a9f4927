# SPDX-License-Identifier: Apache-2.0
"""The report of a calibrated camera: lens, pose and maps compared, points found, what the fit
leaves, and the rectified image."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.calibration.camera.board_on_gel import OnGel
from taccel_lab.calibration.camera.intrinsics import Intrinsics
from taccel_lab.calibration.camera.rectification import RectificationMaps
from taccel_lab.calibration.camera.result import CameraCalibration
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.image_axes import frame_image, round_enlargement
from taccel_lab.printable import counted
from taccel_lab.report.lead import Picture, Score
from taccel_lab.report.page import Page, Table, picture
from taccel_lab.report.style import BLUE, GREY, LIGHT, ORANGE, new_figure
from taccel_lab.robust_fit import rms
from taccel_lab.with_error import with_error

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_GRID_LINES = 13


def camera_page(result: CameraCalibration, folder: CaptureFolder) -> Page:
    """Describe a calibration; pictures read the images of ``folder`` when they are drawn."""
    tables: list[Table] = []
    pictures: list[Picture] = []
    if result.intrinsics is not None:
        tables += _lens_tables(result.intrinsics)
        pictures += [_views(result.intrinsics), _residuals(result.intrinsics)]
    if result.on_gel is not None:
        tables += _gel_tables(result.on_gel)
        image = _image(folder, result.on_gel.views[0].source)
        pictures += [_board_on_gel(result.on_gel, image), _rectified(result.maps(), image)]
    elif result.intrinsics is not None:
        image = _image(folder, result.intrinsics.views[0].source)
        caption = "One view before and after the lens's distortion is removed."
        pictures.append(replace(_rectified(result.maps(), image), caption=caption))
    return Page(
        f"Camera of {folder.sensor}" + (f" {folder.unit}" if folder.unit else ""),
        _summary(result),
        result.remarks,
        tables,
        pictures,
        result.figures(),
        scores=_scores(result),
    )


def _scores(result: CameraCalibration) -> tuple[Score, ...]:
    """Errors of points that the fits did not see."""
    found, on_gel = [], result.on_gel
    if result.intrinsics is not None:
        error, on = result.intrinsics.chosen.heldout_px, f"{len(result.intrinsics.views)} views"
        words = "error of the lens", f"{on} of a board, each left out of the fit in turn"
        found.append(Score(f"{error:.3f}", "px rms", *words))
    if on_gel is not None:
        words = "error of the board on the gel", "points that were left out of the fit"
        found.append(Score(f"{on_gel.fit.heldout_px:.3f}", "px rms", *words))
        scale = on_gel.frame.mm_per_px_x
        words = "width of a pixel", "by the board on the gel; +- is one standard deviation"
        found.append(Score(with_error(scale.value, scale.sigma), "mm", *words))
    return tuple(found)


def _image(folder: CaptureFolder, source: str) -> np.ndarray:
    frames = (frame for board in folder.boards for frame in board.frames)
    return next(frame for frame in frames if frame.source == source).image()


def _summary(result: CameraCalibration) -> str:
    parts = []
    if result.intrinsics is not None:
        found = result.intrinsics
        outliers = f", {counted(len(found.outliers), 'outlier')} included" * bool(found.outliers)
        parts.append(
            f"A {found.lens.name} lens was chosen from {len(found.views)} views of a board; views "
            f"that the fit did not see are {found.chosen.heldout_px:.3f} px off (root mean square"
            f"{outliers}; by the median {found.chosen.heldout_robust_px:.3f} px)."
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


def _lens_tables(found: Intrinsics) -> list[Table]:
    fit = found.chosen.fit
    return [
        Table(
            "Lens",
            ("parameter", "value", "standard deviation"),
            list(zip(found.lens.parameter_names, fit.parameters, fit.sigma, strict=True)),
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


def _gel_tables(found: OnGel) -> list[Table]:
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
        Table.of(
            "Maps from the gel to the image compared [px]",
            found.fits,
            {
                "map": lambda fit: (
                    fit.model.name + (" (chosen)" if fit.model == found.fit.model else "")
                ),
                "fit": "rms_px",
                "held out": "heldout_px",
            },
            "Points of the board are left out in five parts.",
        ),
    ]


def _plain_number(value: float, _position: int) -> str:
    return f"{value:.3g}"


def _some_numbers(value: float, _position: int) -> str:
    """2 and 5 of each decade: the names of all nine steps would lie on each other."""
    leading = f"{value:.0e}"[0]
    return f"{value:.3g}" if leading in "25" else ""


def _arrow_scale(residuals: np.ndarray, size_px: tuple[int, int]) -> float:
    """Enlargement that makes arrows legible."""
    return round_enlargement(0.03 * max(size_px) / max(rms(residuals), 1e-9))


@picture(
    "views",
    "Left: every point of every view. Right: root mean square error of each view when the lens was "
    "fitted without it; the bar is the root mean square of all.",
)
def _views(found: Intrinsics) -> Figure:
    """All points of all views, and the held-out error of each view by lens."""
    figure, (left, right) = new_figure(9.5, 3.8, 1, 2)
    for view in found.views:
        left.plot(view.uv_px[:, 0], view.uv_px[:, 1], ".", ms=2, color=BLUE, alpha=0.6)
    frame_image(left, found.size_px)
    left.set_title(f"{len(found.views)} views, {found.coverage:.0%} of the image")
    names = [score.lens.name for score in found.scores]
    data = [np.sqrt(score.view_mse) for score in found.scores]
    for k, values in enumerate(data):
        chosen = names[k] == found.lens.name
        spread = np.linspace(-0.15, 0.15, len(values)) if len(values) > 1 else [0.0]
        right.plot(k + np.asarray(spread), values, "o", ms=3, color=BLUE if chosen else GREY)
        right.plot([k - 0.3, k + 0.3], [np.sqrt(np.mean(values**2))] * 2, "-", color=ORANGE)
    right.set_xticks(range(len(names)), names)
    right.set_ylabel("held-out error of a view [px]")
    right.set_yscale("log")
    right.yaxis.set_major_formatter(_plain_number)
    right.yaxis.set_minor_formatter(_some_numbers)
    right.grid(True, axis="y")
    right.set_title(f"chosen: {found.lens.name}")
    return figure


@picture(
    "residuals",
    "Seen minus projected points. A pattern that repeats from view to view is a lens that the "
    "model does not reach; random arrows are noise of the detection.",
)
def _residuals(found: Intrinsics) -> Figure:
    """What the fit leaves at every point, enlarged."""
    figure, axes = new_figure(6.5, 5.0)
    residuals = np.concatenate(found.chosen.fit.residuals)
    points = np.concatenate([view.uv_px for view in found.views])
    scale = _arrow_scale(residuals, found.size_px)
    axes.quiver(
        points[:, 0], points[:, 1], residuals[:, 0] * scale, residuals[:, 1] * scale,
        angles="xy", scale_units="xy", scale=1, width=0.0018, color=BLUE,
    )  # fmt: skip
    frame_image(axes, found.size_px)
    axes.set_title(f"seen minus projected, {scale:g} times enlarged; {rms(residuals):.2f} px rms")
    return figure


@picture(
    "board_on_gel",
    "Points of the board, what the fitted map leaves there, and the gel frame's grid as the camera "
    "sees it; the cross is the gel frame's origin.",
)
def _board_on_gel(found: OnGel, image: np.ndarray) -> Figure:
    """Points of the board on the gel with what the fit leaves, and the pixel grid on the gel."""
    figure, axes = new_figure(6.5, 5.0)
    view = found.views[0]
    axes.imshow(image, alpha=0.75)
    points = found.points_in_gel_mm
    low, high = points.min(axis=0), points.max(axis=0)
    for k in range(_GRID_LINES):
        t = np.linspace(0, 1, 60)
        share = k / (_GRID_LINES - 1)
        for line in (
            np.column_stack([np.full(60, low[0] + share * (high[0] - low[0])),
                             low[1] + t * (high[1] - low[1])]),
            np.column_stack([low[0] + t * (high[0] - low[0]),
                             np.full(60, low[1] + share * (high[1] - low[1]))]),
        ):  # fmt: skip
            uv = found.pixel_from_gel(line)
            axes.plot(uv[:, 0], uv[:, 1], "-", lw=0.6, color=LIGHT)
    residual = found.fit.residuals[0]
    scale = _arrow_scale(residual, view.size_px)
    axes.plot(view.uv_px[:, 0], view.uv_px[:, 1], "o", ms=4, mfc="none", color=BLUE)
    axes.quiver(
        view.uv_px[:, 0], view.uv_px[:, 1], residual[:, 0] * scale, residual[:, 1] * scale,
        angles="xy", scale_units="xy", scale=1, width=0.003, color=ORANGE,
    )  # fmt: skip
    axes.plot(*found.center_px, "+", ms=14, mew=2, color=ORANGE)
    frame_image(axes, view.size_px)
    axes.set_title(
        f"{len(view.index)} of {view.expected} points; residuals {scale:g} times enlarged"
    )
    return figure


@picture("rectified", "The board's picture before and after rectification to the gel's pixel grid.")
def _rectified(maps: RectificationMaps, image: np.ndarray) -> Figure:
    """The image before and after."""
    figure, (left, right) = new_figure(9.5, 3.9, 1, 2)
    height, width = maps.map_u_px.shape
    left.imshow(image)
    frame_image(left, (image.shape[1], image.shape[0]))
    left.set_title("as recorded")
    after = maps.apply(image)
    grid = maps.grid
    if grid is None:
        right.imshow(after)
        frame_image(right, (width, height))
    else:
        x, y = grid.x_mm(), grid.y_mm()
        dimmed = np.where(maps.measured[..., None], after, (after * 0.45).astype(after.dtype))
        right.imshow(dimmed, extent=(x[0], x[-1], y[-1], y[0]))
        right.set(xlabel="x [mm]", ylabel="y [mm]")
    right.set_title("rectified; dimmed where the map is extrapolated" if grid else "rectified")
    return figure
