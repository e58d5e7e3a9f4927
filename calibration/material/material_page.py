# SPDX-License-Identifier: Apache-2.0
"""The report of a material calibration."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.calibration.material.block import material_scores
from taccel_lab.calibration.material.indentation import HeldOut, force_interval_n
from taccel_lab.calibration.material.likelihood import hull
from taccel_lab.calibration.material.result import MaterialCalibration
from taccel_lab.calibration.material.stiffness import Stiffness
from taccel_lab.printable import counted
from taccel_lab.report.lead import Picture, Score
from taccel_lab.report.page import Page, Table, picture
from taccel_lab.report.style import BLUE, GREEN, GREY, LIGHT, ORANGE, PURPLE, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BAND = 9
"""Depths at which the band is computed."""
MOST_POINTS = 12
"""Points in the table of those predicted from the others."""
_COLOURS = (BLUE, ORANGE, GREEN, PURPLE)
_AXES = {"ln_e": "Young's modulus [kPa]", "nu": "Poisson's ratio"}
_TITLES = {
    "young_modulus_pa": "Young's modulus [Pa]",
    "poisson_ratio": "Poisson's ratio",
    "mooney_ratio": "Mooney ratio",
    "friction_coefficient": "coefficient of friction",
}


def material_page(result: MaterialCalibration) -> Page:
    """Verdict, estimates with intervals, fits, residuals and profiles."""
    found = ", ".join(_TITLES[name].split(" [")[0] for name in result.estimates) or "nothing"
    fit = result.stiffness.fit
    points = counted(sum(len(item.depth_mm) for item in fit.points), "measured force")
    return Page(
        "Material of the gel",
        f"Fitted to {points} of {counted(len(fit.points), 'record')}: {found}. The records are "
        f"from {result.source}.",
        result.remarks,
        _tables(result),
        [
            _with_noise_and_touch(_indentation(result.stiffness), result.stiffness),
            _profiles(result.stiffness, open_held=bool(result.held())),
        ],
        result.figures(),
        scores=[*_scores(result), *material_scores(result.stiffness.residuals())],
    )


def _scores(result: MaterialCalibration) -> Iterator[Score]:
    """Young's modulus, where it was fitted."""
    young = result.estimates.get("young_modulus_pa")
    if young is not None:
        low, high = (f"{end / 1e3:.0f}" for end in young.interval95)
        interval = f"95 %: {low} to {high} kPa, over all that the records leave open"
        yield Score(f"{young.value / 1e3:.0f}", "kPa", "Young's modulus of the gel", interval)


def _tables(result: MaterialCalibration) -> list[Table]:
    stiffness, fit = result.stiffness, result.stiffness.fit
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
            ["parameter", "value", "standard deviation", "95 % from", "to"],
            rows,
            f"Law: {result.model}. Held parameters are not calibrated; others keep the values of "
            "the profile before.",
        )
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
            ["indenter", "depth [mm]", "press [N]", "95 % from", "to", "reading [N]", "95 % from",
             "to"],
            [
                [item.tool.description, p.depth_mm, p.press_n, *p.press_interval95_n, p.reading_n,
                 *p.reading_interval95_n]
                for i, item in enumerate(fit.points)
                for p in stiffness.predicted(i)
            ],
            "Press: of this profile, so far past first touch as taccel-lab press --depth-mm "
            f"says, friction {result.used_friction:g}. Reading: where the record, whose zero "
            "may be off, calls the depth this. Intervals are over all that the records leave "
            "open: first touch, Poisson's ratio, friction, noise.",
        )
    )  # fmt: skip
    return tables


def _thinned(points: Sequence[HeldOut]) -> list[HeldOut]:
    """Points, at most ``MOST_POINTS`` of them, evenly chosen."""
    chosen = np.linspace(0, len(points) - 1, min(len(points), MOST_POINTS)).round().astype(int)
    return [points[i] for i in chosen]


def _with_noise_and_touch(drawn: Picture, stiffness: Stiffness) -> Picture:
    """The picture with what its caption says of this fit."""
    fit = stiffness.fit
    touches = ", ".join(
        f"{item.name}: {fit.touch_mm(i):+.3f} mm "
        f"({fit.touch_interval_mm(i)[0]:+.3f} to {fit.touch_interval_mm(i)[1]:+.3f})"
        for i, item in enumerate(fit.points)
        if f"touch_{i}" in fit.solution.names
    )
    return replace(
        drawn,
        caption=f"{drawn.caption} Noise: {fit.noise}; mesh and tables add "
        f"{100 * fit.model_errors['ln_e']:.2g} % to Young's modulus (one standard deviation). "
        f"First touch of {touches or 'no record is fitted'}.",
    )


