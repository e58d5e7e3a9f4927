# SPDX-License-Identifier: Apache-2.0
"""The report of a calibration of markers."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.calibration.image_axes import frame_image, round_enlargement
from taccel_lab.calibration.markers.result import MarkerCalibration, TrackedVideo
from taccel_lab.printable import counted
from taccel_lab.reading.dots import soft_ellipse as model
from taccel_lab.reading.dots.detection import DotFlag
from taccel_lab.report.lead import Score
from taccel_lab.report.page import Page, Table, picture
from taccel_lab.report.style import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_KINDS = (
    (DotFlag.ODD, "unlike the rest", ORANGE),
    (DotFlag.MERGED, "split", PURPLE),
    (DotFlag.CUT, "cut by the border", BLUE),
    (None, "dot", GREEN),
)
"""Flag, words and colour, the first that applies."""
_OF_DOTS = {
    "dots": "dots found",
    "dark": "darker than the gel",
    "cut": "cut by the border",
    "merged": "two that touched, split",
    "odd": "unlike the rest",
    "lattice": "kind of grid",
    "rows": "rows",
    "columns": "columns",
    "stagger": "shift of every second row, in pitches",
}
_LEFT = {
    "grid_rms_mm": "off a regular grid [mm rms]",
    "grid_rms_px": "off a regular grid [px rms]",
    "dot_sigma_px": "uncertainty of a dot's place [px]",
    "rest_jitter_px": "jitter of a dot at rest [px]",
    "return_error_px": "off its place when the gel is back at rest [px]",
}
_OF_A_VIDEO = {
    "frames": "frames",
    "markers": "dots followed",
    "quiet_frames": "frames at rest, from which they are followed",
    "quiet_first": "first of these frames",
    "jitter_px": "jitter of a dot over them [px]",
    "largest_px": "largest distance from rest [px]",
    "step_in_pitches": "largest step between two frames, in pitches",
    "common_step_in_pitches": "largest median step, in pitches",
    "unseen_frames": "other frames with fewer than half of the dots",
    "seen_share": "share of dots and frames that is seen",
    "lost_share": "share that was lost",
    "return_frame": "frame in which the gel is back at rest",
    "return_median_px": "median distance from rest in it [px]",
}
"""Figures by their names in ``report.json``: what the page calls them."""
_MANY = 120
"""Dots above which only the outermost carry their numbers."""


def markers_page(result: MarkerCalibration) -> Page:
    """Verdict, estimates with their uncertainty, and pictures of dots, residuals and tracks."""
    figures = result.figures()
    estimates = [
        [
            name.rpartition("_")[0].replace("_", " "),
            estimate.value,
            estimate.sigma,
            *estimate.interval95,
            estimate.unit,
        ]
        for name, estimate in result.estimates().items()
    ]
    tables = [
        Table(
            "Layout on the gel",
            ["quantity", "value", "standard deviation", "95 % from", "to", "unit"],
            estimates,
            f"Millimetres from {result.view.description}. The offset is that of the grid's middle "
            "from the gel frame's origin.",
        ),
        Table("Dots in the picture at rest", ["what", "value"], _counts(figures), folded=True),
    ]
    pictures = [_dots(result), _residuals(result)]
    for number, video in enumerate(result.videos):
        rows = [[words, getattr(video.figures, key)] for key, words in _OF_A_VIDEO.items()]
        rows.append(["frames that are not read", " ".join(video.figures.unread) or "none"])
        tables.append(Table(f"Motion in {video.name}", ["what", "value"], rows, folded=True))
        for one in (_tracks(result, video), _motion(video)):
            pictures.append(replace(one, name=f"video{number}_{one.name}"))
    scores = (
        Score(
            f"{result.layout_mm.residual_rms:.3f}",
            "mm rms",
            "distance of the dots from a regular grid",
            f"{figures['dots']} dots at rest",
        ),
        *(
            Score(
                f"{100 * video.figures.seen_share:.0f}",
                "%",
                f"of the dots followed in {video.name}",
                f"{video.figures.frames} frames, up to {video.figures.largest_px:.1f} px from rest",
            )
            for video in result.videos
        ),
    )
    summary = _summary(result, figures)
    return Page(
        "Markers on the gel", summary, result.remarks, tables, pictures, figures, scores=scores
    )


def _summary(result: MarkerCalibration, figures: dict[str, Any]) -> str:
    estimates = result.estimates()
    text = (
        f"{figures['dots']} dots form a {figures['lattice']} grid of {figures['rows']} x "
        f"{figures['columns']}, pitch {estimates['pitch_x_mm']} along the rows and "
        f"{estimates['pitch_y_mm']} across, "
        f"{result.layout_mm.residual_rms:.3f} mm (root mean square) off a regular grid."
    )
    for video in result.videos:
        text += (
            f" In {video.name} {100 * video.figures.seen_share:.0f} % of the dots were followed "
            f"over {counted(video.figures.frames, 'frame')}, up to "
            f"{video.figures.largest_px:.1f} px from rest."
        )
    return text


def _counts(figures: dict[str, Any]) -> list[list[Any]]:
    rows = [[words, figures[key]] for key, words in _OF_DOTS.items()]
    rows.append(
        [
            "missing dots (row, column)",
            ", ".join(f"{r},{c}" for r, c in figures["missing"]) or "none",
        ]
    )
    rows.append(["skew of the grid [deg]", figures["skew_deg"]])
    rows += [[f"pitch {axis} [px]", px] for axis, px in zip("xy", figures["pitch_px"], strict=True)]
    rows += [[_LEFT[key], value] for key, value in figures["residuals"].items()]
    return rows


@picture("dots", "Every dot with its fitted outline.")
def _dots(result: MarkerCalibration) -> Figure:
    """The picture at rest with every dot's ellipse and number."""
    from matplotlib.collections import EllipseCollection

    dots, lattice = result.picture.dots, result.picture.lattice
    figure, ax = _over(result.image)
    direction = model.major_direction(dots.parameters)
    turn_deg = np.degrees(np.arctan2(direction[:, 1], direction[:, 0]))
    longer, shorter = 2 * dots.axes_px.T
    drawn = np.zeros(dots.count, dtype=bool)
    for flag, label, color in _KINDS:
        these = ~drawn & (dots.whole if flag is None else dots.flagged(flag))
        drawn |= these
        if these.any():
            ellipses = EllipseCollection(
                longer[these], shorter[these], turn_deg[these], units="xy",
                offsets=dots.uv_px[these], offset_transform=ax.transData,
                facecolors="none", edgecolors=color, linewidths=1.1,
            )  # fmt: skip
            ax.add_collection(ellipses)
            ax.plot([], [], "o", ms=7, mfc="none", mec=color, mew=1.3, label=label)
    edge = (lattice.row == 0) | (lattice.column == 0)
    for n in np.flatnonzero(lattice.numbered & (edge | (dots.count <= _MANY))):
        _label(ax, dots.uv_px[n], dots.axes_px[n, 0], f"{lattice.row[n]},{lattice.column[n]}")
    if result.layout_mm.missing:
        places = result.picture.layout_px.place(*np.array(result.layout_mm.missing).T)
        ax.plot(places[:, 0], places[:, 1], "x", color=ORANGE, ms=7, mew=1.6)
    figure.legend(loc="outside lower center", ncols=4, fontsize=8)
    ax.set_title("dots at rest, with row and column")
    return figure


