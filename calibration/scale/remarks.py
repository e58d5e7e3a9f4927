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
EDGES_SHORT = RemarkKind(
    "edges_short",
    Severity.INFO,
    "{short} of {count} edges touched with a part of their length only and were left out: {names}",
)
FEW_EDGES = RemarkKind(
    "few_edges",
    Severity.WARNING,
    "only {count} presses of the edge; 8 or more, along x and along y, show how well they agree",
)
EDGES_NOT_ALONG_X = RemarkKind(
    "edges_not_along_x",
    Severity.WARNING,
    "no edge lies along x: the scale there is that of y, pixels taken to be square within "
    "{share:.0%}. Press the edge along x too",
)
EDGES_NOT_ALONG_Y = RemarkKind(
    "edges_not_along_y",
    Severity.WARNING,
    "no edge lies along y: the scale there is that of x, pixels taken to be square within "
    "{share:.0%}. Press the edge along y too",
)
LANDMARKS_OFF = RemarkKind(
    "landmarks_off",
    Severity.WARNING,
    "the landmarks of {name} are {error_px:.1f} px off the map that they define; one of them is "
    "mistaken",
)
SPHERES_LIMIT = RemarkKind(
    "spheres_limit",
    Severity.INFO,
    "the colours of ball presses do not tell the ball's radius in pixels: every radius explains "
    "them, with another law from slope to colour. No contact is larger than its ball, so that the "
    "scale is at most {limit:.5f} mm/px (95 %). With depth_mm of the presses, or a board, an edge "
    "or markers, it is determined",
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
ONE_AXIS = RemarkKind(
    "one_axis",
    Severity.WARNING,
    "only the scale along {axis} was measured; pixels are taken to be square",
)
ONE_METHOD = RemarkKind(
    "one_method",
    Severity.INFO,
    "the scale rests on one kind of capture; a second one would show whether its stated length is "
    "right",
)
