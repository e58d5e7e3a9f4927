# SPDX-License-Identifier: Apache-2.0
"""What the calibration of the markers can remark."""

from __future__ import annotations

from taccel_lab.calibration.remarks import RemarkKind
from taccel_lab.report.remark import Severity

# The picture at rest.
REST_FOUND = RemarkKind(
    "rest_found",
    Severity.INFO,
    "rest was found in {name}: over frames {first} to {last} of {count} nothing in the picture "
    "moves by more than {limit:.2f} px, and the dots lie as evenly as anywhere in it. A gel that a "
    "flat plate holds pressed all the time would look the same",
)
REST_AMBIGUOUS = RemarkKind(
    "rest_ambiguous",
    Severity.WARNING,
    "{name} stands still over frames {first} to {last} as well, with its dots {way_px:.2f} px from "
    "those taken for rest: state the picture at rest as markers.rest",
)
REST_DISAGREES = RemarkKind(
    "rest_disagrees",
    Severity.WARNING,
    "{rest} is stated to be at rest, but where {name} stands still (frames {first} to {last}) the "
    "dots lie {way_px:.2f} px away at the median: one of them is pressed, or the gel has slipped "
    "between them",
)
FEW_DOTS = RemarkKind(
    "few_dots",
    Severity.WARNING,
    "only {count} dots were numbered; pitch and rotation rest on few points",
)
DOTS_BESIDE_LATTICE = RemarkKind(
    "dots_beside_lattice",
    Severity.INFO,
    "{count} blobs look like dots but have no place in the grid; they are left out",
)
DOTS_CUT = RemarkKind(
    "dots_cut", Severity.INFO, "{count} of {total} dots are cut by the border of the picture"
)
DOTS_MERGED = RemarkKind(
    "dots_merged",
    Severity.INFO,
    "{count} of {total} dots touch another dot and were split from it",
    graver=Severity.WARNING,
)
DOTS_ODD = RemarkKind(
    "dots_odd",
    Severity.INFO,
    "{count} of {total} dots differ much from the others in size, shape or contrast",
    graver=Severity.WARNING,
)
DOTS_MISSING = RemarkKind(
    "dots_missing", Severity.INFO, "{count} places of the grid in view hold no dot"
)
WEAK_CONTRAST = RemarkKind(
    "weak_contrast",
    Severity.WARNING,
    "the dots take {percent:.0f} % of the light; more light or sharper focus would place them "
    "better",
)
GRID_BENT = RemarkKind(
    "grid_bent",
    Severity.WARNING,
    "dots lie {residual_mm:.3f} mm ({percent:.0f} % of the pitch) off a regular grid: lens "
    "distortion (calibrate the camera first), a stretched gel, or dots painted by hand",
)

# What the millimetres rest on.
SCALE_ASSUMED = RemarkKind(
    "scale_assumed",
    Severity.WARNING,
    "millimetres rest on {scale}, which nobody measured on this unit; state mm_per_px_x and "
    "mm_per_px_y or the dots' pitch_x_mm in captures.toml, or give a profile with a calibrated "
    "scale as --base",
)
MARKER_SCALE_DISAGREES = RemarkKind(
    "marker_scale_disagrees",
    Severity.WARNING,
    "{other} gives {other_x:.4f} x {other_y:.4f} mm/px, {used} {used_x:.4f} x {used_y:.4f}: "
    "{off_x_percent:+.1f} and {off_y_percent:+.1f} %; the latter was used",
)

# Videos.
MARKER_VIDEO_CUT_SHORT = RemarkKind("marker_video_cut_short", Severity.WARNING, "{reason}")
JITTER = RemarkKind(
    "jitter",
    Severity.WARNING,
    "{name}: dots at rest scatter by {jitter_px:.2f} px between frames; steadier light, less "
    "compression or more exposure would help",
)
NO_REST = RemarkKind(
    "no_rest",
    Severity.INFO,
    "{name}: fewer than 5 frames at rest, so that the jitter is unknown",
)
MOTION_ALIASES = RemarkKind(
    "motion_aliases",
    Severity.ERROR,
    "{name}: most dots move by {pitches:.2f} pitches between two frames: a lattice that moves by "
    "more than half a pitch looks as if it moved back, so that displacements may be wrong by whole "
    "pitches. Record slower motion or more frames a second",
)
FAST_MOTION = RemarkKind(
    "fast_motion",
    Severity.WARNING,
    "{name}: dots move up to {pitches:.2f} pitches between two frames; beyond 0.4 they may be "
    "taken for their neighbours: record slower motion or more frames a second",
)
FRAMES_UNSEEN = RemarkKind(
    "frames_unseen",
    Severity.WARNING,
    "{name}: fewer than half of the dots are seen in frame {unseen} (counted from 0): dark, "
    "blurred or covered; places there are predictions",
)
MARKERS_LOST = RemarkKind(
    "markers_lost", Severity.WARNING, "{name}: {percent:.0f} % of markers and frames are lost"
)
NOT_BACK = RemarkKind(
    "not_back",
    Severity.INFO,
    "{name}: after release (frame {release}) the dots are {offset_px:.2f} px from rest at the "
    "median: the gel creeps, slipped, or was not let go",
)
