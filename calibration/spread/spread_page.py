# SPDX-License-Identifier: Apache-2.0
"""The spread as a page: table of standard deviations, frames over time."""

from __future__ import annotations

from taccel_lab.calibration.spread.pictures import draw_lights
from taccel_lab.calibration.spread.result import SpreadCalibration
from taccel_lab.report.page import Page, Picture, Table


def spread_page(result: SpreadCalibration) -> Page:
    """Describe the spread for ``taccel_lab.calibration.report.write_page``."""
    rows = []
    for name, value in result.values().items():
        cells = value if isinstance(value, tuple) else (value, None, None)
        rows.append((name, *cells))
    pictures = []
    if result.lights:
        pictures.append(
            Picture(
                "lights",
                lambda: draw_lights(result.lights, result.pivot),
                "Light of each frame (or unit) against the mean image, by channel.",
            )
        )
    return Page(
        title=f"Spread of captures: {result.sensor}",
        summary=f"{len(result.frame_drifts)} frames of this unit, "
        f"{0 if result.units is None else result.units.unit_count} units compared.",
        remarks=result.remarks,
        tables=[Table("Standard deviations", ("quantity", "red or value", "green", "blue"), rows)],
        pictures=pictures,
        figures=result.figures(),
    )
