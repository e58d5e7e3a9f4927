# SPDX-License-Identifier: Apache-2.0
"""Curves of all designs, tool by tool."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.report.html import format_number
from taccel_lab.report.style import BLUE, GREY, in_report_style, new_figure
from taccel_lab.studies.evaluate.design_row import DesignRow
from taccel_lab.studies.evaluate.runner import StudyOutcome
from taccel_lab.studies.report.figures import color_norm, parameter_label, plain_log_ticks

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_TOOLS = 6
_COLUMNS = 3
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
    columns = min(_COLUMNS, len(curves))
    rows = -(-len(curves) // columns)
    figure, panels = new_figure(3.3 * columns + 1.0, 2.7 * rows + 0.5, rows, columns, squeeze=False)
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
    for panel in list(panels.flat)[len(curves) :]:
        panel.set_visible(False)
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
