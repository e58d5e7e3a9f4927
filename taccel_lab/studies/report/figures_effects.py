# SPDX-License-Identifier: Apache-2.0
"""What parameters do to metrics: heat map, effects one by one, maps over two parameters."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.report.style import BLUE, GREY, INK, LIGHT, ORANGE, in_report_style, new_figure
from taccel_lab.studies.evaluate.runner import StudyOutcome
from taccel_lab.studies.report.figures import (
    color_norm,
    column,
    metric_label,
    panel_grid,
    parameter_label,
    plain_log_ticks,
)
from taccel_lab.studies.report.sensitivity import Effect, Sensitivity, with_partners

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STRONGEST = 2.0
"""End of the heat map's scale: an elasticity of 2 doubles a percentage."""
MOST_METRICS = 12
"""Rows of the pictures; the table has all metrics."""


@in_report_style
def draw_sensitivities(outcome: StudyOutcome, found: dict[str, Sensitivity]) -> Figure:
    """Metric by parameter: colour the elasticity, in words also the share or rank correlation."""
    names = [axis.name for axis in outcome.study.axes]
    metrics = list(found)
    cells = np.array(
        [[_number(found[m].effects[n].elasticity) for n in names] for m in metrics]
    ).reshape(len(metrics), len(names))
    figure, axes = new_figure(2.6 + 1.75 * len(names) + 1.2, 1.0 + 0.5 * len(metrics))
    drawn = axes.imshow(
        np.ma.masked_invalid(cells), cmap="RdBu_r", vmin=-STRONGEST, vmax=STRONGEST, aspect="auto"
    )
    axes.set_facecolor("#f3f4f6")
    for row, metric in enumerate(metrics):
        for col, name in enumerate(names):
            dark = np.isfinite(cells[row, col]) and abs(cells[row, col]) > 1.3
            text = cell_text(found[metric].effects[name])
            color = "white" if dark else INK
            axes.text(col, row, text, ha="center", va="center", fontsize=8.5, color=color)
    axes.set_xticks(range(len(names)), names)
    fits = [f"{m}\nR² {r2:.2f}" if (r2 := found[m].r2) is not None else m for m in metrics]
    axes.set_yticks(range(len(metrics)), fits, fontsize=8.5)
    axes.tick_params(length=0)
    for spine in axes.spines.values():
        spine.set_visible(False)
    axes.set_xticks(np.arange(len(names) + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(metrics) + 1) - 0.5, minor=True)
    axes.grid(which="minor", color="white", linewidth=2)
    axes.tick_params(which="minor", length=0)
    figure.colorbar(drawn, ax=axes, label="elasticity [% per %]", extend="both", shrink=0.9)
    return figure


def _number(value: float | None) -> float:
    return np.nan if value is None else value


def cell_text(effect: Effect) -> str:
    """Effect of one parameter on one metric: ``+0.98   η² 64 %``."""
    parts = []
    if effect.elasticity is not None:
        # Adding zero turns -0.0 round.
        parts.append(f"{round(effect.elasticity, 2) + 0.0:+.2f}")
    if effect.share is not None:
        parts.append(f"η² {effect.share:.0%}")
    if effect.rank is not None:
        parts.append(f"ρ {round(effect.rank, 2) + 0.0:+.2f}")
    return "   ".join(parts) or "–"


@in_report_style
def draw_effects(outcome: StudyOutcome, found: dict[str, Sensitivity]) -> Figure:
    """A panel for each metric and parameter: all designs, and the means over levels of a grid.

    Designs that lack a partner at another level are hollow and not in the means; a level without
    any design that could be compared is marked as a gap.
    """
    designs = outcome.done
    metrics = list(outcome.study.metrics)[:MOST_METRICS]
    axes_list = outcome.study.axes
    grid = outcome.study.spec.sweep.kind == "grid"
    holes = grid and any(found[metric].lacking for metric in metrics)
    figure, panels = new_figure(
        2.9 * len(axes_list) + 0.8,
        (1.95 if holes else 1.65) * len(metrics) + 0.5,
        len(metrics),
        len(axes_list),
        squeeze=False,
        sharey="row",
    )
    for row, metric in enumerate(metrics):
        y = column(designs, metric)
        for col, axis in enumerate(axes_list):
            panel = panels[row][col]
            panel.grid(True)
            panel.set_axisbelow(True)
            choices = [] if axis.numeric else list(axis.values or ())

            def at(value: Any, choices: list[Any] = choices) -> float:
                return float(choices.index(value) if choices else value)

            x = np.array([at(row.parameters[axis.name]) for row in designs])
            if choices:
                panel.set_xticks(range(len(choices)), choices)
            if grid:
                _draw_means(panel, x, y, found[metric], outcome, axis.name, at)
            else:
                panel.scatter(x, y, s=12, color=BLUE, linewidths=0, alpha=0.9)
            if axis.log:
                panel.set_xscale("log")
                plain_log_ticks(panel)
            panel.tick_params(labelsize=8)
            if col == 0:
                panel.set_ylabel(metric_label(outcome, metric).replace(" [", "\n["), fontsize=8)
            if row == len(metrics) - 1:
                panel.set_xlabel(parameter_label(outcome, axis.name), fontsize=9)
    return figure


