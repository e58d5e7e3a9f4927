# SPDX-License-Identifier: Apache-2.0
"""The GelSight R1.5."""

from taccel_lab.sensors.gelsight_r15.family import FAMILY, GelSightR15Parameters

__all__ = ["FAMILY", "GelSightR15Parameters"]
