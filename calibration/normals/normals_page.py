# SPDX-License-Identifier: Apache-2.0
"""The report of a calibration of normals."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.normals.block import normal_scores
from taccel_lab.calibration.normals.result import NormalCalibration
from taccel_lab.calibration.normals.score import HeldoutNormals, ball_depth_mm
from taccel_lab.calibration.response.frame import CaptureScene
from taccel_lab.calibration.result import in_figures
from taccel_lab.geometry import PixelGrid
from taccel_lab.optics.image_measures import crop_slices
from taccel_lab.report.page import Page, Table, picture
from taccel_lab.report.style import BLUE, LIGHT, ORANGE, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

WORST_SHOWN = 10
"""Training presses in the table of those that are read worst."""
ROWS = 3
"""Presses that are shown: the worst, the middle and the best."""
DRAWN_CIRCLE = 361


def normals_page(result: NormalCalibration) -> Page:
    """Tables worst first, error maps, reliability and training of one calibration."""
    tables, pictures = [], []
    if result.has_scores:
        tables = [_summary(result), _presses(result)]
        pictures = [_errors(result), _reliability(result)]
    if result.fit.left_out_deg:
        tables.append(_left_out(result))
    return Page(
        "Calibration of surface normals",
        _sentence(result),
        result.remarks,
        tables,
        pictures,
        result.figures(),
        scores=tuple(normal_scores(result.evidence.residuals)),
    )


def _sentence(result: NormalCalibration) -> str:
    text = (
        f"{result.fit.model.config.members} networks from colour and position to the surface "
        f"normal, fitted to {len(result.train_names)} presses in {result.fit.seconds:.0f} s. "
    )
    if result.gel is not None:
        text += f"{result.gel.sentence()} "
    if not result.has_scores:
        return text + "No press was held out."
    scores = result.heldout_means("used")
    count = len(in_figures(result.heldout))
    text += (
        f"Normals of {count} held-out presses are off by {scores['mean_deg']:.2f} "
        f"degrees on average (a flat guess by {scores['flat_deg']:.1f}). " + _depth_sentence(result)
    )
    if result.final is not None:
        presses = len(result.final.inputs)
        text += f" The profile's networks were fitted to all {presses} presses after that."
    return text


def _depth_sentence(result: NormalCalibration) -> str:
    """The absolute error first, then the one that alignment leaves."""
    scores, absolute = result.heldout_means("used"), result.absolute_means()
    text = (
        f"Depths are off by {absolute['mae_mm']:.3f} mm of {absolute['wanted_mm']:.2f} mm "
        "against the ball pressed into the stated pad, aligned on nothing; "
        f"aligned on the circle by {scores['depth_mae_mm']:.3f} mm of {scores['depth_mm']:.2f} mm."
    )
    if result.synthetic is not None:
        found = result.synthetic
        text += (
            f" On {found.count} simulated presses of other tools that no network saw depths are "
            f"off by {found.rmse_mm:.3f} mm rms in the dent (median press "
            f"{found.median_press_share:.0%} of its depth, worst {found.worst_press_mm:.3f} mm)."
        )
    return text


def _summary(result: NormalCalibration) -> Table:
    given, used = result.heldout_means("given"), result.heldout_means("used")
    labels = {
        "mean_deg": "normals, mean [deg]",
        "median_deg": "median [deg]",
        "p90_deg": "90th percentile [deg]",
        "flat_deg": "flat guess, mean [deg]",
        "depth_mae_mm": "depth aligned on the circle, mean absolute error [mm]",
        "depth_mm": "depth of the ball, mean [mm]",
    }
    absolute = result.absolute_means()
    rows = [
        *([label, used[key], given[key]] for key, label in labels.items()),
        ["absolute depth, mean absolute error [mm]", absolute["mae_mm"], "-"],
        ["deepest point, read less wanted [mm]", absolute["deepest_mm"], "-"],
        ["deepest point, wanted [mm]", absolute["wanted_mm"], "-"],
        ["heights within one standard deviation (68 %)", absolute["within_68"], "-"],
        ["heights within two (95 %)", absolute["within_95"], "-"],
    ]
    return Table(
        "Held-out presses",
        ["figure", "in the circles used", "in the circles given"],
        rows,
        "Chosen before any image was read, scored when the model was frozen. Circles used: labels "
        "corrected by the training presses; without a label, circles found in the image. Circles "
        "drawn by hand are off by a pixel or more, an error in both columns. Absolute depths are "
        "compared with the ball pressed into the stated pad until it touches in the circle: "
        "another thickness shifts them. Standard deviations are those of the profile. Presses "
        "that could not be read count as flat: "
        f"{', '.join(result.failed) or 'none'}. Beside the figures, with labels that images "
        f"reject: {', '.join(sorted(result.rejected)) or 'none'}.",
    )


def _presses(result: NormalCalibration) -> Table:
    return Table.of(
        "Held-out presses, worst first",
        sorted(result.heldout, key=lambda item: -item.used.mean_deg),
        {
            "press": "name",
            "mean [deg]": "used.mean_deg",
            "90 % [deg]": "used.p90_deg",
            "given circle [deg]": "given.mean_deg",
            "depth [mm]": "depth.mae_mm",
            "aligned [mm]": "used.depth_mae_mm",
        },
    )


def _left_out(result: NormalCalibration) -> Table:
    errors = result.fit.left_out_deg
    order = sorted(errors, key=lambda name: -errors[name])[:WORST_SHOWN]
    return Table(
        "Training presses, worst first",
        ["press", "left-out error [deg]"],
        [[name, errors[name]] for name in order],
        "Mean angle inside the contact by a network that never saw the press: a wrong circle "
        "stands out here.",
        folded=True,
    )


@picture(
    "errors",
    "The worst, the middle and the best held-out press. Errors are angles to the ball's normal in "
    "the dotted circle. Depths are integrated from the normals over the whole image, from the "
    "resting gel. The ball is aligned at its rim.",
)
def _errors(result: NormalCalibration) -> Figure:
    """The worst, the middle and the best held-out press: image, error, expected error, profile."""
    order = sorted(result.heldout, key=lambda item: -item.used.mean_deg)
    shown = [order[i] for i in sorted({0, len(order) // 2, len(order) - 1})][:ROWS]
    figure, axes = new_figure(10.5, 2.75 * len(shown) + 0.3, len(shown), 4, squeeze=False)
    top = max(5.0, float(np.nanpercentile([np.nanmax(i.error_deg) for i in shown], 60)) * 0.7)
    drawn = [_draw_row(row, item, result.scene, top) for row, item in zip(axes, shown, strict=True)]
    for ax, title in zip(
        axes[0], ("captured", "error of the normals", "expected error", "depth, row"), strict=True
    ):
        ax.set_title(title)
    # Below: beside the maps it would stand at the axis of the depths.
    bar = figure.colorbar(drawn[-1], ax=axes[:, 1:3], location="bottom", shrink=0.75, aspect=30)
    bar.set_label("angle [degrees]")
    return figure


def _draw_row(row: np.ndarray, item: HeldoutNormals, scene: CaptureScene, top: float) -> AxesImage:
    grid, circle = scene.grid, item.frame.circle
    crop = crop_slices(circle.center_px, circle.radius_px, grid)
    extent = _extent(crop, grid)
    row[0].imshow(np.clip(item.frame.image[crop], 0, 255).astype(np.uint8), extent=extent)
    row[0].set_ylabel(f"{item.name}\n{item.used.mean_deg:.1f}° mean", fontsize=9)
    shown = row[1].imshow(item.error_deg[crop], extent=extent, vmin=0, vmax=top, cmap="magma")
    expected = np.where(np.isfinite(item.error_deg), item.predicted.sigma_deg * 1.2533, np.nan)
    row[2].imshow(expected[crop], extent=extent, vmin=0, vmax=top, cmap="magma")
    for ax in row[:3]:
        _draw_circle(ax, circle, grid)
        ax.set_xticks([])
        ax.set_yticks([])
    _draw_profile(row[3], item, scene)
    return shown


def _draw_profile(ax: Axes, item: HeldoutNormals, scene: CaptureScene) -> None:
    """Integrated and true depth along the row through the contact's centre."""
    grid, circle = scene.grid, item.frame.circle
    v = int(np.clip(round(circle.v_px), 0, grid.height_px - 1))
    across = (np.arange(grid.width_px) - circle.u_px) * grid.mm_per_px_x
    ratio = np.abs(across) / (circle.radius_px * grid.mm_per_px_x)
    found = -item.height_m[v] * 1e3
    wanted = ball_depth_mm(circle, scene)[v]
    rim = np.abs(ratio - 1) < 0.06
    offset = found[rim].mean() - wanted[rim].mean() if rim.any() else 0.0
    near = ratio < 2.2
    inside = ratio <= 1
    ax.plot(across[near], found[near], color=BLUE, label="integrated")
    ax.plot(across[inside], wanted[inside] + offset, color=ORANGE, ls="--", label="ball")
    ax.axhline(0, color=LIGHT, lw=0.8)
    ax.invert_yaxis()
    ax.set(xlabel="x [mm]", ylabel="depth [mm]")
    ax.legend(fontsize=7, loc="lower left", handlelength=1.2)


