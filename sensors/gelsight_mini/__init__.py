# SPDX-License-Identifier: Apache-2.0
"""The GelSight Mini."""

from taccel_lab.sensors.gelsight_mini.family import FAMILY, GelSightMiniParameters

__all__ = ["FAMILY", "GelSightMiniParameters"]
