# SPDX-License-Identifier: Apache-2.0
"""The blocks that captures calibrate, in the order in which one builds on another.

The table names where each block's functions are; a block is loaded when it is fitted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

from taccel_lab.errors import InputError
from taccel_lab.progress import Progress, silent

if TYPE_CHECKING:
    from taccel_lab.calibration.capture.folder import CaptureFolder
    from taccel_lab.calibration.result import BlockResult
    from taccel_lab.profile import SensorProfile
    from taccel_lab.report.page import Page


@dataclass(frozen=True)
class CalibrationBlock:
    """One block: how it is fitted, and how its result is shown. Modules are below
    ``taccel_lab.calibration``."""

    name: str
    """Name as in ``taccel-lab calibrate NAME``."""
    fitted_in: str
    """Module of ``calibrate_NAME``: (folder, base, options, progress) -> result; no options for a
    block that has none."""
    shown_in: str
    """Module of ``NAME_page``: (result) -> page, or (result, folder) where the page reads images of
    the folder."""
    choices: str = ""
    """``module:class`` of the fit's options; empty where there is nothing to choose."""
    reads_folder: bool = False
    """Whether the page takes the folder."""

    @property
    def verb(self) -> Callable[..., BlockResult]:
        """Function that fits the block."""
        return _loaded(f"{self.fitted_in}:calibrate_{self.name}")

    @property
    def options(self) -> type | None:
        """Class of the fit's options; None where there is nothing to choose."""
        return _loaded(self.choices) if self.choices else None

    def fit(
        self,
        folder: CaptureFolder,
        base: SensorProfile,
        options: Any = None,
        progress: Progress = silent,
    ) -> BlockResult:
        """The block's calibration, with its defaults where no options are given.

        Raises:
            InputError: Captures that it cannot use, or options for a block that has none.
        """
        allowed = self.options
        if allowed is None:
            if options is not None:
                raise InputError(f"the calibration of {self.name} has no options")
            return self.verb(folder, base, progress)
        if options is not None and not isinstance(options, allowed):
            raise InputError(
                f"the calibration of {self.name} takes {allowed.__name__}, "
                f"got {type(options).__name__}"
            )
        options = allowed() if options is None else options
        return self.verb(folder, base, options, progress)

    @property
    def describe(self) -> Callable[..., Page]:
        """Function that shows its result."""
        return _loaded(f"{self.shown_in}:{self.name}_page")

    def page(self, result: BlockResult, folder: CaptureFolder) -> Page:
        """The result as a page; pictures are drawn when it is written."""
        return self.describe(result, folder) if self.reads_folder else self.describe(result)


def _loaded(name: str) -> Any:
    return resolve_name(f"taccel_lab.calibration.{name}")


BLOCKS = (
    CalibrationBlock(
        "camera", "camera.fit", "camera.camera_page", "camera.options:CameraOptions", True
    ),
    CalibrationBlock("scale", "scale.fit", "scale.scale_page", reads_folder=True),
    CalibrationBlock(
        "background",
        "background.fit",
        "background.background_page",
        "background.fit:BackgroundOptions",
    ),
    CalibrationBlock("color", "color.fit", "color.color_page", "press_options:ColorOptions"),
    CalibrationBlock(
        "normals", "normals.fit", "normals.normals_page", "press_options:NormalOptions"
    ),
    CalibrationBlock("depth", "depth.fit", "depth.depth_page", "press_options:DepthOptions"),
    CalibrationBlock("markers", "markers.fit", "markers.markers_page"),
    CalibrationBlock(
        "material", "material.fit", "material.material_page", "material.options:MaterialOptions"
    ),
)
"""What each needs of a capture folder, ``calibration/check/content.py`` says."""


def block_named(name: str) -> CalibrationBlock:
    """The block of a name of the table."""
    return next(block for block in BLOCKS if block.name == name)
