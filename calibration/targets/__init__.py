# SPDX-License-Identifier: Apache-2.0
"""Calibration targets: what a press of a known object looks like in an image."""

from calibration.targets.ball import (
    DetectedContact,
    LabelAgreement,
    compare_with_labels,
    detect_contact,
    resolve_contacts,
)
from calibration.targets.fusion import choose_circles, fuse_circles

__all__ = [
    "DetectedContact",
    "LabelAgreement",
    "choose_circles",
    "compare_with_labels",
    "detect_contact",
    "fuse_circles",
    "resolve_contacts",
]
