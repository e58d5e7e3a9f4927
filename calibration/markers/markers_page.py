# SPDX-License-Identifier: Apache-2.0
"""The report of a calibration of markers."""

from __future__ import annotations

from functools import partial
from typing import Any

from taccel_lab.calibration.markers.pictures import (
    draw_dots,
    draw_motion,
    draw_residuals,
    draw_tracks,
)
from taccel_lab.calibration.markers.result import MarkerCalibration
from taccel_lab.report.page import Page, Picture, Table


def marker_page(result: MarkerCalibration) -> Page:
    """Verdict, estimates with their uncertainty, and pictures of dots, residuals and tracks."""
    figures = result.figures()
    estimates = [
        [name, estimate.value, estimate.sigma, *estimate.interval95, estimate.unit]
        for name, estimate in result.estimates().items()
    ]
    tables = [
        Table("Dots", ["what", "value"], _counts(figures)),
        Table(
            "Layout on the gel",
            ["quantity", "value", "sigma", "95 % from", "to", "unit"],
            estimates,
            f"Millimetres from {result.view.description}. The offset is that of the grid's middle "
            "from the gel frame's origin.",
        ),
    ]
    pictures = [
        Picture("dots", partial(draw_dots, result), "Every dot with its fitted outline."),
        Picture(
            "residuals",
            partial(draw_residuals, result),
            "Where dots lie off the regular grid; a pattern that grows outwards is the lens.",
        ),
    ]
    for number, video in enumerate(result.videos):
        stem = f"video{number}"
        tables.append(
            Table(
                f"Motion in {video.name}",
                ["what", "value"],
                [[key, value] for key, value in video.figures.as_dict().items() if key != "name"],
            )
        )
        pictures += [
            Picture(f"{stem}_tracks", partial(draw_tracks, result, video), "Paths of the dots."),
            Picture(
                f"{stem}_motion",
                partial(draw_motion, video),
                "Distance from rest, and markers seen, frame by frame.",
            ),
        ]
    return Page(
        title="Markers",
        summary=_summary(result, figures),
        remarks=result.remarks,
        tables=tables,
        pictures=pictures,
        figures=figures,
    )


def _summary(result: MarkerCalibration, figures: dict[str, Any]) -> str:
    estimates = result.estimates()
    text = (
        f"{figures['dots']} dots form a {figures['lattice']} grid of {figures['rows']} x "
        f"{figures['columns']}, pitch {estimates['pitch_x_mm']} along the rows and "
        f"{estimates['pitch_y_mm']} across, "
        f"rms {1e3 * result.layout_mm.residual_rms:.0f} µm off a regular grid."
    )
    for video in result.videos:
        text += (
            f" {video.name}: {100 * video.figures.seen_share:.0f} % seen over "
            f"{video.figures.frames} frames, up to {video.figures.largest_px:.1f} px from rest."
        )
    return text


def _counts(figures: dict[str, Any]) -> list[list[Any]]:
    keys = ("dots", "dark", "cut", "merged", "odd", "lattice", "rows", "columns", "stagger")
    rows = [[key, figures[key]] for key in keys]
    rows.append(["missing", ", ".join(f"{r},{c}" for r, c in figures["missing"]) or "none"])
    rows.append(["skew [deg]", figures["skew_deg"]])
    rows += [[f"pitch {axis} [px]", px] for axis, px in zip("xy", figures["pitch_px"], strict=True)]
    rows += [[key, value] for key, value in figures["residuals"].items()]
    return rows
