# SPDX-License-Identifier: Apache-2.0
"""The report of a calibration of normals."""

from __future__ import annotations

from functools import partial

from taccel_lab.calibration.normals.pictures import draw_errors, draw_reliability
from taccel_lab.calibration.normals.result import NormalCalibration
from taccel_lab.calibration.result import in_figures
from taccel_lab.report.page import Page, Picture, Table

WORST_SHOWN = 10
"""Training presses in the table of those that are read worst."""


def normals_page(result: NormalCalibration) -> Page:
    """Tables worst first, error maps, reliability and training of one calibration."""
    tables, pictures = [], []
    if result.has_scores:
        tables = [_summary(result), _presses(result)]
        pictures = [
            Picture(
                "errors",
                partial(draw_errors, result),
                "The worst, the middle and the best held-out press. Errors are angles to the "
                "ball's normal in the dotted circle. Depths are integrated from the normals over "
                "the whole image, from the resting gel. The ball is aligned at its rim.",
            ),
            Picture(
                "reliability",
                partial(draw_reliability, result),
                "How large errors of held-out pixels are, by how large the model expects them to "
                "be, with what the circles may be off by. Points below the line: the model is more "
                "careful than it has to be.",
            ),
        ]
    if result.fit.left_out_deg:
        tables.append(_left_out(result))
    return Page(
        title="Calibration of surface normals",
        summary=_sentence(result),
        remarks=result.remarks,
        tables=tables,
        pictures=pictures,
        figures=result.figures(),
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
    text = ""
    if absolute is not None:
        text += (
            f"Depths are off by {absolute['mae_mm']:.3f} mm of {absolute['wanted_mm']:.2f} mm "
            "against the ball pressed into the stated pad, aligned on nothing; "
        )
    text += (
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
    given = result.heldout_means("given")
    used = result.heldout_means("used")
    labels = {
        "mean_deg": "normals, mean [deg]",
        "median_deg": "median [deg]",
        "p90_deg": "90th percentile [deg]",
        "flat_deg": "flat guess, mean [deg]",
        "depth_mae_mm": "depth aligned on the circle, mean absolute error [mm]",
        "depth_mm": "depth of the ball, mean [mm]",
    }
    rows = [[label, used[key], given[key]] for key, label in labels.items()]
    absolute = result.absolute_means()
    if absolute is not None:
        rows += [
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
        "another thickness shifts them. Presses that could not be read count as flat: "
        f"{', '.join(result.failed) or 'none'}. Beside the figures, with labels that images "
        f"reject: {', '.join(sorted(result.rejected)) or 'none'}.",
    )


def _presses(result: NormalCalibration) -> Table:
    order = sorted(result.heldout, key=lambda item: -item.used.mean_deg)
    return Table(
        "Held-out presses, worst first",
        ["press", "mean [deg]", "90 % [deg]", "given circle [deg]", "depth [mm]", "aligned [mm]"],
        [
            [
                item.name,
                item.used.mean_deg,
                item.used.p90_deg,
                item.given.mean_deg,
                float("nan") if item.depth is None else item.depth.mae_mm,
                item.used.depth_mae_mm,
            ]
            for item in order
        ],
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
    )
