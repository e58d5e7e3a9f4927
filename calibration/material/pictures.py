# SPDX-License-Identifier: Apache-2.0
"""Figures of a material calibration."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.calibration.material.predicted_forces import force_interval_n
from taccel_lab.calibration.material.stiffness import Stiffness
from taccel_lab.report.style import (
    BLUE,
    GREEN,
    GREY,
    LIGHT,
    ORANGE,
    PURPLE,
    in_report_style,
    new_figure,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BAND = 9
"""Depths at which the band is computed."""
_COLOURS = (BLUE, ORANGE, GREEN, PURPLE)
_AXES = {
    "ln_e": "Young's modulus [kPa]",
    "nu": "Poisson's ratio",
}


@in_report_style
def draw_indentation(stiffness: Stiffness) -> Figure:
    """Force over depth with the fit and its 95 % band, and residuals in per cent."""
    fit = stiffness.fit
    figure, (left, right) = new_figure(9.5, 3.9, 1, 2, width_ratios=[1.25, 1])
    for i, item in enumerate(fit.points):
        colour = _COLOURS[i % len(_COLOURS)]
        depth = np.linspace(1e-3, 1.03 * item.deepest_mm, 120)
        force = fit.predicted_n(i, depth)
        coarse = np.linspace(0.05, 1.0, BAND) * depth[-1]
        ends = [[force_interval_n(one, i, float(d)) for one in stiffness.open_fits] for d in coarse]
        low = [min(a for a, _ in row) for row in ends]
        high = [max(b for _, b in row) for row in ends]
        left.fill_between(coarse, low, high, color=colour, alpha=0.18, lw=0)
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


@in_report_style
def draw_profiles(stiffness: Stiffness, *, open_held: bool) -> Figure:
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
