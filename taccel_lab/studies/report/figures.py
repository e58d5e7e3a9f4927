# SPDX-License-Identifier: Apache-2.0
"""Pictures of all designs at once: trade-offs, metrics in pairs, parallel coordinates, curves."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.report.page import format_number
from taccel_lab.report.style import BLUE, GREEN, GREY, LIGHT, ORANGE, in_report_style, new_figure
from taccel_lab.studies.evaluate.design_row import DesignRow, is_feasible
from taccel_lab.studies.evaluate.runner import StudyOutcome
from taccel_lab.studies.report.values import compared, costs_of, pareto_front

if TYPE_CHECKING:
    from matplotlib.figure import Figure


MOST_PAIRED = 5
"""Metrics in the picture of pairs."""
MOST_AXES = 10
"""Axes of the parallel coordinates."""
_COLUMNS = 3
"""Panels in a row."""


def panel_grid(
    count: int, each: tuple[float, float], more: tuple[float, float] = (0.0, 0.0)
) -> tuple[Figure, Any]:
    """Figure and panels [row, column], three a row and as many shown as ``count``; sizes of each
    and of what is around them in inches."""
    columns = min(_COLUMNS, count)
    rows = -(-count // columns)
    size = each[0] * columns + more[0], each[1] * rows + more[1]
    figure, panels = new_figure(*size, rows, columns, squeeze=False)
    for panel in panels.flat[count:]:
        panel.set_visible(False)
    return figure, panels


def with_unit(name: str, unit: str) -> str:
    """``name [unit]``; the name alone where it ends with its unit already."""
    if unit in ("", "1") or name.lower().endswith("_" + unit.lower()):
        return name
    return f"{name} [{unit}]"


def metric_label(outcome: StudyOutcome, name: str) -> str:
    return with_unit(name, outcome.study.metrics[name].unit)


def parameter_label(outcome: StudyOutcome, name: str) -> str:
    return outcome.study.parameters[name].label


def column(designs: list[DesignRow], name: str) -> np.ndarray:
    """A metric or a numeric parameter of designs, NaN where there is none."""
    cells = ({**row.parameters, **row.figures}.get(name) for row in designs)
    return np.array([np.nan if value is None else value for value in cells], dtype=np.float64)


def _axis_text(outcome: StudyOutcome, name: str, sign: float) -> str:
    return f"{metric_label(outcome, name)}, {'less' if sign > 0 else 'more'} is better"


@in_report_style
def draw_pareto(
    outcome: StudyOutcome, front: list[str], best: list[str], worst: list[str]
) -> Figure:
    """The first two metrics against each other, the front joined, coloured by a parameter.

    Designs that break the constraints are small.
    """
    designs = outcome.done
    names = dict(list(compared(outcome).items())[:2])
    (x_name, x_sign), (y_name, y_sign) = names.items()
    x, y = column(designs, x_name), column(designs, y_name)
    figure, axes = new_figure(7.4, 5.0)
    axes.grid(True)
    axes.set_axisbelow(True)
    numeric = [axis for axis in outcome.study.axes if axis.numeric]
    style: dict[str, Any] = {"color": BLUE}
    if numeric:
        shade = column(designs, numeric[0].name)
        style = {"c": shade, "cmap": "viridis", "norm": color_norm(shade, numeric[0].log)}
    kept = [is_feasible(row, outcome.study.spec.constraints) for row in designs]
    sizes = np.where(kept, 34.0, 9.0)
    points = axes.scatter(x, y, s=sizes, edgecolors="white", linewidths=0.4, zorder=3, **style)
    if numeric:
        bar = figure.colorbar(points, ax=axes, label=parameter_label(outcome, numeric[0].name))
        plain_log_ticks(bar.ax)
    on_front = np.isin([row.id for row in designs], front)
    along = np.flatnonzero(on_front)[np.argsort(x[on_front], kind="stable")]
    axes.plot(x[along], y[along], color=ORANGE, linewidth=1.3, zorder=2, label="Pareto front")
    if not all(kept):
        axes.scatter([], [], s=9, color=GREY, label="breaks a constraint")
    axes.scatter(x[along], y[along], s=70, facecolors="none", edgecolors=ORANGE, zorder=4)
    where = {row.id: place for place, row in enumerate(designs)}
    for ids, color, mark, label in ((best, GREEN, "*", "best"), (worst, GREY, "X", "worst")):
        if ids and ids[0] in where:
            place = where[ids[0]]
            axes.scatter(
                x[place], y[place], s=150, marker=mark, color=color, edgecolors="white",
                zorder=5, label=label,
            )  # fmt: skip
    axes.set_xlabel(_axis_text(outcome, x_name, x_sign))
    axes.set_ylabel(_axis_text(outcome, y_name, y_sign))
    _draw_bounds(axes, outcome, x_name, y_name)
    for values, scale in ((x, axes.set_xscale), (y, axes.set_yscale)):
        if is_wide(values):
            scale("log")
    plain_log_ticks(axes)
    axes.legend(loc="best", frameon=True, framealpha=0.85, edgecolor="none")
    return figure


def _draw_bounds(axes: Any, outcome: StudyOutcome, x_name: str, y_name: str) -> None:
    """The side of each bound that a constraint excludes, shaded."""
    wide, tall = axes.get_xlim(), axes.get_ylim()
    for name, span, limits in (
        (x_name, axes.axvspan, wide),
        (y_name, axes.axhspan, tall),
    ):
        for constraint in outcome.study.spec.constraints:
            if constraint.metric != name:
                continue
            for low, high in ((limits[0], constraint.min), (constraint.max, limits[1])):
                if low is not None and high is not None and low < high:
                    label = f"breaks: {constraint.text()}"
                    span(low, high, color=GREY, alpha=0.18, linewidth=0, zorder=0, label=label)
    axes.set_xlim(wide)
    axes.set_ylim(tall)


def plain_log_ticks(axes: Any) -> None:
    """Numbers such as 0.2 and 30 on logarithmic axes, few of them."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    for axis in (axes.xaxis, axes.yaxis):
        if axis.get_scale() != "log":
            continue
        low, high = axis.get_view_interval()
        marks = (1.0,) if high > 1e3 * low else (1.0, 2.0, 5.0)
        axis.set_major_locator(LogLocator(subs=marks))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_locator(NullLocator())


