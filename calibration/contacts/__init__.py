# SPDX-License-Identifier: Apache-2.0
"""Calibration targets: what a press of a known object looks like in an image."""

from taccel_lab.calibration.contacts.agreement import LabelAgreement, compare_with_labels
from taccel_lab.calibration.contacts.ball import (
    DetectedContact,
    FoundContacts,
    Refusal,
    detect_contact,
    find_contacts,
    resolve_contacts,
)
from taccel_lab.calibration.contacts.fusion import choose_circles, fuse_circles
from taccel_lab.calibration.contacts.selection import MAX_LOST_SHARE, usable_presses

__all__ = [
    "MAX_LOST_SHARE",
    "DetectedContact",
    "FoundContacts",
    "LabelAgreement",
    "Refusal",
    "choose_circles",
    "compare_with_labels",
    "detect_contact",
    "find_contacts",
    "fuse_circles",
    "resolve_contacts",
    "usable_presses",
]
