# SPDX-License-Identifier: Apache-2.0
"""The square GelSight of Taccel's examples."""

from taccel_lab.sensors.gelsight_40.family import FAMILY, GelSight40Parameters

__all__ = ["FAMILY", "GelSight40Parameters"]
