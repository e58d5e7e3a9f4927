# SPDX-License-Identifier: Apache-2.0
"""Scale of the tactile image from everything in a capture folder that has a known length."""

from __future__ import annotations

from collections.abc import Callable

from taccel_lab.calibration.base_profile import require_image_of
from taccel_lab.calibration.camera.pixel_grid import stated_scale_remarks
from taccel_lab.calibration.capture.folder import CaptureFolder
from taccel_lab.calibration.markers.rest import find_rest
from taccel_lab.calibration.result import Estimate
from taccel_lab.calibration.scale import remarks
from taccel_lab.calibration.scale.combine import CombinedAxis, agreement_remarks, combine_axis
from taccel_lab.calibration.scale.edges import measure_edges, scale_from_edges
from taccel_lab.calibration.scale.estimate import ScaleEstimate
from taccel_lab.calibration.scale.pitches import scale_from_boards, scale_from_markers
from taccel_lab.calibration.scale.result import STATED, ScaleCalibration
from taccel_lab.calibration.scale.spheres import measure_contacts, scale_from_spheres
from taccel_lab.calibration.scale.stage import scale_from_stage
from taccel_lab.calibration.shared_remarks import SCALE_NOT_MEASURED
from taccel_lab.errors import InputError
from taccel_lab.profile import SensorProfile
from taccel_lab.progress import Progress, silent
from taccel_lab.report.remark import Remark

STATED_ERROR = 0.05
"""Standard deviation of a scale that is stated and not measured, as a share."""
UNSURE_SHARE = 0.05
"""Relative standard deviation of a scale from which on it is called weak."""


def calibrate_scale(
    folder: CaptureFolder, base: SensorProfile, progress: Progress = silent
) -> ScaleCalibration:
    """Scale from boards on the gel, pressed edges, markers and ball presses.

    Args:
        folder: Whatever of these is in it is used, but for held-out presses: they say nothing
            before the colours are scored, the scale included.
        base: The designed sensor: where its gel frame's origin is.

    Raises:
        InputError: Nothing with a known length, or nothing of it could be measured; raw captures of
            a rectified profile.
    """
    require_image_of(base, folder)
    folder = folder.fitted()
    gel_boards = [board for board in folder.boards if board.entry.on_gel]
    jobs: list[tuple[str, Callable[[], ScaleEstimate]]] = []
    if gel_boards:
        jobs.append(("board", lambda: scale_from_boards(gel_boards, base)))
    if folder.edges:
        jobs.append(("edge", lambda: _from_edges(folder)))
    markers = folder.markers
    if markers is not None and (markers.pitch_x_mm or markers.pitch_y_mm):
        jobs.append(("markers", lambda: scale_from_markers(markers)))
    if not jobs and not folder.presses:
        raise InputError(
            f"{folder.source} holds nothing of known length: give a board on the gel (on_gel = "
            "true, pitch_mm), [[edges]] with length_mm, [markers] with pitch_x_mm and "
            "pitch_y_mm, or ball presses with stage_mm (docs/calibration_camera.md)"
        )
    estimates: list[ScaleEstimate] = []
    failures: dict[str, str] = {}
    for done, (name, job) in enumerate(jobs):
        progress("measuring known lengths", done, len(jobs))
        try:
            estimates.append(job())
        except InputError as error:
            failures[name] = str(error)
    if jobs:
        progress("measuring known lengths", len(jobs), len(jobs))
    axes = _combine(estimates)
    if folder.presses:
        _add_spheres(folder, axes, estimates, failures, progress)
        axes = _combine(estimates)
    if not axes and folder.mm_per_px is not None:
        estimates.append(_stated(folder, folder.mm_per_px))
        axes = _combine(estimates)
    if not estimates:
        raise InputError(
            f"{folder.source}: no known length could be measured:\n" + "\n".join(failures.values())
        )
    return ScaleCalibration(
        folder.source,
        _image_size(folder),
        tuple(estimates),
        axes,
        failures,
        folder.provenance,
        tuple(_remarks(folder, estimates, axes, failures)),
        folder.rectified,
    )


def _combine(estimates: list[ScaleEstimate]) -> dict[str, CombinedAxis]:
    axes = {}
    for axis in ("x", "y"):
        named = [(e.method, one) for e in estimates if (one := e.along(axis)) is not None]
        if named:
            axes[axis] = combine_axis(named)
    return axes


def _stated(folder: CaptureFolder, mm_per_px: tuple[float, float]) -> ScaleEstimate:
    """The manifest's scale, for captures that measure none: it is checked against the balls."""
    return ScaleEstimate(
        STATED,
        Estimate(mm_per_px[0], STATED_ERROR * mm_per_px[0], "mm/px"),
        Estimate(mm_per_px[1], STATED_ERROR * mm_per_px[1], "mm/px"),
        inputs={"captures": folder.provenance["manifest_sha256"]}
        if "manifest_sha256" in folder.provenance
        else {},
        remarks=(SCALE_NOT_MEASURED(source="the scale that the captures state"),),
    )


def _from_edges(folder: CaptureFolder) -> ScaleEstimate:
    background = folder.require_background().image()
    return scale_from_edges(*measure_edges(folder.edges, background, folder.mask))


def _add_spheres(
    folder: CaptureFolder,
    axes: dict[str, CombinedAxis],
    estimates: list[ScaleEstimate],
    failures: dict[str, str],
    progress: Progress,
) -> None:
    progress("finding contacts", 0, 1)
    ratio = 1.0
    if "x" in axes and "y" in axes:
        ratio = axes["y"].estimate.value / axes["x"].estimate.value
    contacts, refused = measure_contacts(folder, ratio)
    placed = [contact for contact in contacts if contact.press.stage_mm is not None]
    jobs: dict[str, Callable[[], ScaleEstimate]] = {
        "spheres": lambda: scale_from_spheres(contacts, refused)
    }
    if placed:
        jobs["stage"] = lambda: scale_from_stage(placed)
    for name, job in jobs.items():
        try:
            estimates.append(job())
        except InputError as error:
            failures[name] = str(error)
    progress("finding contacts", 1, 1)


def _image_size(folder: CaptureFolder) -> tuple[int, int]:
    if folder.background is not None:
        frame = folder.background
    elif folder.markers is not None:
        frame = find_rest(folder.markers).frame
    else:
        frame = next(board.frames[0] for board in folder.boards if board.entry.on_gel)
    height, width = frame.image().shape[:2]
    return width, height


def _remarks(
    folder: CaptureFolder,
    estimates: list[ScaleEstimate],
    axes: dict[str, CombinedAxis],
    failures: dict[str, str],
) -> list[Remark]:
    said = [remark for estimate in estimates for remark in estimate.remarks]
    said += agreement_remarks(axes, estimates)
    said += [remarks.METHOD_FAILED(method=name, reason=failures[name]) for name in failures]
    for axis, found in axes.items():
        share = found.estimate.sigma / found.estimate.value
        if share > UNSURE_SHARE:
            said.append(remarks.SCALE_UNSURE(axis=axis, share=share))
    said += stated_scale_remarks(folder, {axis: found.estimate for axis, found in axes.items()})
    return said
