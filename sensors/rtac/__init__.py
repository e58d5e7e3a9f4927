# SPDX-License-Identifier: Apache-2.0
"""The R-Tac dome of PP-Tac."""

from taccel_lab.sensors.rtac.family import FAMILY, RTacParameters

__all__ = ["FAMILY", "RTacParameters"]