def is_wide(values: np.ndarray) -> bool:
    """Whether values want a logarithmic axis."""
    known = values[np.isfinite(values)]
    return bool(len(known) and (known > 0).all() and known.max() > 30 * known.min())


def color_norm(values: np.ndarray, log: bool) -> Any:
    from matplotlib.colors import LogNorm, Normalize

    low, high = np.nanmin(values), np.nanmax(values)
    if not low < high:
        return Normalize(low - 0.5, high + 0.5)
    return LogNorm(low, high) if log or is_wide(values) else Normalize(low, high)


@in_report_style
def draw_pairs(outcome: StudyOutcome) -> Figure:
    """Every pair of the first metrics, with the front of each pair."""
    designs = outcome.done
    signs = dict(list(compared(outcome).items())[:MOST_PAIRED])
    names = list(signs)
    count = len(names) - 1
    figure, panels = new_figure(2.3 * count + 0.9, 2.1 * count + 0.7, count, count, squeeze=False)
    for row, y_name in enumerate(names[1:]):
        for col, x_name in enumerate(names[:-1]):
            axes = panels[row][col]
            if col > row:
                axes.set_visible(False)
                continue
            x, y = column(designs, x_name), column(designs, y_name)
            pair = {x_name: signs[x_name], y_name: signs[y_name]}
            front = pareto_front(costs_of(designs, pair))
            along = np.flatnonzero(front)[np.argsort(x[front], kind="stable")]
            axes.scatter(x, y, s=11, color=BLUE, alpha=0.75, linewidths=0)
            axes.plot(x[along], y[along], "o-", color=ORANGE, markersize=3.5, linewidth=1.0)
            axes.tick_params(labelsize=7.5)
            axes.locator_params(nbins=4)
            if row == count - 1:
                axes.set_xlabel(_two_lines(metric_label(outcome, x_name)), fontsize=8)
            else:
                axes.tick_params(labelbottom=False)
            if col == 0:
                axes.set_ylabel(_two_lines(metric_label(outcome, y_name)), fontsize=8)
            else:
                axes.tick_params(labelleft=False)
    return figure


def _two_lines(label: str) -> str:
    """A long label, its unit on its own line."""
    return label.replace(" [", "\n[") if len(label) > 16 else label


