# SPDX-License-Identifier: Apache-2.0
"""The report of a calibrated scale."""

from __future__ import annotations

from functools import partial
from typing import Any

from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.scale.pictures import draw_edges, draw_estimates
from taccel_lab.calibration.scale.result import ScaleCalibration
from taccel_lab.report.page import Page, Picture, Table


def scale_page(result: ScaleCalibration, folder: CaptureFolder) -> Page:
    """Describe a calibration; pictures read the images of ``folder``."""
    pictures = [
        Picture(
            "estimates",
            partial(draw_estimates, result),
            "Scale by each kind of capture. Where the bars of one axis miss each other, a stated "
            "length is wrong.",
        )
    ]
    for estimate in result.estimates:
        if estimate.method == "edge":
            caption = (
                "Edges and ends as found, with what the scale makes each longer than it is; grey "
                "ones touched with a part of their length only."
            )
            draw = partial(draw_edges, estimate.evidence["edges"], folder)
            pictures.append(Picture("edges", draw, caption))
    return Page(
        f"Scale of {folder.sensor}" + (f" {folder.unit}" if folder.unit else ""),
        _summary(result),
        result.remarks,
        _tables(result),
        pictures,
        result.figures(),
    )


def _summary(result: ScaleCalibration) -> str:
    if not result.axes:
        return "The captures limit the scale but do not determine it."
    said = " and ".join(f"{found.estimate} along {axis}" for axis, found in result.axes.items())
    agree = all(found.agrees for found in result.axes.values())
    many = any(found.freedom for found in result.axes.values())
    verdict = ""
    if many:
        verdict = (
            " The methods agree within their uncertainties."
            if agree
            else " The methods contradict each other."
        )
    return f"A pixel spans {said}.{verdict}"


def _tables(result: ScaleCalibration) -> list[Table]:
    rows: list[tuple[Any, ...]] = []
    for estimate in result.estimates:
        for axis in ("x", "y"):
            found = estimate.along(axis)
            if found is not None:
                low, high = found.interval95
                rows.append((estimate.method, axis, found.value, found.sigma, low, high))
        if estimate.upper_x is not None and estimate.x is None:
            rows.append((estimate.method, "x", "at most", "", "", estimate.upper_x))
    for axis, found in result.axes.items():
        low, high = found.estimate.interval95
        rows.append(("mean", axis, found.estimate.value, found.estimate.sigma, low, high))
    tables = [Table("Scale [mm/px]", ("method", "axis", "value", "sigma", "from", "to"), rows)]
    pairs = [
        (axis, name.replace("*", " - "), z)
        for axis, found in result.axes.items()
        for name, z in found.pairs.items()
    ]
    if pairs:
        tables.append(
            Table(
                "Agreement",
                ("axis", "methods", "difference / its standard deviation"),
                pairs,
                "Beyond 3, one of the two is wrong.",
            )
        )
    return tables
