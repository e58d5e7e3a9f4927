# SPDX-License-Identifier: Apache-2.0
"""Checks of captures before anything is fitted to them."""

from taccel_lab.calibration.check.check_page import check_page
from taccel_lab.calibration.check.content import BlockStatus, Readiness
from taccel_lab.calibration.check.run import CaptureCheck, check_captures

__all__ = [
    "BlockStatus",
    "CaptureCheck",
    "Readiness",
    "check_captures",
    "check_page",
]
