# SPDX-License-Identifier: Apache-2.0
"""The classic domed GelSight."""

from taccel_lab.sensors.gelsight.family import FAMILY, GelSightParameters

__all__ = ["FAMILY", "GelSightParameters"]
