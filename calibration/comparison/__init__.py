# SPDX-License-Identifier: Apache-2.0
"""Two profiles side by side: what differs, by how much, and whether the spread explains it."""

from taccel_lab.calibration.comparison.compare import ProfileComparison, compare_profiles

__all__ = ["ProfileComparison", "compare_profiles"]
