# SPDX-License-Identifier: Apache-2.0
"""Any flat gel bonded to a plate, for sensors that the catalogue does not know."""

from taccel_lab.sensors.flat_pad.family import FAMILY, FlatPadParameters

__all__ = ["FAMILY", "FlatPadParameters"]