@in_report_style
def draw_parallel(outcome: StudyOutcome, front: list[str], best: list[str]) -> Figure:
    """Every design as a line over parameters and metrics, the better end of metrics at the top."""
    designs = outcome.done
    signs = compared(outcome)
    parameters = [axis.name for axis in outcome.study.axes if axis.numeric]
    parameters = [n for n in parameters if np.nanmax(v := column(designs, n)) > np.nanmin(v)]
    names = [*parameters, *signs][: max(MOST_AXES, len(parameters) + 1)]
    columns = np.stack([column(designs, name) for name in names], axis=1)
    low, high = np.nanmin(columns, axis=0), np.nanmax(columns, axis=0)
    unit = (columns - low) / np.where(high > low, high - low, 1.0)
    flip = np.array([signs.get(name, -1.0) > 0 for name in names])
    unit[:, flip] = 1 - unit[:, flip]
    figure, axes = new_figure(max(1.15 * len(names), 6.5), 4.3)
    at = np.arange(len(names))
    on_front, winner = set(front), best[:1]
    for row, line in zip(designs, unit, strict=True):
        if row.id not in on_front and row.id not in winner:
            axes.plot(at, line, color=LIGHT, linewidth=0.9, zorder=1)
    for row, line in zip(designs, unit, strict=True):
        if row.id in on_front and row.id not in winner:
            axes.plot(at, line, color=ORANGE, linewidth=1.2, alpha=0.8, zorder=2)
        elif row.id in winner:
            axes.plot(at, line, color=GREEN, linewidth=2.6, zorder=3)
    for place in range(len(names)):
        ends = (high[place], low[place]) if flip[place] else (low[place], high[place])
        axes.plot([place, place], [0, 1], color=GREY, linewidth=0.8, zorder=0)
        axes.text(place, -0.035, format_number(float(ends[0])), ha="center", va="top", fontsize=8)
        axes.text(place, 1.035, format_number(float(ends[1])), ha="center", va="bottom", fontsize=8)
    labels = [
        _two_lines(metric_label(outcome, n) if n in signs else parameter_label(outcome, n))
        for n in names
    ]
    axes.set_xticks(at, labels, rotation=28, ha="right", fontsize=8.5)
    axes.tick_params(axis="x", length=0, pad=12)
    axes.set_yticks([])
    axes.set_ylim(-0.06, 1.08)
    for side in ("left", "bottom"):
        axes.spines[side].set_visible(False)
    lines = [
        (LIGHT, "all designs"),
        (ORANGE, "Pareto front of the first two metrics"),
        (GREEN, "best"),
    ]
    for color, label in lines:
        axes.plot([], [], color=color, label=label)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.06), ncols=3, fontsize=9)
    return figure


MOST_TOOLS = 6
_DASHES = ("-", "--", ":", "-.")


def tool_curves(outcome: StudyOutcome) -> dict[str, list[tuple[DesignRow, dict[str, Any]]]]:
    """Stored presses straight down with two steps or more, by indenter, with their designs."""
    found: dict[str, list[tuple[DesignRow, dict[str, Any]]]] = {}
    for name, press in outcome.study.presses.items():
        if not getattr(press, "straight", False):
            continue
        for row in outcome.done:
            for curve in row.curves.get(name) or []:
                if len(curve["depth_mm"]) > 1:
                    found.setdefault(curve["indenter"], []).append((row, curve))
    return dict(list(found.items())[:MOST_TOOLS])


def has_contacts(outcome: StudyOutcome) -> bool:
    """Whether any curve has contact diameters."""
    return any(
        c.get("contact_diameter_mm") for made in tool_curves(outcome).values() for _, c in made
    )


@in_report_style
def draw_tools(outcome: StudyOutcome, contact: bool) -> Figure:
    """Force over depth, or the contact's diameter over the force, a panel for each indenter.

    Colours are the first numeric parameter, dashes the second where it has few values.
    """
    curves = tool_curves(outcome)
    if contact:
        curves = {
            tool: kept
            for tool, made in curves.items()
            if (kept := [(r, c) for r, c in made if c.get("contact_diameter_mm")])
        }
    figure, panels = panel_grid(len(curves), (3.3, 2.7), (1.0, 0.5))
    axes = [axis for axis in outcome.study.axes if axis.numeric]
    shade = (
        np.array([float(row.parameters[axes[0].name]) for row in outcome.done]) if axes else None
    )
    norm = color_norm(shade, axes[0].log) if shade is not None else None
    shades = _shades()
    dashes = _dashes(outcome, [axis.name for axis in axes[1:2]])
    for panel, (tool, made) in zip(panels.flat, curves.items(), strict=False):
        panel.grid(True)
        panel.set_axisbelow(True)
        for row, curve in made:
            # Flat tools touch all at once: their contact has no point of size 0.
            start = [] if contact and not tool.startswith("sphere") else [0.0]
            force = np.concatenate([start, [f[2] for f in curve["force_n"]]])
            other = curve["contact_diameter_mm"] if contact else curve["depth_mm"]
            other = np.concatenate([start, other])
            color = BLUE
            if norm is not None:
                color = shades(norm(row.parameters[axes[0].name]))
            dash = dashes.get(row.parameters[axes[1].name], "-") if len(axes) > 1 else "-"
            x, y = (force, other) if contact else (other, force)
            panel.plot(x, y, dash, color=color, linewidth=1.3)
        panel.set_title(tool)
        panel.set_xlim(left=0)
        panel.set_ylim(bottom=0)
        panel.set_xlabel("force [N]" if contact else "depth [mm]", fontsize=9)
        panel.set_ylabel("contact diameter [mm]" if contact else "force [N]", fontsize=9)
        panel.tick_params(labelsize=8)
    if norm is not None:
        from matplotlib.cm import ScalarMappable

        bar = figure.colorbar(
            ScalarMappable(norm, shades), ax=panels, label=parameter_label(outcome, axes[0].name)
        )
        plain_log_ticks(bar.ax)
    if dashes:
        handles = [
            panels[0][0].plot([], [], dash, color=GREY, label=format_number(value))[0]
            for value, dash in dashes.items()
        ]
        figure.legend(
            handles=handles, loc="outside lower center", ncols=len(handles), fontsize=9,
            title=parameter_label(outcome, axes[1].name), title_fontsize=9,
        )  # fmt: skip
    return figure


