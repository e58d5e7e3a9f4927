# SPDX-License-Identifier: Apache-2.0
"""What the calibration of the markers can remark."""

from __future__ import annotations

from taccel_lab.calibration.remarks import warning
from taccel_lab.report.remark import Severity

# The picture at rest.
REST_AMBIGUOUS = warning(
    "rest_ambiguous",
    "{name} stands still over frames {first} to {last} as well, with its dots {way_px:.2f} px from "
    "those taken for rest: state the picture at rest as markers.rest",
)
REST_DISAGREES = warning(
    "rest_disagrees",
    "{rest} is stated to be at rest, but where {name} stands still (frames {first} to {last}) the "
    "dots lie {way_px:.2f} px away at the median: one of them is pressed, or the gel has slipped "
    "between them",
)
WEAK_CONTRAST = warning(
    "weak_contrast",
    "the dots take {percent:.0f} % of the light; more light or sharper focus would place them "
    "better",
)
GRID_BENT = warning(
    "grid_bent",
    "dots lie {residual_mm:.3f} mm ({percent:.0f} % of the pitch) off a regular grid: lens "
    "distortion (calibrate the camera first), a stretched gel, or dots painted by hand",
)

# Videos.
VIDEO_CUT_SHORT = warning("video_cut_short", "a video ends early: {reason}")
FAST_MOTION = warning(
    "fast_motion",
    "{name}: dots move by {pitches:.2f} pitches to frame {frame}; beyond 0.4 they may be taken for "
    "their neighbours, and beyond 0.5 a lattice looks as if it moved back. Record slower motion or "
    "more frames a second",
    graver=Severity.ERROR,
)
UNREAD_FRAMES = warning("unread_frames", "{name}: {frames_unread}")
MARKERS_LOST = warning("markers_lost", "{name}: {percent:.0f} % of markers and frames are lost")
