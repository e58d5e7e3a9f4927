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
