# SPDX-License-Identifier: Apache-2.0
"""The classic domed GelSight."""

from sensors.gelsight.family import FAMILY, GelSightParameters

__all__ = ["FAMILY", "GelSightParameters"]