def _shades() -> Any:
    """Viridis without its yellow, which is hard to see as a line."""
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    return ListedColormap(colormaps["viridis"](np.linspace(0, 0.87, 256)))


def _dashes(outcome: StudyOutcome, names: list[str]) -> dict[Any, str]:
    """A dash for each value of a parameter; none where there are too many to tell apart."""
    values = sorted({row.parameters[name] for name in names for row in outcome.done})
    return dict(zip(values, _DASHES, strict=False)) if 1 < len(values) <= len(_DASHES) else {}


SHADES = ("-", "--", ":")
"""Line of the first, second and third best or worst design."""


def curves_of(design: DesignRow, press: str) -> list[dict[str, Any]]:
    """Records of a press with at least two steps."""
    return [c for c in design.curves.get(press) or [] if len(c["depth_mm"]) > 1]


def drawn_presses(outcome: StudyOutcome, designs: list[DesignRow]) -> list[str]:
    """Presses of the study that any of the designs has curves of."""
    return [name for name in outcome.study.presses if any(curves_of(d, name) for d in designs)]


@in_report_style
def draw_curves(outcome: StudyOutcome, best: list[DesignRow], worst: list[DesignRow]) -> Figure:
    """Force over depth, or over the sideways motion, in the first record of every press."""
    presses = drawn_presses(outcome, [*best, *worst])
    figure, panels = panel_grid(len(presses), (3.2, 2.5), (0.0, 0.4))
    for press, panel in zip(presses, panels.flat, strict=False):
        panel.grid(True)
        panel.set_axisbelow(True)
        for designs, color, word in ((worst, ORANGE, "worst"), (best, GREEN, "best")):
            for number, design in enumerate(designs):
                for curve in curves_of(design, press)[:1]:
                    label = f"{word} {number + 1}" if len(designs) > 1 else word
                    labels = _draw_curve(panel, curve, SHADES[number], color, label)
                    panel.set_xlabel(labels[0], fontsize=9)
                    panel.set_ylabel(labels[1], fontsize=9)
        panel.set_title(press)
        panel.set_xlim(left=0)
        if panel.get_xlabel().startswith("depth"):
            panel.set_ylim(bottom=0)
        panel.tick_params(labelsize=8)
    handles, labels = panels[0][0].get_legend_handles_labels()
    order = np.argsort(labels, kind="stable")
    figure.legend(
        [handles[i] for i in order], [labels[i] for i in order],
        loc="outside lower center", ncols=6, fontsize=9,
    )  # fmt: skip
    return figure


def _draw_curve(
    panel: Any, curve: dict[str, Any], dash: str, color: str, label: str
) -> tuple[str, str]:
    """Tangential force over shear of a press that goes sideways, normal force over depth of others.

    Returns the labels of both axes.
    """
    force = np.asarray(curve["force_n"], dtype=np.float64)
    shear = np.asarray(curve.get("shear_mm", np.zeros(len(force))), dtype=np.float64)
    turned = np.asarray(curve.get("twist_deg", np.zeros(len(force))), dtype=np.float64) != 0
    sideways = (shear != 0) & ~turned
    if sideways.any():
        first, last = np.flatnonzero(sideways)[[0, -1]]
        steps = slice(max(first - 1, 0), last + 2 if last + 1 < len(force) else last + 1)
        # The force on the indenter points against its motion.
        tangential = -np.sign(shear[sideways][0]) * force[steps, 0]
        keep = ~turned[steps]
        panel.plot(shear[steps][keep], tangential[keep], dash, color=color, label=label)
        return "shear [mm]", "tangential force [N]"
    depth = np.concatenate([[0.0], curve["depth_mm"]])
    panel.plot(depth, np.concatenate([[0.0], force[:, 2]]), dash, color=color, label=label)
    return "depth [mm]", "normal force [N]"
