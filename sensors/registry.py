# SPDX-License-Identifier: Apache-2.0
"""The families known here: the built-in ones and those of installed packages.

A package adds a family with an entry point of the group ``taccel_lab.sensors`` whose object is a
``SensorFamily``.
"""

from __future__ import annotations

from importlib.metadata import entry_points

from sensors.base import SensorFamily
from taccel_lab.errors import InputError

ENTRY_POINT_GROUP = "taccel_lab.sensors"


def sensor_families() -> dict[str, SensorFamily]:
    """All families by name, sorted. Raises InputError when two packages claim one name."""
    from sensors.gelsight import FAMILY as gelsight

    families = {family.name: family for family in (gelsight,)}
    for entry in entry_points(group=ENTRY_POINT_GROUP):
        family = entry.load()
        if not isinstance(family, SensorFamily):
            raise InputError(f"entry point {entry.name} = {entry.value} is not a SensorFamily")
        if families.setdefault(family.name, family) is not family:
            raise InputError(f"entry point {entry.value}: the sensor {family.name} exists already")
    return dict(sorted(families.items()))


def sensor_family(name: str) -> SensorFamily:
    """The family called ``name``; raises InputError with the known names."""
    families = sensor_families()
    if name not in families:
        raise InputError(f"no sensor {name!r}; known: {', '.join(families)}")
    return families[name]
