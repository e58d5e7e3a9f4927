# SPDX-License-Identifier: Apache-2.0
"""Blocks whose fit does not yet have the one shape (folder, base, options, progress) -> result.

Each function does what the block's command does with its default options. One goes as soon as the
block's own ``fit.py`` has the shape and its ``report.py`` a page of the result alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from taccel_lab.calibration.background.fit import calibrate_background
from taccel_lab.calibration.background.report import background_page
from taccel_lab.calibration.base_profile import lost_blocks, on_grid, presses_on_camera
from taccel_lab.calibration.camera.fit import calibrate_camera
from taccel_lab.calibration.camera.report import camera_page
from taccel_lab.calibration.capture.captures import CaptureSet, ContactCircle
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.capture.split import HOLDOUT_EVERY
from taccel_lab.calibration.check.block_findings import capture_findings, joined, refusing_with
from taccel_lab.calibration.color.fit import ColorPlan, HeldoutSet, calibrate_color
from taccel_lab.calibration.color.options import ColorFitOptions
from taccel_lab.calibration.color.report import color_page
from taccel_lab.calibration.contacts.fusion import choose_circles
from taccel_lab.calibration.contacts.usable import usable_presses
from taccel_lab.calibration.depth.fit import calibrate_depth
from taccel_lab.calibration.depth.rectified import grey_captures
from taccel_lab.calibration.depth.report import depth_page
from taccel_lab.calibration.markers.fit import calibrate_markers
from taccel_lab.calibration.markers.report import marker_page
from taccel_lab.calibration.material.fit import calibrate_material
from taccel_lab.calibration.material.report import material_page
from taccel_lab.calibration.normals.fit import calibrate_normals
from taccel_lab.calibration.normals.network_fit import InverseFitOptions
from taccel_lab.calibration.normals.report import normals_page
from taccel_lab.calibration.normals.samples import Scene
from taccel_lab.calibration.normals.skirt import hertz_skirts
from taccel_lab.calibration.report.page import Page
from taccel_lab.calibration.result import CalibrationResult, Remark
from taccel_lab.calibration.scale.fit import calibrate_scale
from taccel_lab.calibration.scale.report import scale_page
from taccel_lab.calibration.simulate import simulate_presses
from taccel_lab.calibration.surfaces.shared_law import SharedLaw
from taccel_lab.profile import SensorProfile
from taccel_lab.progress import Progress
from taccel_lab.signals.rest_surface import rest_surface

COLOR_FOLDS = 3
ASKED_ELSEWHERE = frozenset({"sensor_unknown"})
"""Findings of the check that the calibration of colour says in its own words."""


@dataclass(frozen=True)
class Shown:
    """A result with its page, which needs more than the result."""

    result: CalibrationResult
    page: Page
    base: SensorProfile | None = None
    """What the result extends where that is not the profile that was given."""

    @property
    def remarks(self) -> tuple[Remark, ...]:
        return self.result.remarks

    def figures(self) -> dict[str, Any]:
        return self.result.figures()

    def apply_to(self, profile: SensorProfile) -> SensorProfile:
        return self.result.apply_to(self.base or profile)

    def maps(self) -> Any:
        """Of a camera."""
        return self.result.maps()  # pyright: ignore[reportAttributeAccessIssue]


def shown_page(result: Shown) -> Page:
    """The page that came with the result."""
    return result.page


def _steps(progress: Progress, task: str) -> Callable[..., None]:
    """``progress`` for callbacks that name no task, or give a loss as well."""
    return lambda done, total, *_: progress(task, done, total)


def fit_camera(
    folder: CaptureFolder, base: SensorProfile, options: None, progress: Progress
) -> Shown:
    result = calibrate_camera(folder, base, progress=progress)
    return Shown(result, camera_page(result, folder))


def fit_scale(
    folder: CaptureFolder, base: SensorProfile, options: None, progress: Progress
) -> Shown:
    # Held-out presses say nothing before the colours are scored, the scale included.
    result = calibrate_scale(folder.fitted(), base, progress=progress)
    _ = result.scale  # Refuses captures that only limit the scale.
    return Shown(result, scale_page(result, folder))


def fit_background(
    folder: CaptureFolder, base: SensorProfile, options: None, progress: Progress
) -> Shown:
    result = calibrate_background(folder, _steps(progress, "comparing the frames"))
    usable = ~(result.dust | result.new_dust)
    if folder.mask is not None:
        usable &= folder.mask

    def write_dust(path: Path) -> None:
        if not cv2.imwrite(str(path), usable.astype(np.uint8) * 255):
            raise OSError(f"{path} could not be written")

    return Shown(result, replace(background_page(result), files={"dust.png": write_dust}))


def _circles(
    captures: CaptureSet, *, cache: bool
) -> tuple[CaptureSet, list[ContactCircle], list[Remark]]:
    captures, found, remarks = usable_presses(captures, cache=cache)
    return captures, choose_circles(captures, found, "fused"), remarks


def fit_color(
    folder: CaptureFolder, base: SensorProfile, options: None, progress: Progress
) -> Shown:
    captures, on_camera = presses_on_camera(folder, base)
    findings = [
        finding
        for finding in capture_findings(folder, "color", progress)
        if finding.code not in ASKED_ELSEWHERE
    ]
    remarks = [*lost_blocks(base, on_camera), *findings]
    split = captures.split(HOLDOUT_EVERY)
    with refusing_with(remarks):
        training, circles, left_out = _circles(captures.only(split.train), cache=True)
    laws: dict[float, SharedLaw] = {}
    simulated = partial(simulate_presses, profile=on_camera, cache=True, share=True, laws=laws)
    surfaces = simulated(training, circles, progress=_steps(progress, "simulating the presses"))
    result = calibrate_color(
        training,
        circles,
        surfaces,
        HeldoutSet.of(captures, split, simulated),
        options=ColorFitOptions(),
        plan=ColorPlan(
            drift="auto",
            register=True,
            folds=min(COLOR_FOLDS, len(training.presses)),
            table=True,
        ),
        remarks=(*remarks, *left_out),
        progress=_steps(progress, "fitting the colour model"),
    )
    return Shown(result, color_page(result), on_camera)


def fit_normals(
    folder: CaptureFolder, base: SensorProfile, options: None, progress: Progress
) -> Shown:
    captures, on_camera = presses_on_camera(folder, base)
    split = captures.split(HOLDOUT_EVERY)
    heldout = captures.only(split.heldout) if split.heldout else None
    findings = capture_findings(folder, "normals", progress)
    rest = rest_surface(on_camera.mesh, captures.grid)
    rest_normals = None if rest.is_flat else rest.normals
    with refusing_with(findings):
        captures, circles, left_out = _circles(captures.only(split.train), cache=True)
    result = calibrate_normals(
        captures,
        circles,
        hertz_skirts(captures, circles),
        heldout,
        split=split,
        rest_normals=rest_normals,
        options=InverseFitOptions(steps=1000),
        circle_source="fused",
        progress=_steps(progress, "fitting the inverse model"),
    )
    remarks = joined(findings, (*left_out, *result.remarks))
    result = replace(result, remarks=(*lost_blocks(base, on_camera), *remarks))
    scene = Scene(
        captures.background, captures.grid, captures.ball_radius_mm, captures.mask, rest_normals
    )
    return Shown(result, normals_page(result, scene), on_camera)


def fit_depth(
    folder: CaptureFolder, base: SensorProfile, options: None, progress: Progress
) -> Shown:
    captures, remarks = grey_captures(folder, base, None)
    on_camera = on_grid(base, captures.grid, captures.provenance)
    findings = capture_findings(folder, "depth", progress)
    with refusing_with(findings):
        result = calibrate_depth(captures, remarks=remarks)
    remarks = (*lost_blocks(base, on_camera), *joined(findings, result.remarks))
    result = replace(result, remarks=remarks)
    return Shown(result, depth_page(result, captures), on_camera)


def fit_markers(
    folder: CaptureFolder, base: SensorProfile, options: None, progress: Progress
) -> Shown:
    result = calibrate_markers(folder, base, progress=progress)
    return Shown(result, marker_page(result))


def fit_material(
    folder: CaptureFolder, base: SensorProfile, options: None, progress: Progress
) -> Shown:
    result = calibrate_material(folder, base, None, progress)
    return Shown(result, material_page(result))
