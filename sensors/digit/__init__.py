# SPDX-License-Identifier: Apache-2.0
"""The DIGIT of Meta."""

from taccel_lab.sensors.digit.family import FAMILY, DigitParameters

__all__ = ["FAMILY", "DigitParameters"]
