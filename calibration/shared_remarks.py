# SPDX-License-Identifier: Apache-2.0
"""What several calibrations, or a check and a calibration, remark alike."""

from __future__ import annotations

from taccel_lab.calibration.remarks import RemarkKind
from taccel_lab.report.remark import Severity

TOO_FEW = RemarkKind("too_few", Severity.WARNING, "{count} {what}: {wanted}", graver=Severity.ERROR)
NOTHING_HELD_OUT = RemarkKind(
    "nothing_held_out",
    Severity.WARNING,
    "no press was held out, so that nothing tells how well other presses do; use --holdout-every 4",
)
HELDOUT_FAILED = RemarkKind(
    "heldout_failed",
    Severity.WARNING,
    "{count} held-out presses could not be used and count as the bare gel: {reasons}",
)
LABELS_UNUSED = RemarkKind(
    "labels_unused",
    Severity.INFO,
    "images reject the circles given with {count} presses ({names}): found ones are fitted there",
)
LABELS_REJECTED = RemarkKind(
    "labels_rejected",
    Severity.WARNING,
    "{count} held-out presses stand beside the figures, which are over the others: their images "
    "reject the circles given with them, and they are placed where a contact is found: {names}",
)
HELDOUT_ERROR = RemarkKind(
    "heldout_error",
    Severity.WARNING,
    "{what} that were held out are off by {error}; {advice}",
    graver=Severity.ERROR,
)
LABELS_OFF = RemarkKind(
    "labels_off",
    Severity.WARNING,
    "{off} of {count} {what} disagree with the images: {how}. {advice}",
    graver=Severity.ERROR,
)
GREY_OR_COLOUR = RemarkKind(
    "grey_or_colour",
    Severity.WARNING,
    "the images are {found}, {expected} ones are expected: another sensor, images that were "
    "converted, or another command is meant (normals for coloured lamps, depth for grey)",
    graver=Severity.ERROR,
)
SCALE_NOT_MEASURED = RemarkKind(
    "scale_not_measured",
    Severity.WARNING,
    "millimetres rest on {source}, which nobody measured on this unit; add a board on the gel, "
    "presses of an edge or markers of known pitch, or give a profile with a measured camera as "
    "--base",
)
SCALE_DISAGREES = RemarkKind(
    "scale_disagrees",
    Severity.WARNING,
    "scales contradict each other: {scales}. One of the stated lengths is wrong, or the images are "
    "not of one size and crop",
    graver=Severity.ERROR,
)

# How images lie on the pad.
PAD_TURNED = RemarkKind(
    "pad_turned",
    Severity.INFO,
    "the images are upright, the catalogue's {sensor} lies down: its pad was turned by a quarter, "
    "and its camera, lights and housing with it (which way round, the catalogue cannot know)",
)
FLAT_PAD_ASSUMED = RemarkKind(
    "flat_pad",
    Severity.WARNING,
    "flat_pad stands for a sensor that is not in the catalogue: its gel is taken as flat, bonded "
    "to a plate. How thick it is, {thickness_mm:g} mm where nothing tells it, is fitted to the "
    "ball presses, with its interval in every +- of a depth. Measure it and write thickness_mm "
    "under [design] in captures.toml, and they are narrower",
)
IMAGES_ACROSS = RemarkKind(
    "images_across",
    Severity.WARNING,
    "the images {lie} ({width_mm:.1f} x {height_mm:.1f} mm), the pad of a {sensor} lies across "
    "them and is curved: its shape at rest is then wrong. Turn all images by a quarter, unless "
    "they are a crop",
)
SCALE_PAST_PAD = RemarkKind(
    "scale_past_pad",
    Severity.ERROR,
    "at {mm_per_px_x:g} x {mm_per_px_y:g} mm/px the image shows {width:.1f} x {height:.1f} mm, "
    "more than the pad of {pad_x:g} x {pad_y:g} mm; check the scale, mask what lies beside the gel "
    "(mask.png), or design a larger pad",
    ("color", "normals", "depth"),
)
PAD_EDGE = RemarkKind(
    "pad_edge",
    Severity.INFO,
    "at {mm_per_px_x:g} x {mm_per_px_y:g} mm/px the image shows {width:.1f} x {height:.1f} mm of a "
    "pad of {pad_x:g} x {pad_y:g} mm: pixels beside the pad and within {edge:g} mm of its edge, "
    "{share:.1%} of those in use, are left out. Check the scale if the camera does not see the "
    "edge",
    ("color", "normals", "depth"),
    graver=Severity.WARNING,
)
