# SPDX-License-Identifier: Apache-2.0
"""The DIGIT 360 of Meta."""

from sensors.digit_360.family import FAMILY, Digit360Parameters

__all__ = ["FAMILY", "Digit360Parameters"]
