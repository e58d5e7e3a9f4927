# SPDX-License-Identifier: Apache-2.0
"""Figures of a calibration of markers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.calibration.dots import soft_ellipse as model
from taccel_lab.calibration.dots.dots import DotFlag
from taccel_lab.calibration.markers.result import MarkerCalibration, TrackedVideo
from taccel_lab.calibration.report.image_axes import frame_image, round_enlargement
from taccel_lab.report.style import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PURPLE,
    in_report_style,
    new_figure,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

_MANY = 120
"""Dots above which only the outermost carry their numbers."""


@in_report_style
def draw_dots(result: MarkerCalibration) -> Figure:
    """The picture at rest with every dot's ellipse and number."""
    from matplotlib.patches import Ellipse

    dots, lattice = result.picture.dots, result.picture.lattice
    figure, ax = _over(result.image)
    direction = model.major_direction(dots.parameters)
    colors = {"plain": GREEN, "cut": BLUE, "merged": PURPLE, "odd": ORANGE}
    shown = set()
    for n in range(dots.count):
        kind = _kind(int(dots.flags[n]))
        shown.add(kind)
        ax.add_patch(
            Ellipse(
                tuple(dots.uv_px[n]),
                2 * dots.axes_px[n, 0],
                2 * dots.axes_px[n, 1],
                angle=float(np.degrees(np.arctan2(direction[n, 1], direction[n, 0]))),
                fill=False,
                edgecolor=colors[kind],
                linewidth=1.1,
            )
        )
        edge = lattice.row[n] == 0 or lattice.column[n] == 0
        if lattice.row[n] >= 0 and (dots.count <= _MANY or edge):
            _label(ax, dots.uv_px[n], dots.axes_px[n, 0], f"{lattice.row[n]},{lattice.column[n]}")
    if result.picture.layout_px is not None and result.layout_mm.missing:
        places = result.picture.layout_px.place(*np.array(result.layout_mm.missing).T)
        ax.plot(places[:, 0], places[:, 1], "x", color=ORANGE, ms=7, mew=1.6)
    handles = [_circle(colors[kind]) for kind in colors if kind in shown]
    labels = [
        {"plain": "dot", "cut": "cut by the border", "merged": "split", "odd": "unlike the rest"}[k]
        for k in colors
        if k in shown
    ]
    _legend_below(figure, handles, labels)
    ax.set_title("dots at rest, with row and column")
    return figure


@in_report_style
def draw_residuals(result: MarkerCalibration) -> Figure:
    """How far each dot lies from the regular grid, as arrows, enlarged."""
    layout = result.layout_mm
    numbered = np.isfinite(layout.residual).all(axis=1)
    lattice = result.picture.lattice
    points = result.view.gel_from_pixel(result.picture.dots.uv_px[numbered])
    residual = layout.residual[numbered]
    figure, ax = new_figure(7.2, 5.2)
    length = float(np.percentile(np.hypot(*residual.T), 90))
    enlarged = round_enlargement(0.6 * min(layout.pitch) / max(length, 1e-9))
    ax.plot(*(points - residual).T, "o", ms=3, color=GREY, mec="none")
    tips = points - residual + enlarged * residual
    ax.plot(*tips.T, ls="none")  # arrow tips count for the limits
    ax.quiver(
        *(points - residual).T,
        *(enlarged * residual).T,
        angles="xy",
        scale_units="xy",
        scale=1,
        width=0.004,
        color=BLUE,
    )
    ax.set_aspect("equal")
    ax.margins(0.08)
    ax.invert_yaxis()
    ax.set_xlabel("x [mm]")
    ax.set_ylabel("y [mm]")
    ax.set_title(
        f"dots minus grid of {lattice.rows} x {lattice.columns}: rms "
        f"{1e3 * layout.residual_rms:.0f} µm (arrows enlarged {enlarged:g} times)"
    )
    return figure


@in_report_style
def draw_tracks(result: MarkerCalibration, video: TrackedVideo) -> Figure:
    """Paths of all markers over the picture at rest."""
    tracks = video.tracks
    figure, ax = _over(result.image)
    for marker in range(tracks.marker_count):
        path = np.where(tracks.seen[:, marker, None], tracks.uv_px[:, marker], np.nan)
        ax.plot(path[:, 0], path[:, 1], color="white", lw=1.8, solid_capstyle="round")
        ax.plot(path[:, 0], path[:, 1], color=ORANGE, lw=0.9, solid_capstyle="round")
    ax.plot(*tracks.rest_px.T, "o", ms=2.5, color=BLUE, mec="white", mew=0.4)
    ax.set_title(f"{video.name}: paths of the dots over {tracks.frame_count} frames")
    return figure


@in_report_style
def draw_motion(video: TrackedVideo) -> Figure:
    """Distance from rest and share of seen markers over the frames."""
    tracks = video.tracks
    distance = tracks.distance_px()
    frames = np.arange(tracks.frame_count)
    some = np.isfinite(distance).any(axis=1)
    figure, (top, bottom) = new_figure(7.2, 4.2, 2, 1, sharex=True, height_ratios=[3, 1])
    top.plot(frames[some], np.nanmax(distance[some], axis=1), color=ORANGE, label="largest")
    top.plot(frames[some], np.nanmedian(distance[some], axis=1), color=BLUE, label="median")
    back = video.figures.return_frame
    if back is not None:
        top.axvline(back, color=GREY, lw=0.8, ls="--")
        top.annotate(
            f"back: {video.figures.return_median_px:.2f} px",
            (back, top.get_ylim()[1]),
            xytext=(4, -4),
            textcoords="offset points",
            va="top",
            fontsize=8,
            color=INK,
        )
    top.set_ylabel("from rest [px]")
    top.legend(loc="upper left")
    top.set_title(f"{video.name}: motion of the dots")
    bottom.plot(frames, 100 * tracks.seen.mean(axis=1), color=GREEN)
    bottom.set_ylim(0, 105)
    bottom.set_ylabel("seen [%]")
    bottom.set_xlabel("frame")
    return figure


def _over(image: np.ndarray) -> tuple[Figure, Axes]:
    height, width = image.shape[:2]
    figure, ax = new_figure(8.4, 8.4 * height / width + 0.9)
    grey = image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)
    ax.imshow(grey, interpolation="bilinear")
    frame_image(ax, (width, height))
    return figure, ax


def _kind(flags: int) -> str:
    for flag, name in ((DotFlag.ODD, "odd"), (DotFlag.MERGED, "merged"), (DotFlag.CUT, "cut")):
        if flags & flag:
            return name
    return "plain"


def _label(ax: Axes, uv: np.ndarray, radius: float, text: str) -> None:
    from matplotlib.patheffects import withStroke

    ax.annotate(
        text,
        (float(uv[0]), float(uv[1] + radius)),
        xytext=(0, -1),
        textcoords="offset points",
        ha="center",
        va="top",
        fontsize=6,
        color="white",
        path_effects=[withStroke(linewidth=1.4, foreground=INK)],
        annotation_clip=True,
    )


def _circle(color: str) -> Line2D:
    from matplotlib.lines import Line2D

    return Line2D([], [], ls="", marker="o", ms=7, mfc="none", mec=color, mew=1.3)


def _legend_below(figure: Figure, handles: list, labels: list[str]) -> None:
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8)
