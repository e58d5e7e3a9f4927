# SPDX-License-Identifier: Apache-2.0
"""Two profiles side by side: what differs, by how much, and whether the spread explains it."""

from taccel_lab.calibration.comparison.compare import ProfileComparison, compare_profiles
from taccel_lab.calibration.comparison.fields import FieldDifference, compare_fields
from taccel_lab.calibration.comparison.responses import ResponseDifference, compare_responses

__all__ = [
    "FieldDifference",
    "ProfileComparison",
    "ResponseDifference",
    "compare_fields",
    "compare_profiles",
    "compare_responses",
]
