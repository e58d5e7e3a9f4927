# SPDX-License-Identifier: Apache-2.0
"""Scale from boards on the gel, as one estimate among others."""

from __future__ import annotations

from collections.abc import Sequence

from taccel_lab.calibration.camera.detect import detect_views
from taccel_lab.calibration.camera.on_gel import fit_on_gel
from taccel_lab.calibration.capture.folder import BoardCaptures
from taccel_lab.calibration.scale.estimate import ScaleEstimate


def scale_from_boards(
    boards: Sequence[BoardCaptures], center_px: tuple[float, float] | None = None
) -> ScaleEstimate:
    """Scale from boards that lie on the gel or are pressed into it.

    Raises:
        InputError: No board was found, or its pitch is not stated.
    """
    detections = detect_views(boards)
    found = fit_on_gel(detections.views, center_px=center_px)
    return ScaleEstimate(
        "board",
        found.frame.mm_per_px_x,
        found.frame.mm_per_px_y,
        inputs={view.name: view.sha256 for view in detections.views},
        evidence={
            "points": [len(view.index) for view in found.views],
            "heldout_rms_px": found.fit.heldout_px,
            "scale_range": list(found.scale_range),
            "correlation": found.frame.correlation,
        },
        remarks=found.remarks,
        refused=detections.refused,
    )
