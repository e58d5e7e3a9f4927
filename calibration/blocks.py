# SPDX-License-Identifier: Apache-2.0
"""The blocks that captures calibrate, in the order in which one builds on another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from taccel_lab.calibration import block_adapters as adapters
from taccel_lab.calibration.report.page import Page
from taccel_lab.calibration.result import CalibrationResult
from taccel_lab.calibration.spread.fit import SpreadOptions, calibrate_spread
from taccel_lab.calibration.spread.report import spread_page


@dataclass(frozen=True)
class CalibrationBlock:
    """One block: how it is fitted, and how its result is shown."""

    name: str
    """As in ``taccel-lab calibrate NAME``."""
    fit: Callable[..., CalibrationResult]
    """(folder, base, options, progress) -> result; InputError for captures it cannot use."""
    page: Callable[[Any], Page]
    """The result as a page."""
    options: Callable[[], Any]
    """Makes the options that the fit takes where none are given."""


def _none() -> None:
    """Options of a block that is fitted through an adapter."""


BLOCKS = (
    CalibrationBlock("camera", adapters.fit_camera, adapters.shown_page, _none),
    CalibrationBlock("scale", adapters.fit_scale, adapters.shown_page, _none),
    CalibrationBlock("background", adapters.fit_background, adapters.shown_page, _none),
    CalibrationBlock("color", adapters.fit_color, adapters.shown_page, _none),
    CalibrationBlock("normals", adapters.fit_normals, adapters.shown_page, _none),
    CalibrationBlock("depth", adapters.fit_depth, adapters.shown_page, _none),
    CalibrationBlock("markers", adapters.fit_markers, adapters.shown_page, _none),
    CalibrationBlock("material", adapters.fit_material, adapters.shown_page, _none),
    CalibrationBlock("spread", calibrate_spread, spread_page, SpreadOptions),
)
"""What each needs of a capture folder, ``calibration/check/content.py`` says."""
