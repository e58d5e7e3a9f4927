# SPDX-License-Identifier: Apache-2.0
"""Pictures of single designs against each other: force over depth in every press."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.report.style import GREEN, ORANGE, in_report_style, new_figure
from taccel_lab.studies.evaluate.design_row import DesignRow
from taccel_lab.studies.evaluate.runner import StudyOutcome

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
    columns = min(3, len(presses))
    rows = -(-len(presses) // columns)
    figure, panels = new_figure(3.2 * columns, 2.5 * rows + 0.4, rows, columns, squeeze=False)
    for place, panel in enumerate(panels.flat):
        if place >= len(presses):
            panel.set_visible(False)
            continue
        panel.grid(True)
        panel.set_axisbelow(True)
        for designs, color, word in ((worst, ORANGE, "worst"), (best, GREEN, "best")):
            for number, design in enumerate(designs):
                for curve in curves_of(design, presses[place])[:1]:
                    label = f"{word} {number + 1}" if len(designs) > 1 else word
                    labels = _draw_curve(panel, curve, SHADES[number], color, label)
                    panel.set_xlabel(labels[0], fontsize=9)
                    panel.set_ylabel(labels[1], fontsize=9)
        panel.set_title(presses[place])
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
