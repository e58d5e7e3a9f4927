# SPDX-License-Identifier: Apache-2.0
"""What the check of captures can find; each finding names the blocks that it stops or harms."""

from __future__ import annotations

from taccel_lab.calibration.remarks import error, info, warning
from taccel_lab.report.remark import Severity

BY_COLOR = ("color", "normals")
"""Blocks that learn from the colours of ball presses."""
BY_BACKGROUND = ("background", "color", "normals")

# The folder as a whole.
EMPTY = error("empty", "the folder holds no captures")
SENSOR_UNKNOWN = error(
    "sensor_unknown",
    "the catalogue has no sensor {sensor!r} (taccel-lab sensors list); flat_pad stands for any "
    "flat gel, and the folder of a profile for a gel of your own",
    ("color", "normals", "material"),
)
BALL_RADIUS_UNSTATED = error(
    "ball_radius_unstated",
    "the radius of the ball is not stated: without it a contact says nothing about slopes. Measure "
    "the ball and add [indenter] radius_mm",
    ("color", "normals", "scale", "depth"),
)
SCALE_UNSTATED = error(
    "scale_unstated",
    "the scale is not stated and nothing here gives it: add mm_per_px_x and mm_per_px_y, a press "
    "of a board or of a known edge, or the pitch of the markers",
    ("color", "normals", "depth"),
)
ASSUMED = info(
    "assumed",
    "{count} values are assumed, no file states them: {assumed}. Correct what is wrong in "
    "captures.toml, and take out of [assumed] what you have checked",
)

# The background.
NO_BACKGROUND = error(
    "no_background",
    "there is no image of the untouched gel. {instead}",
    BY_BACKGROUND,
)
BACKGROUND_DIFFERS = error(
    "background_differs",
    "the background is not that of the presses: {reason}.{advice}",
    BY_BACKGROUND,
)
UNTOUCHED_DIFFERS = warning(
    "untouched_differs",
    "{name} is {misfit:.0f} levels from the background after exposure and white balance are "
    "fitted: the sensor has changed, or it is another one",
    ("background",),
)
BACKGROUND_PRESSED = error(
    "background_pressed",
    "something touches the gel in the background, around ({u:.0f}, {v:.0f}) px: {count} presses "
    "that lie elsewhere differ from it there alike, by {levels:.0f} levels. Take an image of the "
    "untouched gel, or use capture import --background median",
    BY_BACKGROUND,
)

MEDIAN_PRESSED = error(
    "median_pressed",
    "the median of the presses shows a press, too: {reason}. Take an image of the untouched gel",
    BY_BACKGROUND,
)

# Light and channels.
SATURATED = warning(
    "saturated",
    "{bad} of {count} contacts have more than {limit:.0%} of their pixels at full level (up to "
    "{largest:.0%}): their colours are cut off. Lower the exposure",
    BY_COLOR,
    graver=Severity.ERROR,
)
CHANNELS_SWAPPED = error(
    "channels_swapped",
    "the colour channels of {what} are in different orders: read as {order} the frames are "
    "{best:.0f} levels from the background, as they are {as_is:.0f}. Save all images through one "
    "program (OpenCV writes BGR)",
    ("color", "normals", "background"),
)
LAMPS_REVERSED = warning(
    "lamps_reversed",
    "red, green and blue light come {found} round the contacts, on a {family} {expected}: red and "
    "blue are swapped in all images (BGR saved as RGB), the images are mirrored, or it is another "
    "sensor",
    BY_COLOR,
)
MIXED_SENSORS = error(
    "mixed_sensors",
    "the untouched gel looks different in {names} than in the other {others} images compared: "
    "{between:.0f} levels apart where frames of one kind differ by {within:.0f}. They are of "
    "another sensor, crop or lamp setting; give each its own folder",
    ("color", "normals", "background"),
)

CHANNEL_DEAD = warning(
    "channel_dead",
    "{what} in {bad} of {count} images ({names}): a lamp is off, or the channel was lost",
    BY_COLOR,
    graver=Severity.ERROR,
)
CHANNELS_EQUAL = warning(
    "channels_equal",
    "channels are copies of each other in {bad} of {count} images ({names}): grey was saved as "
    "colour",
    BY_COLOR,
    graver=Severity.ERROR,
)
LEVELS_MISSING = warning(
    "levels_missing",
    "only {least:.0%} of the levels occur in {bad} of {count} images ({names}), which were "
    "quantised or stretched",
    BY_COLOR,
    graver=Severity.ERROR,
)
ENLARGED = warning(
    "enlarged",
    "{bad} of {count} images ({names}) show nothing finer than four pixels, not even noise: "
    "enlarged, or far out of focus",
    ("color", "normals", "scale"),
    graver=Severity.ERROR,
)
TONE_CURVE = warning(
    "tone_curve",
    "{bad} of {count} presses ({names}) have another tone curve than {than}: {how}. Switch HDR, "
    "gamma, contrast and room light off",
    BY_COLOR,
    graver=Severity.ERROR,
)
SIDES_EXCHANGED = warning(
    "sides_exchanged",
    "{bad} of {count} presses ({names}) fit the background {how}",
    ("color", "normals", "background"),
    graver=Severity.ERROR,
)

