# SPDX-License-Identifier: Apache-2.0
"""The report of a calibrated scale: estimates with intervals, and the edges that were found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.scale.result import ScaleCalibration
from taccel_lab.report.lead import Score
from taccel_lab.report.page import Page, Table, picture
from taccel_lab.report.style import BLUE, GREEN, GREY, LIGHT, ORANGE, new_figure
from taccel_lab.with_error import with_error

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MOST = 12


def scale_page(result: ScaleCalibration, folder: CaptureFolder) -> Page:
    """Describe a calibration; pictures read the images of ``folder``."""
    pictures = [_estimates(result)]
    for estimate in result.estimates:
        if estimate.method == "edge":
            pictures.append(_edges(estimate.evidence["edges"], folder))
    return Page(
        f"Scale of {folder.sensor}" + (f" {folder.unit}" if folder.unit else ""),
        _summary(result),
        result.remarks,
        _tables(result),
        pictures,
        result.figures(),
        scores=[
            Score(
                with_error(found.estimate.value, found.estimate.sigma),
                "mm/px",
                f"scale along {axis}",
                f"by {', '.join(e.method for e in result.estimates if e.along(axis) is not None)}; "
                "+- is one standard deviation",
            )
            for axis, found in result.axes.items()
        ],
    )


def _summary(result: ScaleCalibration) -> str:
    if not result.axes:
        return "The captures limit the scale but do not determine it."
    said = " and ".join(f"{found.estimate} along {axis}" for axis, found in result.axes.items())
    verdict = ""
    if any(found.freedom for found in result.axes.values()):
        agree = all(found.agrees for found in result.axes.values())
        how = "agree within their uncertainties" if agree else "contradict each other"
        verdict = f" The methods {how}."
    return f"A pixel spans {said}.{verdict}"


def _tables(result: ScaleCalibration) -> list[Table]:
    rows: list[tuple[Any, ...]] = []
    for estimate in result.estimates:
        for axis in ("x", "y"):
            found = estimate.along(axis)
            if found is not None:
                rows.append((estimate.method, axis, found.value, found.sigma, *found.interval95))
        if estimate.upper_x is not None and estimate.x is None:
            rows.append((estimate.method, "x", "at most", "", "", estimate.upper_x))
    for axis, combined in result.axes.items():
        mean = combined.estimate
        rows.append(("mean", axis, mean.value, mean.sigma, *mean.interval95))
    tables = [
        Table(
            "Scale [mm/px]",
            ("captures", "axis", "value", "standard deviation", "95 % from", "to"),
            rows,
        )
    ]
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


@picture(
    "estimates",
    "Scale by each kind of capture. Where the bars of one axis miss each other, a stated length is "
    "wrong.",
)
def _estimates(result: ScaleCalibration) -> Figure:
    """Every method's scale with its 95 % interval, and the mean."""
    methods = result.estimates
    figure, axes = new_figure(7.0, 1.3 + 0.55 * len(methods))
    rows = []
    for row, estimate in enumerate(methods):
        rows.append(estimate.method)
        for axis, shift, color in (("x", -0.13, BLUE), ("y", 0.13, ORANGE)):
            found = estimate.along(axis)
            if found is None:
                continue
            low, high = found.interval95
            axes.plot([low, high], [row + shift] * 2, "-", color=color, lw=2)
            axes.plot(found.value, row + shift, "o", color=color, ms=5)
        if estimate.upper_x is not None and estimate.x is None:
            axes.plot(estimate.upper_x, row, "<", color=GREEN, ms=9)
            axes.annotate(
                "at most", (estimate.upper_x, row), xytext=(-10, 0), textcoords="offset points",
                ha="right", va="center", color=GREEN,
            )  # fmt: skip
    for axis, color in (("x", BLUE), ("y", ORANGE)):
        if axis in result.axes:
            found = result.axes[axis].estimate
            axes.axvspan(*found.interval95, color=color, alpha=0.12, lw=0)
            axes.axvline(found.value, color=color, lw=1, label=f"mean along {axis}")
    axes.set_yticks(range(len(rows)), rows)
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.set_xlabel("mm/px; bars and bands are 95 % intervals")
    axes.grid(True, axis="x")
    if result.axes:
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncol=2)
    return figure


@picture(
    "edges",
    "Edges and ends as found, with how much too long the fitted scale makes each; grey ones "
    "touched with a part of their length only.",
)
def _edges(edges: Sequence[Mapping[str, Any]], folder: CaptureFolder) -> Figure:
    """Edges of the evidence in their images, with what each lacks in length."""
    images = {edge.frame.source: edge.frame.image for edge in folder.edges}
    shown = edges[:_MOST]
    columns = min(4, len(shown))
    rows = -(-len(shown) // columns)
    height, width = images[shown[0]["name"]]().shape[:2]
    figure, axes = new_figure(
        2.5 * columns, (2.5 * height / width + 0.5) * rows, rows, columns, squeeze=False
    )
    for axis in axes.ravel():
        axis.set_axis_off()
    for axis, edge in zip(axes.ravel(), shown, strict=False):
        axis.imshow(images[edge["name"]]())
        ends, color = np.array(edge["ends_px"]), "white" if edge["used"] else LIGHT
        axis.plot(ends[:, 0], ends[:, 1], "o-", mfc="none", color=color, lw=0.8, ms=6)
        place = Path(edge["name"])
        axis.set_title(
            f"{place.parent.name}/{place.stem}\n{edge['length_px']:.1f} px, "
            f"{-edge['residual_mm']:+.2f} mm",
            fontsize=9,
            color=GREY,
        )
    return figure
