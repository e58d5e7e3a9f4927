# SPDX-License-Identifier: Apache-2.0
"""What several calibrations, or a check and a calibration, remark alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from taccel_lab.calibration.remarks import error, info, warning
from taccel_lab.report.remark import Remark, Severity

TOO_FEW = warning("too_few", "{count} {what}: {wanted}", graver=Severity.ERROR)
NOTHING_HELD_OUT = warning(
    "nothing_held_out",
    "no press was held out, so that nothing tells how well other presses do; use --holdout-every 4",
)
HELDOUT_FAILED = warning(
    "heldout_failed",
    "{count} held-out presses could not be used and count as the bare gel: {reasons}",
)
LABELS_UNUSED = info(
    "labels_unused",
    "images reject the circles given with {count} presses ({names}): found ones are fitted there",
)
LABELS_REJECTED = warning(
    "labels_rejected",
    "{count} held-out presses stand beside the figures, which are over the others: their images "
    "reject the circles given with them, and they are placed where a contact is found: {names}",
)
HELDOUT_ERROR = warning(
    "heldout_error",
    "{what} that were held out are off by {error}; {advice}",
    graver=Severity.ERROR,
)
LABELS_OFF = warning(
    "labels_off",
    "{off} of {count} {what} disagree with the images: {how}. {advice}",
    graver=Severity.ERROR,
)
GREY_OR_COLOUR = warning(
    "grey_or_colour",
    "the images are {found}, {expected} ones are expected: another sensor, images that were "
    "converted, or another command is meant (normals for coloured lamps, depth for grey)",
    graver=Severity.ERROR,
)
SCALE_NOT_MEASURED = warning(
    "scale_not_measured",
    "millimetres rest on {source}, which nobody measured on this unit; add a board on the gel, "
    "presses of an edge or markers of known pitch, or give a profile with a measured camera as "
    "--base",
)
SCALE_DISAGREES = warning(
    "scale_disagrees",
    "scales contradict each other: {scales}. One of the stated lengths is wrong, or the images are "
    "not of one size and crop",
    graver=Severity.ERROR,
)

PRESSES_LEFT_OUT = warning(
    "presses_left_out",
    "{lost} of {count} presses were left out: {names}. {reasons}.{advice}",
)
LIGHT_DRIFTS = warning(
    "light_drifts",
    "over {frame_count} frames the untouched gel changes by {changes} levels (standard deviation), "
    "at most {largest:.0f}. {cause}",
)

# Blocks of a profile.
BLOCK_STATE = warning("block_state", "{block}: calibrated, but {what}", graver=Severity.ERROR)
BLOCK = warning("block", "{block}: {what}", graver=Severity.ERROR)
"""Why a block is not calibrated, or what its own remark says, as grave as that."""
BLOCKS_DROPPED = warning(
    "blocks_dropped",
    "dropped from the base profile: {lost}. The profile holds for {old_width}x{old_height} px at "
    "{old_x:.4g} x {old_y:.4g} mm/px, these captures have {width}x{height} px at {x:.4g} x "
    "{y:.4g}. State the same scale, or calibrate these blocks again",
)

# How images lie on the pad.
PAD_TURNED = info(
    "pad_turned",
    "the images are upright, the catalogue's {sensor} lies down: its pad was turned by a quarter, "
    "and its camera, lights and housing with it (which way round, the catalogue cannot know)",
)
FLAT_PAD_ASSUMED = warning(
    "flat_pad",
    "flat_pad stands for a sensor that is not in the catalogue: its gel is taken as flat, bonded "
    "to a plate. How thick it is, {thickness_mm:g} mm where nothing tells it, is fitted to the "
    "ball presses, with its interval in every +- of a depth. Measure it and write thickness_mm "
    "under [design] in captures.toml, and they are narrower",
)
IMAGES_ACROSS = warning(
    "images_across",
    "the images {lie} ({width_mm:.1f} x {height_mm:.1f} mm), the pad of a {sensor} lies across "
    "them and is curved: its shape at rest is then wrong. Turn all images by a quarter, unless "
    "they are a crop",
)
SCALE_PAST_PAD = error(
    "scale_past_pad",
    "at {mm_per_px_x:g} x {mm_per_px_y:g} mm/px the image shows {width:.1f} x {height:.1f} mm, "
    "more than the pad of {pad_x:g} x {pad_y:g} mm; check the scale, mask what lies beside the gel "
    "(mask.png), or design a larger pad",
    ("color", "normals", "depth"),
)
PAD_EDGE = info(
    "pad_edge",
    "at {mm_per_px_x:g} x {mm_per_px_y:g} mm/px the image shows {width:.1f} x {height:.1f} mm of a "
    "pad of {pad_x:g} x {pad_y:g} mm: pixels beside the pad and within {edge:g} mm of its edge, "
    "{share:.1%} of those in use, are left out. Check the scale if the camera does not see the "
    "edge",
    ("color", "normals", "depth"),
    graver=Severity.WARNING,
)

MOST_NAMED = 6


def name_some(names: Sequence[str]) -> str:
    """A few names and how many more there are."""
    shown = ", ".join(names[:MOST_NAMED])
    return shown + (f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else "")


def left_out_remarks(
    failures: Mapping[str, str], rejected: Mapping[str, float | None], unit: str
) -> list[Remark]:
    """Remarks on held-out presses that could not be used, by name with the reason, and on those
    whose labels images reject, by name with the figure where they are found (None: they are not).
    """
    found = []
    if failures:
        reasons = "; ".join(f"{name}: {why}" for name, why in failures.items())
        found.append(HELDOUT_FAILED(count=len(failures), reasons=reasons))
    if rejected:
        names = [
            name + (" (not found)" if value is None else f" ({value:.1f} {unit})")
            for name, value in rejected.items()
        ]
        found.append(LABELS_REJECTED(count=len(names), names=", ".join(names)))
    return found
