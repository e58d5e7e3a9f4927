# SPDX-License-Identifier: Apache-2.0
"""Scale of the tactile image from everything in a capture folder that has a known length."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from taccel_lab.calibration.base_profile import require_image_of
from taccel_lab.calibration.camera.board_on_gel import fit_on_gel
from taccel_lab.calibration.camera.find_boards import detect_views
from taccel_lab.calibration.camera.result import origin_px, stated_scale_remarks
from taccel_lab.calibration.capture.folder import BoardCaptures, CaptureFolder, MarkerCaptures
from taccel_lab.calibration.markers.rest import find_rest
from taccel_lab.calibration.remarks import SCALE_NOT_MEASURED
from taccel_lab.calibration.result import Estimate
from taccel_lab.calibration.scale import remarks
from taccel_lab.calibration.scale.ball_contacts import (
    measure_contacts,
    scale_from_spheres,
    scale_from_stage,
)
from taccel_lab.calibration.scale.edges import measure_edges, scale_from_edges
from taccel_lab.calibration.scale.result import (
    STATED,
    CombinedAxis,
    ScaleCalibration,
    ScaleEstimate,
    agreement_remarks,
    combine,
)
from taccel_lab.errors import InputError
from taccel_lab.profile import SensorProfile
from taccel_lab.progress import Progress, counted, silent
from taccel_lab.reading.dots.marker_picture import marker_pitch_px
from taccel_lab.report.remark import Remark

STATED_ERROR = 0.05
"""Standard deviation of a scale that is stated and not measured, as a share."""
PITCH_SIGMA = 0.01
"""How well the distance of painted or printed markers is known, as a share."""
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
        jobs.append(("board", lambda: _from_boards(gel_boards, base)))
    if folder.edges:
        jobs.append(("edge", lambda: _from_edges(folder)))
    markers = folder.markers
    if markers is not None and (markers.pitch_x_mm or markers.pitch_y_mm):
        jobs.append(("markers", lambda: _from_markers(markers)))
    if not jobs and not folder.presses:
        raise InputError(
            f"{folder.source} holds nothing of known length: give a board on the gel (on_gel = "
            "true, pitch_mm), [[edges]] with length_mm, [markers] with pitch_x_mm and "
            "pitch_y_mm, or ball presses with stage_mm (docs/calibration_camera.md)"
        )
    estimates: list[ScaleEstimate] = []
    failures: dict[str, str] = {}

    def attempt(name: str, job: Callable[[], ScaleEstimate]) -> None:
        try:
            estimates.append(job())
        except InputError as error:
            failures[name] = str(error)

    for name, job in counted(jobs, progress, "measuring known lengths", len(jobs)):
        attempt(name, job)
    axes = combine(estimates)
    if folder.presses:
        ratio = 1.0
        if "x" in axes and "y" in axes:
            ratio = axes["y"].estimate.value / axes["x"].estimate.value
        progress("finding contacts", 0, 1)
        contacts, refused = measure_contacts(folder, ratio)
        progress("finding contacts", 1, 1)
        attempt("spheres", lambda: scale_from_spheres(contacts, refused))
        placed = [contact for contact in contacts if contact.press.stage_mm is not None]
        if placed:
            attempt("stage", lambda: scale_from_stage(placed))
        axes = combine(estimates)
    if not axes and folder.mm_per_px is not None:
        estimates.append(_stated(folder, folder.mm_per_px))
        axes = combine(estimates)
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


def _from_boards(boards: Sequence[BoardCaptures], base: SensorProfile) -> ScaleEstimate:
    """Scale from boards that lie on the gel or are pressed into it, at the origin of ``base``.

    Raises:
        InputError: No board was found, or its pitch is not stated.
    """
    detections = detect_views(boards)
    views = detections.views
    found = fit_on_gel(views, center_px=origin_px(base, views[0].size_px))
    return ScaleEstimate(
        "board",
        found.frame.mm_per_px_x,
        found.frame.mm_per_px_y,
        inputs={view.name: view.sha256 for view in views},
        evidence={
            "points": [len(view.index) for view in found.views],
            "heldout_rms_px": found.fit.heldout_px,
            "scale_range": list(found.scale_range),
            "correlation": found.frame.correlation,
        },
        remarks=found.remarks,
        refused=detections.refused,
    )


def _from_markers(markers: MarkerCaptures) -> ScaleEstimate:
    """Scale from the markers at rest.

    Raises:
        InputError: No picture at rest, or no markers on a lattice.
    """
    rest = find_rest(markers)
    along_x, along_y, sigma = marker_pitch_px(rest.frame.image())
    found = []
    for pitch_mm, pitch_px in ((markers.pitch_x_mm, along_x), (markers.pitch_y_mm, along_y)):
        if pitch_mm is None:
            found.append(None)
            continue
        value = pitch_mm / pitch_px
        share = (sigma / pitch_px) ** 2 + PITCH_SIGMA**2
        found.append(Estimate(value, value * share**0.5, "mm/px"))
    return ScaleEstimate(
        "markers",
        found[0],
        found[1],
        inputs={rest.frame.name: rest.frame.sha256},
        evidence={
            "pitch_x_px": along_x,
            "pitch_y_px": along_y,
            "pitch_sigma_px": sigma,
            "pitch_share_sigma": PITCH_SIGMA,
        },
        remarks=rest.remarks,
    )


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
