# SPDX-License-Identifier: Apache-2.0
"""What the calibration of the camera can remark."""

from __future__ import annotations

from taccel_lab.calibration.remarks import error, info, warning
from taccel_lab.report.remark import Severity

# The captures.
BOARDS_REFUSED = info(
    "boards_refused",
    "the board was not used in {count} of {total} images: {reasons}",
    graver=Severity.WARNING,
)
SIZE_DIFFERS = error(
    "size_differs",
    "the board was seen in images of {width}x{height} px, the background has "
    "{background_width}x{background_height} px: the scale holds for images of the board's size "
    "only",
)

# The lens.
MORE_VIEWS = "20 or more, spread over the image, determine the distortion"
LENS_COVERAGE = warning(
    "lens_coverage",
    "the board covers {share:.0%} of the image; the distortion is unknown beyond. Show the board "
    "in the corners too",
)
VIEWS_ALIKE = error(
    "views_alike",
    "{reason}, so that the focal length cannot be told from the distance; tilt the board by 20 to "
    "45 degrees, to all sides",
)
FOCAL_UNCERTAIN = warning(
    "focal_uncertain",
    "the focal length is known to {percent:.1f} % only; take more views with more tilt",
    graver=Severity.ERROR,
)

FOCALS_DIFFER = error(
    "focals_differ",
    "views differ in focal length, from {least:.0f} to {largest:.0f} px ({names}); one for all "
    "leaves {common:.2f} px, one each {corners:.2f}: fix focus and zoom, and take them again",
)

# Boards on the gel.
DISTORTED = warning(
    "distorted",
    "the scale runs from {least:.2f} to {largest:.2f} of its value at the board's middle: mm/px "
    "hold about the middle of the raw image, and everywhere only in images that are rectified "
    "(--maps)",
)
OFF_CENTER = error(
    "off_center",
    "the gel frame's origin at pixel ({u:.0f}, {v:.0f}) is not under the board, so that the scale "
    "there is extrapolated; lay the board over the middle of the image of {width}x{height} px",
)
