# SPDX-License-Identifier: Apache-2.0
"""The catalogue of sensors: parameters, geometry and material of each family, with sources."""

from taccel_lab.sensors.base import FamilyParameters, GelMaterial, SensorFamily
from taccel_lab.sensors.registry import sensor_families, sensor_family

__all__ = [
    "FamilyParameters",
    "GelMaterial",
    "SensorFamily",
    "sensor_families",
    "sensor_family",
]