def _draw_means(
    panel: Any,
    x: np.ndarray,
    y: np.ndarray,
    found: Sensitivity,
    outcome: StudyOutcome,
    name: str,
    at: Callable[[Any], float],
) -> None:
    """All designs at ``x``, ``y``, and the means over the levels of one parameter of a grid."""
    known = np.flatnonzero(np.isfinite(y))
    columns = {
        axis.name: [outcome.done[i].parameters[axis.name] for i in known]
        for axis in outcome.study.axes
    }
    compared = np.zeros(len(y), dtype=bool)
    compared[known[with_partners(columns, name)]] = True
    panel.scatter(x[compared], y[compared], s=12, color=LIGHT, linewidths=0, alpha=0.9)
    panel.scatter(x[~compared], y[~compared], s=14, facecolors="none", edgecolors=GREY, lw=0.7)
    effect = found.effects[name]
    levels = sorted(effect.means.items(), key=lambda item: at(item[0]))
    panel.plot(
        [at(level) for level, _ in levels],
        [_number(mean) for _, mean in levels],
        "o-", color=ORANGE, markersize=4,
    )  # fmt: skip
    if found.lacking:
        panel.set_title(f"{effect.compared} of {found.count + found.lacking} compared", fontsize=8)
        for level in (level for level, mean in levels if mean is None):
            panel.axvline(at(level), color=GREY, linewidth=0.8, linestyle=":")
            panel.annotate(
                "no mean", (at(level), 0.5), xycoords=("data", "axes fraction"), rotation=90,
                va="center", ha="right", fontsize=7, color=GREY,
            )  # fmt: skip


@in_report_style
def draw_maps(outcome: StudyOutcome) -> Figure:
    """Each metric over the plane of a grid's two numeric parameters."""
    first, second = outcome.study.axes
    designs = outcome.done
    metrics = [m for m in list(outcome.study.metrics)[:MOST_METRICS] if _known(outcome, m)]
    figure, panels = panel_grid(len(metrics), (3.3, 2.75))
    xs, ys = sorted(first.values or ()), sorted(second.values or ())
    for metric, panel in zip(metrics, panels.flat, strict=False):
        cells = np.full((len(ys), len(xs)), np.nan)
        for row, value in zip(designs, column(designs, metric), strict=True):
            spot = ys.index(row.parameters[second.name]), xs.index(row.parameters[first.name])
            cells[spot] = value
        drawn = panel.pcolormesh(
            np.arange(len(xs) + 1) - 0.5,
            np.arange(len(ys) + 1) - 0.5,
            cells,
            cmap="viridis",
            norm=color_norm(cells, False),
        )
        plain_log_ticks(figure.colorbar(drawn, ax=panel).ax)
        for y, x in zip(*np.nonzero(np.isnan(cells)), strict=True):
            panel.text(x, y, "\N{MULTIPLICATION SIGN}", ha="center", va="center", color=GREY)
        panel.set_facecolor("#f3f4f6")
        panel.set_title(metric_label(outcome, metric), fontsize=9)
        for ticks, values in ((panel.set_xticks, xs), (panel.set_yticks, ys)):
            step = max(1, -(-len(values) // 5))
            ticks(range(0, len(values), step), [f"{v:.3g}" for v in values[::step]])
        panel.tick_params(labelsize=8)
        panel.set_xlabel(parameter_label(outcome, first.name), fontsize=8.5)
        panel.set_ylabel(parameter_label(outcome, second.name), fontsize=8.5)
    return figure


def _known(outcome: StudyOutcome, metric: str) -> bool:
    return bool(np.isfinite(column(outcome.done, metric)).any())


def has_maps(outcome: StudyOutcome) -> bool:
    """Whether the study is a grid of two numeric parameters with several values each."""
    axes = outcome.study.axes
    return (
        outcome.study.spec.sweep.kind == "grid"
        and len(axes) == 2
        and all(axis.numeric and len(axis.values or ()) > 1 for axis in axes)
    )
