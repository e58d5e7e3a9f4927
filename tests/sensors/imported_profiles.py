# SPDX-License-Identifier: Apache-2.0
"""Profiles of gels that no family describes, without a mesher: a catalogue's mesh stands in."""

from __future__ import annotations

import dataclasses
from typing import Any

from taccel_lab.profile import SensorProfile
from taccel_lab.sensors.profile import catalogue_profile
from taccel_lab.sensors.profile_family import IMPORTED, LIKE_KEY, SHAPES
from taccel_lab.sensors.registry import sensor_family

SIZE = {"length_x_mm": 16.0, "length_y_mm": 14.0, "crown_radius_mm": 40.0, "thickness_mm": 4.0}


def imported(like: str = "flat_pad", size: dict[str, Any] = SIZE, **values: Any) -> SensorProfile:
    """A crowned gel of 16 x 14 x 4 mm, all else like a sensor of the catalogue."""
    profile = catalogue_profile("gelsight", size)
    others = sensor_family(like).parameters(values)
    kept = {
        name: item["value"]
        for name, item in others.describe().items()
        if (item["group"] or "gel") not in SHAPES
    }
    sensor = profile.sensor.replace(
        name="mine", family=IMPORTED, parameters={LIKE_KEY: like, **kept}
    )
    return dataclasses.replace(profile, sensor=sensor)
