# SPDX-License-Identifier: Apache-2.0
"""The report of a material calibration."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from taccel_lab.calibration.material.pictures import (
    draw_indentation,
    draw_profiles,
)
from taccel_lab.calibration.material.predicted_forces import HeldOut
from taccel_lab.calibration.material.result import MaterialCalibration
from taccel_lab.report.page import Page, Picture, Table

_TITLES = {
    "young_modulus_pa": "Young's modulus [Pa]",
    "poisson_ratio": "Poisson's ratio",
    "mooney_ratio": "Mooney ratio",
    "friction_coefficient": "coefficient of friction",
}


def material_page(result: MaterialCalibration) -> Page:
    """Verdict, estimates with intervals, fits, residuals and profiles."""
    rows: list[list[Any]] = [
        [_TITLES[name], item.value, item.sigma, *item.interval95]
        for name, item in result.estimates.items()
    ]
    rows += [
        [f"{_TITLES[name]} (held)", value, "", "", ""] for name, value in result.held().items()
    ]
    tables = [
        Table(
            "Parameters",
            ["parameter", "value", "sigma", "95 % from", "to"],
            rows,
            f"Law: {result.model}. Held parameters are not calibrated; others keep the values of "
            "the profile before.",
        )
    ]
    stiffness = result.stiffness
    fit = stiffness.fit
    touches = ", ".join(
        f"{item.name}: {fit.touch_mm(i):+.3f} mm "
        f"({fit.touch_interval_mm(i)[0]:+.3f} to {fit.touch_interval_mm(i)[1]:+.3f})"
        for i, item in enumerate(fit.points)
        if f"touch_{i}" in fit.solution.names
    )
    pictures = [
        Picture(
            "indentation",
            partial(draw_indentation, stiffness),
            f"Forces, and what the fit leaves. Noise: {fit.noise}; mesh and tables add "
            f"{100 * fit.model_errors['ln_e']:.2g} % to Young's modulus (one standard deviation). "
            f"First touch of {touches or 'no record is fitted'}.",
        ),
        Picture(
            "profiles",
            partial(draw_profiles, stiffness, open_held=bool(result.held())),
            "Profile likelihood: the least misfit for each value of one parameter, all others "
            "free. Where it stays below the dashed line is the 95 % interval; a flat profile "
            "means that the data do not tell.",
        ),
    ]
    if stiffness.held_out:
        tables.append(
            Table(
                "Points predicted from the others",
                ["record", "depth [mm]", "force [N]", "predicted [N]", "off [%]", "95 % from",
                 "to"],
                [
                    [fit.points[h.index].name, h.depth_mm, h.force_n, h.predicted_n,
                     100 * h.relative, *h.interval_n]
                    for h in _thinned(stiffness.held_out)
                ],
                "What the fit is worth where it was not fitted; the interval is of a reading.",
            )
        )  # fmt: skip
    tables.append(
        Table(
            "Forces of presses",
            [
                "indenter",
                "depth [mm]",
                "press [N]",
                "95 % from",
                "to",
                "reading [N]",
                "95 % from",
                "to",
            ],
            [
                [
                    item.tool.description,
                    p.depth_mm,
                    p.press_n,
                    *p.press_interval95_n,
                    p.reading_n,
                    *p.reading_interval95_n,
                ]
                for i, item in enumerate(fit.points)
                for p in stiffness.predicted(i)
            ],
            "Press: of this profile, so far past first touch as taccel-lab press --depth-mm "
            f"says, friction {result.used_friction:g}. Reading: where the record, whose zero "
            "may be off, calls the depth this. Intervals are over all that the records leave "
            "open: first touch, Poisson's ratio, friction, noise.",
        )
    )
    found = ", ".join(_TITLES[name].split(" [")[0] for name in result.estimates) or "nothing"
    return Page(
        title="Material of the gel",
        summary=f"From {len(result.inputs)} inputs of {result.source}: {found}.",
        remarks=result.remarks,
        tables=tables,
        pictures=pictures,
        figures=result.figures(),
    )


def _thinned(points: Sequence[HeldOut], most: int = 12) -> list[HeldOut]:
    """At most ``most`` of them, evenly chosen."""
    chosen = np.linspace(0, len(points) - 1, min(len(points), most)).round().astype(int)
    return [points[i] for i in chosen]
