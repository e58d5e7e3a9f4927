# SPDX-License-Identifier: Apache-2.0
"""What the calibration of the scale can remark."""

from __future__ import annotations

from taccel_lab.calibration.remarks import RemarkKind
from taccel_lab.report.remark import Severity

# What each method finds.
SCALE_STATED = RemarkKind(
    "scale_stated",
    Severity.WARNING,
    "nothing in the captures measures the scale: it is the one that they state, taken to be right "
    "within {share:.0%} (published figures of one sensor differ by more). Add a board on the gel, "
    "presses of an edge, or markers of known pitch",
)
METHOD_FAILED = RemarkKind("method_failed", Severity.WARNING, "no scale from {method}: {reason}")
FEW_EDGES = RemarkKind(
    "few_edges",
    Severity.WARNING,
    "{count} presses of the edge{lacking}; 8 or more, along x and along y, tell both scales. "
    "Without, pixels are taken to be square within {share:.0%}",
)
LANDMARKS_OFF = RemarkKind(
    "landmarks_off",
    Severity.WARNING,
    "the landmarks of {name} are {error_px:.1f} px off the map that they define; one of them is "
    "mistaken",
)
DEPTHS_DISAGREE = RemarkKind(
    "depths_disagree",
    Severity.WARNING,
    "contact radii hardly grow with the stated depths (correlation {correlation:.2f}); check "
    "depth_mm: travel past first touch, in millimetres",
)

# What they say together.
SCALE_DISAGREES = RemarkKind(
    "scale_disagrees",
    Severity.ERROR,
    "the scales along {axis} contradict each other ({pairs}): {scales}. One of the stated lengths "
    "is wrong, or the images are not of one size and crop; the mean is given with a wider "
    "interval, do not rely on it",
)
CONTACTS_EXCEED_BALL = RemarkKind(
    "contacts_exceed_ball",
    Severity.ERROR,
    "contacts of the ball are larger than the ball at {scale}: at most {limit:.5f} mm/px would "
    "fit. The ball's radius is stated too small (a diameter is no radius), or the scale is wrong",
)
SCALE_UNSURE = RemarkKind(
    "scale_unsure",
    Severity.ERROR,
    "the scale along {axis} is known to {share:.0%} only; add a board on the gel, an edge or "
    "markers of known pitch",
)
