# SPDX-License-Identifier: Apache-2.0
"""What the calibration of the camera can remark."""

from __future__ import annotations

from taccel_lab.calibration.remarks import RemarkKind
from taccel_lab.report.remark import Severity

# The captures.
BOARDS_REFUSED = RemarkKind(
    "boards_refused",
    Severity.INFO,
    "the board was not used in {count} of {total} images: {reasons}",
    graver=Severity.WARNING,
)
MAYBE_MIRRORED = RemarkKind("maybe_mirrored", Severity.WARNING, "{reason}")
NO_BOARD_ON_GEL = RemarkKind(
    "no_board_on_gel",
    Severity.INFO,
    "no board lies on the gel (on_gel = true): the lens is calibrated; mm/px and the camera's pose "
    "are those of the profile it was applied to",
)
NO_VIEWS = RemarkKind(
    "no_views",
    Severity.INFO,
    "no views of a board in air: the scale is calibrated; focal length and pose of the camera stay "
    "as designed, one flat board cannot tell them apart",
)
CROPPED = RemarkKind(
    "cropped",
    Severity.INFO,
    "the pixel grid is that of the rectified image of {width}x{height} px, cut out of "
    "{raw_width}x{raw_height} px as the profile says; --maps writes the maps",
)
SIZE_DIFFERS = RemarkKind(
    "size_differs",
    Severity.ERROR,
    "the board was seen in images of {width}x{height} px, the background has "
    "{background_width}x{background_height} px: the scale holds for images of the board's size "
    "only",
)
STATED_SCALE_DIFFERS = RemarkKind(
    "stated_scale_differs",
    Severity.WARNING,
    "the captures state mm_per_px_{axis} = {stated:g}, measured is {measured}: {off:+.1%}",
)

# The lens.
OUTLIER_VIEWS = RemarkKind(
    "outlier_views",
    Severity.INFO,
    "{count} of {total} views were left out of the fit; they count in the held-out error of "
    "{heldout_px:.2f} px ({robust_px:.2f} px robust): {names}",
    graver=Severity.WARNING,
)
NOT_CONVERGED = RemarkKind("not_converged", Severity.ERROR, "the fit of the lens did not converge")
FEW_LENS_VIEWS = RemarkKind(
    "few_lens_views",
    Severity.WARNING,
    "only {count} views of the board; 20 or more, spread over the image, determine the distortion",
)
LENS_COVERAGE = RemarkKind(
    "lens_coverage",
    Severity.WARNING,
    "the board covers {share:.0%} of the image; the distortion is unknown beyond. Show the board "
    "in the corners too",
)
NO_TILT = RemarkKind(
    "no_tilt",
    Severity.ERROR,
    "no view is tilted by more than {tilt:.1f} degrees, so that the focal length cannot be told "
    "from the distance; tilt the board by 20 to 45 degrees",
)
VIEWS_ALIKE = RemarkKind(
    "views_alike",
    Severity.ERROR,
    "all views show the board from one side, within {spread:.1f} degrees, so that the focal length "
    "cannot be told from the distance; tilt it to all sides",
)
FOCAL_UNCERTAIN = RemarkKind(
    "focal_uncertain",
    Severity.WARNING,
    "the focal length is known to {percent:.1f} % only; take more views with more tilt",
    graver=Severity.ERROR,
)
LENS_ERROR = RemarkKind(
    "lens_error",
    Severity.WARNING,
    "held-out views are {error_px:.2f} px off, usual are less than {usual_px:.1f} px; {cause}",
    graver=Severity.ERROR,
)

# Boards on the gel.
NO_REFRACTION = RemarkKind(
    "no_refraction",
    Severity.WARNING,
    "the board is explained to {straight_px:.3f} px by straight sight lines, to "
    "{refracted_px:.3f} px through the profile's window and gel: the pose is that of straight "
    "sight lines. The profile's thicknesses are wrong, or the lens was calibrated through the gel "
    "already",
)
DISTORTED = RemarkKind(
    "distorted",
    Severity.WARNING,
    "the scale runs from {least:.2f} to {largest:.2f} of its value at the board's middle: mm/px "
    "hold about the middle of the raw image, and everywhere only in images that are rectified "
    "(--maps)",
)
SHEAR = RemarkKind(
    "shear",
    Severity.WARNING,
    "the image's axes are {angle:.2f} degrees off a right angle; the camera looks at the gel "
    "askew, rectify the images (--maps)",
)
BOARD_ERROR = RemarkKind(
    "board_error",
    Severity.WARNING,
    "points of the board that were left out are {error_px:.2f} px off, {share:.1%} of its pitch; "
    "the board is bent, or its dots are blurred",
)
BOARD_PRESSED = RemarkKind(
    "board_pressed",
    Severity.INFO,
    "the scale holds where the board lay. Where it was pressed in, the untouched face is farther "
    "from the camera and its mm/px are larger: by {share:.1%} for each 0.1 mm of depth with the "
    "camera as designed. No image tells how deep it was; press it no deeper than dots need to show",
)
MISSING_POINTS = RemarkKind(
    "missing_points", Severity.INFO, "{found} of {expected} points of the board were found"
)
OFF_CENTER = RemarkKind(
    "off_center",
    Severity.ERROR,
    "the gel frame's origin at pixel ({u:.0f}, {v:.0f}) is not under the board, so that the scale "
    "there is extrapolated; lay the board over the middle of the image of {width}x{height} px",
)
POSE_DISAGREES = RemarkKind(
    "pose_disagrees",
    Severity.WARNING,
    "the calibrated lens explains the board on the gel to {lens_px:.2f} px, a free map to "
    "{free_px:.2f} px: what lies before the gel bends the light otherwise, or focus or crop "
    "changed between the views. The scale is that of the free map",
)
