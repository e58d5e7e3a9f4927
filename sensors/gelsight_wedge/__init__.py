# SPDX-License-Identifier: Apache-2.0
"""The GelSight Wedge."""

from taccel_lab.sensors.gelsight_wedge.family import FAMILY, GelSightWedgeParameters

__all__ = ["FAMILY", "GelSightWedgeParameters"]
