# SPDX-License-Identifier: Apache-2.0
"""The 9DTact."""

from taccel_lab.sensors.ninedtact.family import FAMILY, NineDTactParameters

__all__ = ["FAMILY", "NineDTactParameters"]
