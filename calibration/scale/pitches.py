# SPDX-License-Identifier: Apache-2.0
"""Scale from the pitch of points on a lattice: boards on the gel, and markers."""

from __future__ import annotations

from collections.abc import Sequence

from taccel_lab.calibration.camera.board_on_gel import fit_on_gel
from taccel_lab.calibration.camera.find_boards import detect_views
from taccel_lab.calibration.camera.pixel_grid import origin_px
from taccel_lab.calibration.capture.folder import BoardCaptures, MarkerCaptures
from taccel_lab.calibration.dots.marker_picture import marker_pitch_px
from taccel_lab.calibration.markers.rest import find_rest
from taccel_lab.calibration.result import Estimate
from taccel_lab.calibration.scale.estimate import ScaleEstimate
from taccel_lab.errors import InputError
from taccel_lab.profile import SensorProfile

PITCH_SIGMA = 0.01
"""How well the distance of painted or printed markers is known, as a share."""


def scale_from_boards(boards: Sequence[BoardCaptures], base: SensorProfile) -> ScaleEstimate:
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


def scale_from_markers(markers: MarkerCaptures) -> ScaleEstimate:
    """Scale from the markers at rest.

    Raises:
        InputError: No known pitch, no picture at rest, or no markers on a lattice.
    """
    if markers.pitch_x_mm is None and markers.pitch_y_mm is None:
        raise InputError(
            "the markers give a scale only with their distance on the gel; give pitch_x_mm and "
            "pitch_y_mm in [markers]"
        )
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