# Ball presses.
NOT_WHOLE = warning(
    "not_whole",
    "{lost} of {count} presses did not come whole from the camera ({names}) and are left out. "
    "{first}: {reason}",
    ("color", "normals", "scale"),
    graver=Severity.ERROR,
)
NO_CONTACT = warning(
    "no_contact",
    "no contact was found in {lost} of {count} presses ({names}). {first}: {reason}.{border}",
    ("color", "normals", "scale"),
    graver=Severity.ERROR,
)
ONE_SPOT = error(
    "one_spot",
    "all {count} presses lie within {reach:.0f} px of each other and cover {covered:.0%} of the "
    "gel: colours elsewhere cannot be learned. Press all over the gel, also near its edges",
    BY_COLOR,
)
COVERAGE = warning(
    "coverage",
    "the contacts cover {covered:.0%} of the gel; no press in {empty} of {parts} parts of the "
    "image{names}. The colour model is only valid where balls were",
    ("color",),
)
SAME_DEPTH = warning(
    "same_depth",
    "all contacts are of nearly one size ({smallest:.0f} to {largest:.0f} px): press with "
    "different forces, so that every slope is seen at every place",
    BY_COLOR,
)
BLURRED = warning(
    "blurred",
    "{blurred} of {count} presses are blurred against the others ({names}): the fine texture of "
    "the gel is gone beside the contact, or its rim is wide. They were moving, or out of focus",
    ("color", "normals", "scale"),
)
DUPLICATES = warning(
    "duplicates",
    "the same press is there several times: {names}. Figures on held-out frames would be of frames "
    "that the fit has seen. Remove the copies",
    ("color", "normals", "depth"),
)

# The ball's radius and the scale.
BALL_TOO_SMALL = warning(
    "ball_too_small",
    "{wider} of {count} contacts are wider than their ball ({names}): {first} has a radius of "
    "{widest:.2f} +- {sigma:.2f} mm at {mm_per_px:g} mm/px, the ball {stated:g} mm. The ball's "
    "radius is too small, or the scale too large",
    ("color", "normals", "scale"),
    graver=Severity.ERROR,
)
BALL_CONTRADICTED = error(
    "ball_contradicted",
    "the ball's radius{diameter}, the scale or the travel is wrong: {evidence}",
    ("color", "normals", "scale", "material"),
)
BALL_FROM_BELOW = info(
    "ball_from_below",
    "images bound the ball's radius from below only: {larger:.3g} mm would leave {larger_rms:.2f} "
    "levels, the stated {stated:g} mm leave {rms:.2f}. Depths rest on the stated radius, and no +- "
    "holds another one. Travel (depth_mm) or a second ball tells",
)
BALL_OR_DIAMETER = warning(
    "ball_or_diameter",
    "{stated:g} mm may be the ball's diameter: contacts reach {largest:.0%} of it, so that half of "
    "it leaves them, too. Depths may be twice as large, which intervals hold. Measure the ball and "
    "add diameter_mm to [indenter], press deeper, or state depth_mm",
    ("color", "normals", "depth"),
)
WRONG_BALL_RADIUS = error(
    "wrong_ball_radius",
    "wrong ball radius or scale: the joint fit leaves {rms:.2f} levels with the stated {stated:g} "
    "mm and {best_rms:.2f} with {best:.3g} mm; {pinned} of {count} contacts are as large as the "
    "ball, and the colours ask for at least {lowest:.3g} mm. Measure the ball, and check mm_per_px",
)
SCALE_UNUSUAL = warning(
    "scale_unusual",
    "at {mm_per_px:g} mm/px the image is {length:.1f} mm long, {usual}: check the scale, or the "
    "crop of the images",
    ("scale", "color", "normals", "depth"),
)
SIZE_OTHER = warning(
    "size_other",
    "the images are {width}x{height} px, those of the catalogue's {family} "
    "{usual_width}x{usual_height} px: other proportions show another part of the gel. Is it "
    "another crop, mode of the camera or sensor? State the scale of these images (mm_per_px_x, "
    "mm_per_px_y), and give later ones the same framing",
    ("scale", "background", "color", "normals", "depth"),
)
