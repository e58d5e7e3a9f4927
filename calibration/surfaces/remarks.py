# SPDX-License-Identifier: Apache-2.0
"""What choosing the design for captures can remark."""

from __future__ import annotations

from taccel_lab.calibration.remarks import RemarkKind
from taccel_lab.report.remark import Severity

PAD_TURNED = RemarkKind(
    "pad_turned",
    Severity.INFO,
    "the images are upright, the catalogue's {sensor} lies down: its pad was turned by a quarter, "
    "and its camera, lights and housing with it (which way round, the catalogue cannot know)",
)
FLAT_PAD = RemarkKind(
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
