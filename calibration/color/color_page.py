# SPDX-License-Identifier: Apache-2.0
"""The report of a colour calibration: figures, presses worst first, and where the errors are."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.calibration.color.block import color_scores
from taccel_lab.calibration.color.result import ColorCalibration, mean_bare
from taccel_lab.calibration.result import in_figures
from taccel_lab.exporters.taxim_table import TABLE_FILE, TableFile, write_table
from taccel_lab.optics.image_measures import crop_slices
from taccel_lab.report.page import Page, Table, picture
from taccel_lab.report.style import INK, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FIGURES = (
    ("crop_psnr_db", "PSNR in the 1.6 r crop [dB]"),
    ("crop_ssim", "SSIM in the crop"),
    ("disc_l1", "L1 in the contact disc [levels]"),
    ("crop_l1", "L1 in the crop [levels]"),
    ("full_l1", "L1 over the image [levels]"),
)
SHOWN = 5
"""Held-out presses in the picture, from the worst to the best."""
ERROR_LEVELS = 24.0
"""Mean error over the channels that is drawn darkest [levels]."""


def color_page(result: ColorCalibration) -> Page:
    """The page of a colour calibration."""
    return Page(
        "Colour calibration",
        _summary(result),
        result.remarks,
        _tables(result),
        [*([_heldout(result)] if result.heldout else []), _coverage(result)],
        {"color": result.figures()},
        _files(result),
        scores=tuple(color_scores(result.evidence.residuals)),
    )


def _files(result: ColorCalibration) -> dict[str, Callable[[Path], None]]:
    """The table beside the report, for ``taccel-lab export --table``."""
    if result.table is None:
        return {}
    figures: dict[str, float] = {}
    if scores := result.table_means():
        figures = {f"heldout_{key}": scores[key] for key, _ in FIGURES}
        figures["heldout_presses"] = float(len(result.table_scores))
    size = (result.captures.grid.width_px, result.captures.grid.height_px)
    return {TABLE_FILE: partial(write_table, TableFile(result.table, size, figures))}


PLACED_BY = {"label": "placed by label", "found": "placed where they are found"}
"""Columns of the held-out presses by how they were placed."""


def figure_columns(result: ColorCalibration) -> dict[str, dict[str, float]]:
    """Mean figures by what was rendered, for tables; those that are quoted first."""
    columns: dict[str, dict[str, float]] = {}
    if result.has_scores:
        columns[PLACED_BY[result.placement]] = result.heldout_means()
        columns["background only"] = mean_bare(result.heldout, result.failures)
    if result.table_scores:
        columns["Taxim's table"] = result.table_means()
    return columns


def _summary(result: ColorCalibration) -> str:
    options = result.fit.options
    network = "-".join(str(width) for width in options.hidden)
    parts = [
        f"A network of {network} units was fitted to {len(result.train_names)} presses in "
        f"{result.fit.seconds:.0f} s; surfaces: {result.surface_provider}."
    ]
    if result.gel is not None:
        parts.append(result.gel.sentence())
    if result.has_scores:
        score = result.heldout_means()
        failures, scored = in_figures(result.failures), in_figures(result.heldout)
        failed = f" ({len(failures)} of them failed)" if failures else ""
        parts.append(
            f"{len(scored) + len(failures)} presses that nothing had seen before "
            f"the model was frozen{failed} are rendered in the light of each capture, "
            f"{PLACED_BY[result.placement]}, at {score['crop_psnr_db']:.1f} dB in the "
            f"crop around the contact and {score['disc_l1']:.2f} levels of error inside it."
        )
        if result.rejected:
            parts.append(
                f"Beside them, with labels that images reject: {', '.join(result.rejected)}."
            )
        if result.final is not None:
            presses = len(result.final.inputs)
            parts.append(f"The profile's colours were fitted to all {presses} presses after that.")
    else:
        parts.append("No press was held out, so there are no figures of presses it never saw.")
    return " ".join(parts)


def _tables(result: ColorCalibration) -> list[Table]:
    tables = []
    columns = figure_columns(result)
    if columns:
        tables.append(
            Table(
                "Figures",
                ("figure", *columns),
                [(label, *(column[key] for column in columns.values())) for key, label in FIGURES],
                "Held-out presses; quote the first column. By label: where the label puts the "
                "ball, plus the mean shift of the training labels. Failures count as the bare "
                "background."
                " Renders are in the capture's own light, fitted beyond 2 contact radii.",
            )
        )  # fmt: skip
    tables.append(_press_table(result))
    region = [(name, *bounds) for name, bounds in result.valid_region.items()]
    tables.append(Table("Where the model holds", ("quantity", "from", "to"), region, folded=True))
    return tables


def _press_table(result: ColorCalibration) -> Table:
    rows: list[tuple[Any, ...]] = []
    for item in result.heldout:
        score, placed = item.score, item.placed
        rows.append(
            (item.name, "held out", placed.u_px, placed.v_px, placed.radius_px, score.disc_l1,
             score.crop_psnr_db, score.crop_ssim, score.crop_l1)
        )  # fmt: skip
    for name, circle in zip(result.train_names, result.circles, strict=True):
        disc_l1 = result.fit.disc_l1_train[name]
        rows.append(
            (name, "fitted", circle.u_px, circle.v_px, circle.radius_px, disc_l1, *(None,) * 3)
        )
    return Table(
        "Presses, worst first",
        ("press", "", "u [px]", "v [px]", "radius [px]", "L1 disc", "PSNR crop [dB]", "SSIM crop",
         "L1 crop"),
        sorted(rows, key=lambda row: -row[5]),
        "Fitted presses tell which capture is off; only held-out ones are scores. L1: mean "
        "absolute error in levels of 255, in the contact's disc or in the crop of 1.6 radii.",
        folded=True,
    )  # fmt: skip


@picture(
    "heldout",
    "Held-out presses from the worst to the best, placed as the quoted figures have them: capture, "
    "render, mean absolute error over the channels. The circle is the one in which figures are "
    "taken.",
)
def _heldout(result: ColorCalibration) -> Figure:
    """Capture, render and error of held-out presses, one a column."""
    from matplotlib.patches import Circle

    order = sorted(result.heldout, key=lambda item: item.score.crop_psnr_db)
    places = np.linspace(0, len(order) - 1, min(SHOWN, len(order))).round().astype(int)
    items = [order[i] for i in np.unique(places)]
    figure, axes = new_figure(1.9 * len(items) + 1.2, 6.4, 3, len(items), squeeze=False)
    shown = None
    for column, item in enumerate(items):
        rows, columns = crop_slices(
            item.circle.center_px, item.circle.radius_px, result.captures.grid
        )
        render = item.shown
        error = np.abs(item.captured.astype(float) - render).mean(axis=-1)
        for axis, image in zip(axes[:2, column], (item.captured, render), strict=True):
            axis.imshow(np.clip(image[rows, columns] / 255.0, 0, 1))
        shown = axes[2, column].imshow(
            error[rows, columns], cmap="magma_r", vmin=0, vmax=ERROR_LEVELS
        )
        center = (item.circle.u_px - columns.start, item.circle.v_px - rows.start)
        for axis in axes[:, column]:
            axis.add_patch(
                Circle(center, item.circle.radius_px, fill=False, edgecolor=INK, linewidth=0.8)
            )
            axis.set_xticks([])
            axis.set_yticks([])
        name = item.name if len(item.name) <= 18 else "..." + item.name[-15:]
        axes[0, column].set_title(
            f"{name}\n{item.score.crop_psnr_db:.1f} dB, L1 {item.score.disc_l1:.1f}", fontsize=9
        )
    for axis, label in zip(axes[:, 0], ("capture", "render", "error"), strict=True):
        axis.set_ylabel(label)
    if shown is not None:
        figure.colorbar(shown, ax=list(axes[2]), label="error [levels]", shrink=0.9)
    return figure


@picture(
    "coverage",
    "Contacts on the background, by their error: colours are only known where balls were.",
)
def _coverage(result: ColorCalibration) -> Figure:
    """All contacts on the background, those with figures by their error."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.patches import Ellipse

    grid = result.captures.grid
    errors = {**result.fit.disc_l1_train, **result.heldout_l1()}
    contacts = dict(zip(result.train_names, result.circles, strict=True))
    contacts |= {item.name: item.placed for item in result.heldout}
    height = 6.4 * min(1.25, grid.height_px / grid.width_px)
    figure, axis = new_figure(7.6, height + 0.5)
    axis.imshow(np.clip(result.fit.background / 255.0, 0, 1))
    limits = (min(errors.values()), max(errors.values()))
    scale = ScalarMappable(Normalize(*limits), "plasma")
    ratio = grid.mm_per_px_x / grid.mm_per_px_y
    for name, circle in contacts.items():
        color: Any = scale.to_rgba(np.array(errors[name]))
        size = 2 * circle.radius_px
        axis.add_patch(
            Ellipse(
                (circle.u_px, circle.v_px), size, size * ratio, fill=False, edgecolor=color,
                linewidth=1.6,
            )
        )  # fmt: skip
    axis.set(xlabel="column [px]", ylabel="row [px]")
    figure.colorbar(scale, ax=axis, label="L1 in the contact [levels]", shrink=0.9)
    return figure
