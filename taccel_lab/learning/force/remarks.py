# SPDX-License-Identifier: Apache-2.0
"""What a person has to know of a force model."""

from __future__ import annotations

from taccel_lab.calibration.remarks import info, warning
from taccel_lab.report.remark import Severity

FEW_IMAGES_COUNT = 5000
LARGE_SHARE, USELESS_SHARE = 0.15, 0.5
"""Error of the force along z over its spread, on held-out touches."""
NO_SHEAR_SHARE = 0.8
"""The same along the face."""
FALSE_ALARMS = 0.05
FOUND_SHARE = 0.9

SIMULATED = info(
    "force_simulated",
    "trained and scored on simulated touches: errors on real images are larger by what the colour "
    "model and the material are off, and no measured force was there to tell. Compare some presses "
    "of known force first",
)
STIFFNESS_UNKNOWN = warning(
    "force_stiffness_unknown",
    "the profile states no spread of its modulus, so that the stated errors leave it out: forces "
    "are proportional to it, and units that are nominally equal differ by 10 to 25 %. Measure it "
    "(taccel-lab calibrate material), or give --stiffness",
)
NO_LIGHT = warning(
    "force_one_light",
    "trained in the background's own light: the profile has no block perturbation, or --light is "
    "0. A lamp that drifts then reads as a touch. Measure the drift (taccel-lab calibrate "
    "background)",
)
FEW_IMAGES = warning(
    "force_few_images",
    "{count} images of {touches} touches; errors fall up to 10,000 images and more",
)
LARGE_ERROR = warning(
    "force_large_error",
    "the force along z of held-out touches is off by {error:.3f} N (root mean square), {share:.0%} "
    "of the {spread:.3f} N that such forces have",
    graver=Severity.ERROR,
)
NO_SHEAR = warning(
    "force_along_the_face",
    "forces along the face are off by {error:.3f} N on held-out touches, {share:.0%} of the "
    "{spread:.3f} N that they have: who says zero does as well. Use forces along z alone, train on "
    "more touches, or on a gel with markers",
)
OVERCONFIDENT = warning(
    "force_errors_understated",
    "{inside:.0%} of the errors on held-out touches lie within what should hold 95 %",
)
FALSE_ALARM = warning(
    "force_false_alarms",
    "{share:.1%} of the images of held-out objects and units are called outside the training's "
    "range",
)
MISSED = warning(
    "force_misses",
    "not all wrong images are noticed: {missed}",
)
NO_UNITS = warning(
    "force_one_unit",
    "no unit was held out: the data set has {units}. Draw some (units and test_units of its file)",
)
OTHER_PROFILE = warning(
    "force_other_profile",
    "the data set was made with another profile than the one that is extended; forces are "
    "scaled by the moduli, all else is taken as equal",
)