@picture("indentation", "Forces, and what the fit leaves.")
def _indentation(stiffness: Stiffness) -> Figure:
    """Force over depth with the fit and its 95 % band, and residuals in per cent."""
    fit = stiffness.fit
    figure, (left, right) = new_figure(9.5, 3.9, 1, 2, width_ratios=[1.25, 1])
    for i, item in enumerate(fit.points):
        colour = _COLOURS[i % len(_COLOURS)]
        depth = np.linspace(1e-3, 1.03 * item.deepest_mm, 120)
        force = fit.predicted_n(i, depth)
        coarse = np.linspace(0.05, 1.0, BAND) * depth[-1]
        ends = [
            hull(force_interval_n(one, i, float(at)) for one in stiffness.open_fits)
            for at in coarse
        ]
        left.fill_between(coarse, *np.transpose(ends), color=colour, alpha=0.18, lw=0)
        left.plot(depth, force, color=colour, label=f"fit, {item.tool.description}")
        left.errorbar(
            item.depth_mm, item.force_n, None if item.sigma_n is None else 2 * item.sigma_n,
            fmt="o", ms=4, color=colour, mfc="white", lw=1, label=item.name,
        )  # fmt: skip
        kept = item.force_n > 0
        right.plot(
            item.depth_mm[kept], 100 * fit.relative_residuals(i)[kept], "o", ms=4, color=colour
        )
    left.set(xlabel="depth past recorded touch [mm]", ylabel="normal force [N]")
    left.set_xlim(left=0)
    left.set_ylim(bottom=0)
    left.legend(fontsize=8)
    left.set_title("Force and fit; the band holds the force 95 times of 100")
    right.axhline(0, color=GREY, lw=0.8)
    for level in (-3, 3):
        right.axhline(level, color=LIGHT, lw=0.8, ls="--")
    right.set(xlabel="depth past recorded touch [mm]", ylabel="fit over measurement − 1 [%]")
    deep = np.concatenate(
        [
            100 * fit.relative_residuals(i)[p.force_n >= 0.1 * p.force_n.max()]
            for i, p in enumerate(fit.points)
        ]
    )
    limit = max(4.0, 1.25 * float(np.abs(deep).max()))
    right.set_ylim(-limit, limit)
    right.set_xlim(left=0)
    right.set_title("Residuals (dashed: 3 %)")
    return figure


@picture(
    "profiles",
    "Profile likelihood: the least misfit for each value of one parameter, all others free. Where "
    "it stays below the dashed line is the 95 % interval; a flat profile means that the data do "
    "not tell.",
)
def _profiles(stiffness: Stiffness, *, open_held: bool) -> Figure:
    """Profile likelihood of each parameter of the law; of Young's modulus also with what is open
    held."""
    free = stiffness.profiled.solution.profiles
    found = [(name, profile) for name, profile in free.items() if name in _AXES]
    held = stiffness.fit.solution.profiles["ln_e"] if open_held else None
    figure, axes = new_figure(3.3 * len(found) + 0.4, 3.1, 1, len(found), squeeze=False)
    for axis, (name, profile) in zip(axes[0], found, strict=True):
        values = profile.values
        ends = np.array(profile.interval)
        if name == "ln_e":
            values, ends = np.exp(values) / 1e3, np.exp(ends) / 1e3
        axis.axvspan(*ends, color=BLUE, alpha=0.12, lw=0)
        axis.plot(values, profile.excess, "o-", ms=3, color=BLUE, label="all others free")
        if name == "ln_e" and held is not None:
            axis.plot(
                np.exp(held.values) / 1e3, held.excess, "-", color=GREEN, label="what is open held"
            )
            axis.legend(fontsize=8, loc="upper center")
        axis.axhline(profile.threshold, color=ORANGE, lw=1, ls="--")
        axis.set_ylim(0, 2.5 * profile.threshold)
        margin = 0.35 * (ends[1] - ends[0]) or 0.05 * abs(ends[0])
        axis.set_xlim(ends[0] - margin, ends[1] + margin)
        axis.set_xlabel(_AXES[name], fontsize=9)
        note = "not determined by the data" if profile.open_low and profile.open_high else ""
        if profile.open_low != profile.open_high:
            note = "bounded on one side only"
        if note:
            axis.set_title(note, color=ORANGE, fontsize=9)
    axes[0, 0].set_ylabel("−2 ln L above its least")
    return figure
