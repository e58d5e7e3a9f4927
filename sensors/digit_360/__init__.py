# SPDX-License-Identifier: Apache-2.0
"""The DIGIT 360 of Meta."""

from taccel_lab.sensors.digit_360.family import FAMILY, Digit360Parameters

__all__ = ["FAMILY", "Digit360Parameters"]