@picture(
    "residuals",
    "Where dots lie off the regular grid; a pattern that grows outwards is the lens.",
)
def _residuals(result: MarkerCalibration) -> Figure:
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
        angles="xy", scale_units="xy", scale=1, width=0.004, color=BLUE,
    )  # fmt: skip
    ax.set_aspect("equal")
    ax.margins(0.08)
    ax.invert_yaxis()
    ax.set(xlabel="x [mm]", ylabel="y [mm]")
    ax.set_title(
        f"dots minus grid of {lattice.rows} x {lattice.columns}: rms "
        f"{1e3 * layout.residual_rms:.0f} µm (arrows enlarged {enlarged:g} times)"
    )
    return figure


@picture("tracks", "Paths of the dots.")
def _tracks(result: MarkerCalibration, video: TrackedVideo) -> Figure:
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


@picture("motion", "Distance from rest, and markers seen, frame by frame.")
def _motion(video: TrackedVideo) -> Figure:
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
            (back, top.get_ylim()[1]), xytext=(4, -4), textcoords="offset points",
            va="top", fontsize=8, color=INK,
        )  # fmt: skip
    top.set_ylabel("from rest [px]")
    top.legend(loc="upper left")
    top.set_title(f"{video.name}: motion of the dots")
    bottom.plot(frames, 100 * tracks.seen.mean(axis=1), color=GREEN)
    bottom.set(ylim=(0, 105), xlabel="frame", ylabel="seen [%]")
    return figure


def _over(image: np.ndarray) -> tuple[Figure, Axes]:
    height, width = image.shape[:2]
    figure, ax = new_figure(8.4, 8.4 * height / width + 0.9)
    grey = image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)
    ax.imshow(grey, interpolation="bilinear")
    frame_image(ax, (width, height))
    return figure, ax


def _label(ax: Axes, uv: np.ndarray, radius: float, text: str) -> None:
    from matplotlib.patheffects import withStroke

    ax.annotate(
        text, (float(uv[0]), float(uv[1] + radius)), xytext=(0, -1), textcoords="offset points",
        ha="center", va="top", fontsize=6, color="white", annotation_clip=True,
        path_effects=[withStroke(linewidth=1.4, foreground=INK)],
    )  # fmt: skip
