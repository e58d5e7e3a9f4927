# SPDX-License-Identifier: Apache-2.0
"""What choosing the design for captures can remark."""

from __future__ import annotations

from taccel_lab.calibration.remarks import RemarkKind
from taccel_lab.calibration.result import Severity

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
    "to a plate and {thickness_mm:g} mm thick. The thickness shapes the sunk gel beside a contact, "
    "and says how deep a press went (3 mm instead of 4 mm: 5 to 7 % less deep). Measure it, and "
    "write thickness_mm under [design] in captures.toml",
)
IMAGES_ACROSS = RemarkKind(
    "images_across",
    Severity.WARNING,
    "the images {lie} ({width_mm:.1f} x {height_mm:.1f} mm), the pad of a {sensor} lies across "
    "them and is curved: its shape at rest is then wrong. Turn all images by a quarter, unless "
    "they are a crop",
)
