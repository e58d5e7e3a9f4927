# SPDX-License-Identifier: Apache-2.0
"""The report of a force model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.learning.force.result import ForceCalibration
from taccel_lab.learning.force.score import Errors, outside_rows
from taccel_lab.report.lead import Score
from taccel_lab.report.page import Page, Table, picture
from taccel_lab.report.style import BLUE, GREY, LIGHT, ORANGE, new_figure
from taccel_lab.with_error import NORMAL_95

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS = (
    "", "images", "Fz error [N]", "of [N]", "median relative", "shear error [N]", "of [N]",
    "Tz error [N mm]", "Tx, Ty error [N mm]", "area error [mm2]", "patch error [N]", "inside 95 %",
)  # fmt: skip
BY = (
    ("depth", "By depth past first touch"),
    ("shear", "By force along the face over force along z"),
    ("place", "By distance from the sensor's middle"),
    ("motion", "By motion"),
    ("object", "By object"),
    ("unit", "By unit"),
)
"""Tables of ``ForceCalibration``, and their titles."""
SHOWN = 6
"""Touches whose patches are drawn."""


def force_page(result: ForceCalibration) -> Page:
    """Errors by depth, shear and place, wrong images, and some touches."""
    split = result.split
    units = ", ".join(map(str, split.test_units)) or "none"
    floor = result.label_floor_n
    return Page(
        title="Force from images",
        summary=(
            f"A network of {result.parameter_count:,} numbers, trained on "
            f"{result.counts['training']:,} images of simulated touches; {result.headline()}. "
            f"Held out: objects {', '.join(split.test_objects) or 'none'}; units {units} "
            f"({split.rule}). Labels are known to {floor[0]:.3f} N (median of their estimated "
            f"error, 95 % below {floor[1]:.3f} N). Forces hold for the profile's modulus. With "
            "moduli drawn for each unit and touch, which no image shows, the force along z is off "
            f"by {result.unknown_stiffness_n:.3f} N. In the background's own light it is off by "
            f"{result.same_light.fz_n:.3f} N."
        ),
        remarks=result.remarks,
        tables=[
            _table("All", [result.overall, *([result.at_rest] if result.at_rest else [])]),
            *(replace(_table(words, result.tables[name]), folded=True) for name, words in BY),
            Table(
                "Images that are not of this sensor",
                ["what", "images", "found"],
                [[one.name, one.images, f"{one.outside:.1%}"] for one in result.imposters],
                f"Made of held-out images, of which {result.false_alarms:.2%} are called "
                "outside as they are.",
                folded=True,
            ),
        ],
        pictures=[_predicted(result), _errors(result), _patches(result), _loss(result)],
        figures=result.figures(),
        scores=_scores(result),
    )


def _scores(result: ForceCalibration) -> tuple[Score, ...]:
    """Errors over all held-out images that press."""
    all_of, on = result.overall, f"{result.overall.images:,} held-out simulated images"
    return (
        Score(
            f"{all_of.fz_n:.3f}",
            "N rms",
            "error of the normal force",
            f"{on}; guessing zero is off by {all_of.fz_spread_n:.2f}",
        ),
        Score(
            f"{all_of.shear_n:.3f}",
            "N rms",
            "error of the tangential force",
            f"{on}; guessing zero is off by {all_of.shear_spread_n:.2f}",
        ),
        Score(f"{all_of.inside95:.0%}", "", "of the forces inside their 95 % interval", on),
    )


def _table(title: str, rows: Sequence[Errors]) -> Table:
    def cells(row: Errors) -> list[Any]:
        relative = "" if np.isnan(row.fz_relative) else f"{row.fz_relative:.1%}"
        return [
            row.name, row.images, f"{row.fz_n:.3g}", f"{row.fz_spread_n:.3g}", relative,
            f"{row.shear_n:.3g}", f"{row.shear_spread_n:.3g}", f"{row.tz_nmm:.3g}",
            f"{row.tilt_nmm:.3g}", f"{row.area_mm2:.3g}", f"{row.patch_n:.3g}",
            f"{row.inside95:.0%}",
        ]  # fmt: skip

    return Table(
        title,
        COLUMNS,
        [cells(row) for row in rows],
        "Root mean squares over held-out images that press; 'of' is that of the force itself; the "
        "median is of images above 0.2 N.",
    )


@picture(
    "predicted",
    "Estimated against simulated forces, held-out test set; grey ones are outside.",
)
def _predicted(result: ForceCalibration) -> Figure:
    """Predicted over simulated: forces, moment about z, area."""
    truth, predicted = result.test.targets, result.predicted.targets
    far = outside_rows(result.predicted, result.config)
    figure, axes = new_figure(11.4, 3.0, 1, 4)
    for panel, columns, label in (
        (axes[0], (2,), "force along z [N]"),
        (axes[1], (0, 1), "force along the face [N]"),
        (axes[2], (5,), "moment about z [N mm]"),
        (axes[3], (6,), "area [mm2]"),
    ):
        for column, color in zip(columns, (BLUE, ORANGE), strict=False):
            panel.plot(
                truth[~far, column], predicted[~far, column], ".", ms=2.5, color=color,
                label="xy"[column] if len(columns) > 1 else None,
            )  # fmt: skip
            panel.plot(truth[far, column], predicted[far, column], "x", ms=3, color=GREY)
        ends = [float(truth[:, columns].min()), float(truth[:, columns].max())]
        panel.plot(ends, ends, color=LIGHT, lw=1, zorder=0)
        panel.set_xlabel(f"simulated: {label}")
        if len(columns) > 1:
            panel.legend()
    axes[0].set_ylabel("predicted")
    return figure


@picture(
    "errors",
    "Errors of the force along z and along the face by depth, shear and place, and how large "
    "stated standard deviations are beside them.",
)
def _errors(result: ForceCalibration) -> Figure:
    """Errors by bins, and how true the standard deviations are."""
    figure, axes = new_figure(11.4, 3.2, 1, 4)
    for panel, (name, label) in zip(
        axes[:3],
        (("depth", "depth"), ("shear", "shear over normal"), ("place", "from the middle")),
        strict=True,
    ):
        rows = result.tables[name]
        x = np.arange(len(rows))
        panel.bar(x - 0.2, [row.fz_n for row in rows], 0.4, color=BLUE, label="along z")
        panel.bar(x + 0.2, [row.shear_n for row in rows], 0.4, color=ORANGE, label="along the face")
        panel.set_xticks(x, [row.name for row in rows], rotation=30, ha="right", fontsize=8)
        panel.set_title(label)
    axes[0].set_ylabel("error [N, rms]")
    axes[0].legend(fontsize=8)
    sigma = result.predicted.sigma * np.array(result.config.sigma_factor)
    away = np.abs(result.predicted.targets - result.test.targets)
    stated = np.linspace(0.02, 3.0, 60)
    for columns, color, label in (((2,), BLUE, "along z"), ((0, 1), ORANGE, "along the face")):
        over = (away[:, columns] / sigma[:, columns]).ravel()
        axes[3].plot(stated, [(over <= s).mean() for s in stated], color=color, label=label)
    axes[3].axvline(NORMAL_95, color=LIGHT, lw=1)
    axes[3].axhline(0.95, color=LIGHT, lw=1)
    axes[3].set_xlabel("within this number of standard deviations")
    axes[3].set_title("share of the errors")
    return figure


@picture(
    "patches",
    "Held-out touches: change of colour, force along z by patch simulated and estimated, arrows "
    "along the face.",
)
def _patches(result: ForceCalibration) -> Figure:
    """Some held-out touches, spread over the forces along z."""
    samples, predicted = result.test, result.predicted
    touched = np.flatnonzero(samples.targets[:, 2] > 0.2 * samples.targets[:, 2].max())
    if not len(touched):
        touched = np.array([int(np.argmax(samples.targets[:, 2]))])
    ranked = touched[np.argsort(samples.targets[touched, 2], kind="stable")]
    chosen = ranked[np.unique(np.linspace(0, len(ranked) - 1, SHOWN).round().astype(int))]
    figure, axes = new_figure(1.9 * len(chosen) + 0.6, 6.4, 3, len(chosen), squeeze=False)
    for panels, row in zip(axes.T, chosen.tolist(), strict=True):
        change = samples.change[row].astype(np.float32).transpose(1, 2, 0)
        panels[0].imshow(np.clip(0.5 + change / 160, 0, 1))
        name = f"{samples.about['object'][row]}, {samples.about['depth_mm'][row]:.2f} mm"
        panels[0].set_title(name, fontsize=8)
        simulated = samples.patches_n[row]
        top = max(float(simulated[2].max()), 1e-6)
        for panel, forces, title in (
            (panels[1], simulated, "simulated"),
            (panels[2], predicted.patches_n[row], "predicted"),
        ):
            draw_forces(panel, forces.transpose(1, 2, 0), top)
            panel.set_title(f"{title}: {forces[2].sum():.2f} N", fontsize=8)
        for panel in panels:
            panel.set_axis_off()
    return figure


def draw_forces(axes: Any, forces_n: np.ndarray, top_n: float) -> Any:
    """Forces by patch [row, column, 3]: those along z as colours up to ``top_n``, those along the
    face as arrows, of which a patch's length is a quarter of ``top_n``."""
    image = axes.imshow(forces_n[..., 2], cmap="magma_r", vmin=0, vmax=top_n)
    rows, columns = np.indices(forces_n.shape[:2])
    axes.quiver(
        columns, rows, forces_n[..., 0], forces_n[..., 1], angles="xy", scale_units="xy",
        scale=0.25 * top_n, color=BLUE, width=0.012,
    )  # fmt: skip
    return image


@picture("loss", "Loss of the training's batches.")
def _loss(result: ForceCalibration) -> Figure:
    """Loss over steps."""
    figure, axes = new_figure(5.6, 2.8)
    axes.plot(*zip(*result.trained.curve, strict=True), color=BLUE, lw=1)
    axes.set_xlabel("step")
    axes.set_ylabel("loss")
    return figure