def _extent(crop: tuple[slice, slice], grid: PixelGrid) -> tuple[float, float, float, float]:
    rows, columns = crop
    left, right = (columns.start - 0.5) * grid.mm_per_px_x, (columns.stop - 0.5) * grid.mm_per_px_x
    top, bottom = (rows.start - 0.5) * grid.mm_per_px_y, (rows.stop - 0.5) * grid.mm_per_px_y
    return left, right, bottom, top


def _draw_circle(ax: Axes, circle: ContactCircle, grid: PixelGrid) -> None:
    angle = np.linspace(0, 2 * np.pi, DRAWN_CIRCLE)
    radius = circle.radius_px * grid.mm_per_px_x
    ax.plot(
        circle.u_px * grid.mm_per_px_x + radius * np.cos(angle),
        circle.v_px * grid.mm_per_px_y + radius * np.sin(angle),
        color="white", lw=0.8, ls=":",
    )  # fmt: skip


@picture(
    "reliability",
    "How large errors of held-out pixels are, by how large the model expects them to be, with what "
    "the circles may be off by. Points below the line: the model is more careful than it has to "
    "be.",
)
def _reliability(result: NormalCalibration) -> Figure:
    """Observed over expected errors of held-out pixels."""
    found = result.reliability
    assert found is not None
    figure, ax = new_figure(4.6, 4.0)
    top = 1.1 * max(*found.expected_deg, *found.observed_deg)
    ax.plot([0, top], [0, top], color=LIGHT, lw=1.2, label="as expected")
    ax.plot(found.expected_deg, found.observed_deg, "o-", color=BLUE, label="held-out pixels")
    ax.set(xlim=(0, top), ylim=(0, top), aspect="equal")
    ax.set(xlabel="expected error [degrees]", ylabel="observed error [degrees]")
    ax.set_title(
        f"within the 68 % radius: {found.within_68:.0%}, within the 95 % radius: "
        f"{found.within_95:.0%}",
        fontsize=9,
    )
    ax.legend(loc="upper left")
    return figure
