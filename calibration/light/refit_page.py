# SPDX-License-Identifier: Apache-2.0
"""Report of a refit: what changed, what it gains on frames left out, the two backgrounds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.calibration.light.refit_result import CHANNELS, FrameError, RefitCalibration
from taccel_lab.profile import SensorProfile
from taccel_lab.report.page import Page, Table, picture
from taccel_lab.report.style import BLUE, GREY, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def refit_page(result: RefitCalibration, old: SensorProfile) -> Page:
    """The page of ``taccel-lab calibrate refit``."""
    change, sigma = result.fit.change, result.fit.sigma
    rows = zip(
        CHANNELS, change.response, sigma.response, change.light.gain, sigma.light.gain,
        change.light.offset, *change.light.gradient.T, strict=True,
    )  # fmt: skip
    tables = [
        Table(
            "What changed",
            ("channel", "response", "sigma", "gain", "sigma", "offset", "to the right", "down"),
            list(rows),
            "Response: factor of the colour change; gain: of the background. Offset and gradient "
            "(middle to border) in levels of 255. Sigma by leaving one frame out.",
        ),
        _errors_of(
            "Frames left out of the fit",
            result.errors,
            "Mean absolute error [levels of 255], worst first.",
        ),
    ]
    if result.heldout:
        tables.append(
            _errors_of(
                "Held-out presses",
                result.heldout,
                "Presses without any part in the refit, by their labels or, without one, where "
                "their own images show them.",
            )
        )
    return Page(
        "Refit to the light of today",
        f"{len(result.errors)} new frames, each left out of the fit in turn: mean error "
        f"{result.mean('before'):.2f} levels before and {result.mean('after'):.2f} after "
        "(contact disc of presses, untouched frames whole), "
        f"{result.mean('whole_before'):.2f} and {result.mean('whole_after'):.2f} over the "
        f"whole frames. Surfaces: {result.surface_provider}.",
        result.remarks,
        tables,
        [_errors(result), _backgrounds(result, old)],
        result.figures(),
    )


def _errors_of(title: str, errors: Sequence[FrameError], caption: str) -> Table:
    """Worst first."""
    columns = {
        "frame": "name",
        "kind": lambda e: "press" if e.pressed else "untouched",
        "before": "before",
        "after": "after",
        "whole before": "whole_before",
        "whole after": "whole_after",
    }
    return Table.of(title, sorted(errors, key=lambda e: -e.after), columns, caption)


@picture("errors", "Error of each left-out frame.")
def _errors(result: RefitCalibration) -> Figure:
    figure, axis = new_figure(9, 3.4)
    place = np.arange(len(result.errors))
    axis.bar(place - 0.2, [e.before for e in result.errors], 0.4, color=GREY, label="before")
    axis.bar(place + 0.2, [e.after for e in result.errors], 0.4, color=BLUE, label="after")
    axis.set_xticks(place, [e.name for e in result.errors], rotation=30, ha="right")
    axis.set_ylabel("mean absolute error [levels]")
    axis.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2)
    return figure


@picture("backgrounds", "Background before and after, and their difference.")
def _backgrounds(result: RefitCalibration, old: SensorProfile) -> Figure:
    before = np.asarray(old.background_rgb, dtype=np.float64)
    height, width = before.shape[:2]
    figure, axes = new_figure(11, 0.8 + 3.4 * height / width, 1, 3)
    difference = np.clip(128 + 2 * (result.background - before), 0, 255)
    for axis, image, title in zip(
        axes,
        (before, result.background, difference),
        ("before", "after", "128 + 2 x (after - before)"),
        strict=True,
    ):
        axis.imshow(np.clip(image / 255, 0, 1))
        axis.set(title=title, xlabel="u [px]", ylabel="v [px]")
    return figure
