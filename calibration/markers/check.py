# SPDX-License-Identifier: Apache-2.0
"""Findings about dots: no picture of them at rest, labels off them, videos without motion."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from taccel_lab.calibration.capture.folder import CaptureFolder, MarkerCaptures, Video
from taccel_lab.calibration.capture.load import cut_short
from taccel_lab.calibration.markers.remarks import VIDEO_CUT_SHORT
from taccel_lab.calibration.markers.rest import find_rest
from taccel_lab.calibration.remarks import LABELS_OFF, error, warning
from taccel_lab.errors import InputError
from taccel_lab.reading.dots.marker_picture import find_markers
from taccel_lab.reading.thumb import thumb
from taccel_lab.report.remark import Remark

LABEL_DOT_PX, LABELS_LOST = 3.0, 0.1
NO_REST_FRAME = error("no_rest_frame", "{reason}", ("markers", "scale"))
VIDEO_SIZE = error(
    "video_size",
    "{video}: frames of {width}x{height} px, the image at rest has {rest_width}x{rest_height} px",
    ("markers",),
)
NO_MOTION = warning("no_motion", "{video}: nothing moves in {count} frames", ("markers",))


class CheckedRest(NamedTuple):
    """What is found about the picture at rest."""

    findings: list[Remark]
    image: np.ndarray | None
    """RGB levels, shape [height_px, width_px, 3]; None where no picture at rest shows dots."""


def check_markers(folder: CaptureFolder) -> list[Remark]:
    """Findings about labels, the picture at rest and the videos."""
    markers = folder.markers
    if markers is None:
        return []
    rest = check_rest(folder)
    findings = [*_check_labels(markers), *rest.findings]
    if rest.image is not None:
        findings += [f for video in markers.videos for f in _check_video(video, rest.image)]
    return findings


def check_rest(folder: CaptureFolder) -> CheckedRest:
    """Findings about the picture at rest, which also gives the scale; looked at once a folder."""
    markers = folder.markers
    assert markers is not None
    return folder.once.of("markers at rest", lambda: _checked_rest(markers))


def _checked_rest(markers: MarkerCaptures) -> CheckedRest:
    try:
        rest = find_rest(markers)
    except InputError as fault:
        return CheckedRest([NO_REST_FRAME(reason=fault)], None)
    image = rest.frame.image()
    try:
        find_markers(image)
    except InputError as fault:
        why = f"{rest.frame.name} shows no grid of dots: {fault}"
        return CheckedRest([NO_REST_FRAME(reason=why)], None)
    return CheckedRest([replace(one, blocks=("markers", "scale")) for one in rest.remarks], image)


def _check_labels(markers: MarkerCaptures) -> list[Remark]:
    """Whether measured dots lie where the image that they were measured in shows some."""
    frame = markers.rest if markers.labels_frame is None else markers.labels_frame
    if not markers.labels or frame is None:
        return []
    try:
        near = find_markers(frame.image()).dots.uv_px
    except InputError as fault:
        return [NO_REST_FRAME(reason=f"{frame.name} shows no grid of dots: {fault}")]
    u, v, du, dv = (markers.labels[name] for name in ("u_px", "v_px", "du_px", "dv_px"))
    given = np.column_stack([u + du, v + dv])
    gap = np.linalg.norm(given[:, None] - near[None], axis=-1).min(axis=1)
    lost = int((gap > LABEL_DOT_PX).sum())
    if lost <= LABELS_LOST * len(gap):
        return []
    how = (
        f"moved by their displacements they are more than {LABEL_DOT_PX:g} px from any dot of "
        f"{frame.name} (median {np.median(gap):.1f} px)"
    )
    figures = {"wrong": lost, "count": len(gap), "advice": "Measure them again", "how": how}
    return [LABELS_OFF(labels="measured dots", blocks=("markers",), **figures)]


def _check_video(video: Video, rest: np.ndarray) -> list[Remark]:
    fault = cut_short(video)
    findings = [] if fault is None else [VIDEO_CUT_SHORT(reason=fault, blocks=("markers",))]
    small = []
    for frame in video.frames():
        if frame.shape != rest.shape:
            return [
                VIDEO_SIZE(
                    video=video.source,
                    width=frame.shape[1],
                    height=frame.shape[0],
                    rest_width=rest.shape[1],
                    rest_height=rest.shape[0],
                )
            ]
        small.append(thumb(frame))
    moved = max(float(np.percentile(np.abs(image - small[0]), 99)) for image in small)
    if moved < 4.0:
        findings.append(NO_MOTION(video=video.source, count=len(small)))
    return findings
