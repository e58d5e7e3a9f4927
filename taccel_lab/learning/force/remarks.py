# SPDX-License-Identifier: Apache-2.0
"""What a person has to know of a force model."""

from __future__ import annotations

from taccel_lab.calibration.remarks import RemarkKind
from taccel_lab.report.remark import Severity

FEW_IMAGES_COUNT = 5000
LARGE_SHARE, USELESS_SHARE = 0.15, 0.5
"""Error of the force along z over its spread, on held-out touches."""
NO_SHEAR_SHARE = 0.8
"""The same along the face."""
FALSE_ALARMS = 0.05
FOUND_SHARE = 0.9

SIMULATED = RemarkKind(
    "force_simulated",
    Severity.INFO,
    "trained and scored on simulated touches: errors on real images are larger by what the colour "
    "model and the material are off, and no measured force was there to tell. Compare some presses "
    "of known force first",
)
STIFFNESS_UNKNOWN = RemarkKind(
    "force_stiffness_unknown",
    Severity.WARNING,
    "the profile states no spread of its modulus, so that the stated errors leave it out: forces "
    "are proportional to it, and units that are nominally equal differ by 10 to 25 %. Measure it "
    "(taccel-lab calibrate material), or give --stiffness",
)
NO_LIGHT = RemarkKind(
    "force_one_light",
    Severity.WARNING,
    "trained in the background's own light: the profile has no block perturbation, or --light is "
    "0. A lamp that drifts then reads as a touch. Measure the drift (taccel-lab calibrate background)",
)
FEW_IMAGES = RemarkKind(
    "force_few_images",
    Severity.WARNING,
    "{count} images of {touches} touches; errors fall up to 10,000 images and more",
)
LARGE_ERROR = RemarkKind(
    "force_large_error",
    Severity.WARNING,
    "the force along z of held-out touches is off by {error:.3f} N (root mean square), {share:.0%} "
    "of the {spread:.3f} N that such forces have",
    graver=Severity.ERROR,
)
NO_SHEAR = RemarkKind(
    "force_along_the_face",
    Severity.WARNING,
    "forces along the face are off by {error:.3f} N on held-out touches, {share:.0%} of the "
    "{spread:.3f} N that they have: who says zero does as well. Use forces along z alone, train on "
    "more touches, or on a gel with markers",
)
OVERCONFIDENT = RemarkKind(
    "force_errors_understated",
    Severity.WARNING,
    "{inside:.0%} of the errors on held-out touches lie within what should hold 95 %",
)
FALSE_ALARM = RemarkKind(
    "force_false_alarms",
    Severity.WARNING,
    "{share:.1%} of the images of held-out objects and units are called outside the training's "
    "range",
)
MISSED = RemarkKind(
    "force_misses",
    Severity.WARNING,
    "not all wrong images are noticed: {missed}",
)
NO_UNITS = RemarkKind(
    "force_one_unit",
    Severity.WARNING,
    "no unit was held out: the data set has {units}. Draw some (units and test_units of its file)",
)
OTHER_PROFILE = RemarkKind(
    "force_other_profile",
    Severity.WARNING,
    "the data set was made with another profile than the one that is extended; forces are "
    "scaled by the moduli, all else is taken as equal",
)
