# SPDX-License-Identifier: Apache-2.0
"""The blocks that captures calibrate, in the order in which one builds on another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from taccel_lab.calibration.background.background_page import background_page
from taccel_lab.calibration.background.fit import BackgroundOptions, calibrate_background
from taccel_lab.calibration.camera.camera_page import camera_page
from taccel_lab.calibration.camera.fit import calibrate_camera
from taccel_lab.calibration.camera.options import CameraOptions
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.color.color_page import color_page
from taccel_lab.calibration.color.fit import calibrate_color
from taccel_lab.calibration.color.options import ColorOptions
from taccel_lab.calibration.grey.depth_page import depth_page
from taccel_lab.calibration.grey.fit import calibrate_depth
from taccel_lab.calibration.grey.options import DepthOptions
from taccel_lab.calibration.markers.fit import calibrate_markers
from taccel_lab.calibration.markers.markers_page import marker_page
from taccel_lab.calibration.material.fit import calibrate_material
from taccel_lab.calibration.material.material_page import material_page
from taccel_lab.calibration.material.options import MaterialOptions
from taccel_lab.calibration.normals.fit import calibrate_normals
from taccel_lab.calibration.normals.normals_page import normals_page
from taccel_lab.calibration.normals.options import NormalOptions
from taccel_lab.calibration.result import CalibrationResult
from taccel_lab.calibration.scale.fit import calibrate_scale
from taccel_lab.calibration.scale.scale_page import scale_page
from taccel_lab.errors import InputError
from taccel_lab.profile import SensorProfile
from taccel_lab.progress import Progress, silent
from taccel_lab.report.page import Page


@dataclass(frozen=True)
class CalibrationBlock:
    """One block: how it is fitted, and how its result is shown."""

    name: str
    """As in ``taccel-lab calibrate NAME``."""
    verb: Callable[..., CalibrationResult]
    """(folder, base, options, progress) -> result; no options for a block that has none."""
    describe: Callable[..., Page]
    """(result) -> page, or (result, folder) where the page reads images of the folder."""
    options: type | None = None
    """Of the fit; None where there is nothing to choose."""
    reads_folder: bool = False
    """Whether the page takes the folder."""

    def fit(
        self,
        folder: CaptureFolder,
        base: SensorProfile,
        options: Any = None,
        progress: Progress = silent,
    ) -> CalibrationResult:
        """The block's calibration, with its defaults where no options are given.

        Raises:
            InputError: Captures that it cannot use, or options for a block that has none.
        """
        if self.options is None:
            if options is not None:
                raise InputError(f"the calibration of {self.name} has no options")
            return self.verb(folder, base, progress)
        if options is not None and not isinstance(options, self.options):
            raise InputError(
                f"the calibration of {self.name} takes {self.options.__name__}, "
                f"got {type(options).__name__}"
            )
        return self.verb(folder, base, self.options() if options is None else options, progress)

    def page(self, result: CalibrationResult, folder: CaptureFolder) -> Page:
        """The result as a page; pictures are drawn when it is written."""
        return self.describe(result, folder) if self.reads_folder else self.describe(result)


BLOCKS = (
    CalibrationBlock("camera", calibrate_camera, camera_page, CameraOptions, reads_folder=True),
    CalibrationBlock("scale", calibrate_scale, scale_page, reads_folder=True),
    CalibrationBlock("background", calibrate_background, background_page, BackgroundOptions),
    CalibrationBlock("color", calibrate_color, color_page, ColorOptions),
    CalibrationBlock("normals", calibrate_normals, normals_page, NormalOptions),
    CalibrationBlock("depth", calibrate_depth, depth_page, DepthOptions),
    CalibrationBlock("markers", calibrate_markers, marker_page),
    CalibrationBlock("material", calibrate_material, material_page, MaterialOptions),
)
"""What each needs of a capture folder, ``calibration/check/content.py`` says."""


def block_named(name: str) -> CalibrationBlock:
    """The block of a name of the table."""
    return next(block for block in BLOCKS if block.name == name)
