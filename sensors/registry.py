# SPDX-License-Identifier: Apache-2.0
"""The families known here: the built-in ones and those of installed packages.

A package adds a family with an entry point of the group ``taccel_lab.sensors`` whose object is a
``SensorFamily`` (docs/sensors.md shows one). A package that cannot be loaded takes nothing from the
others: it is kept aside with the reason, which whoever asks for its sensor is told.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points

from taccel_lab.errors import InputError
from taccel_lab.sensors.base import SensorFamily

ENTRY_POINT_GROUP = "taccel_lab.sensors"
IMPORTED = "imported"
"""Family, in a profile, of a gel that no family describes: it is the profile's mesh."""

_BUILT_IN = (
    "digit",
    "digit_360",
    "flat_pad",
    "gelsight",
    "gelsight_40",
    "gelsight_mini",
    "gelsight_r15",
    "gelsight_wedge",
    "ninedtact",
    "rtac",
)
"""Folders of this package, each with a module ``family`` and its ``FAMILY``."""


@dataclass(frozen=True)
class BrokenFamily:
    """An entry point that gives no family."""

    name: str
    """Name of the entry point."""
    package: str
    """Installed distribution that declares it."""
    reason: str


@dataclass(frozen=True)
class Catalogue:
    """All families, and the entry points that give none."""

    families: dict[str, SensorFamily]
    """By name, sorted."""
    broken: dict[str, BrokenFamily]
    """By name of the entry point, sorted."""


def catalogue() -> Catalogue:
    """Load the built-in families and those of installed packages."""
    built_in = [import_module(f"taccel_lab.sensors.{name}.family").FAMILY for name in _BUILT_IN]
    families = {family.name: family for family in built_in}
    broken = {}
    for entry in _declared(tuple((place, _changed_ns(place)) for place in sys.path)):
        found = _load(entry)
        if isinstance(found, SensorFamily) and families.setdefault(found.name, found) is not found:
            found = _broken(
                entry, f"the sensor {found.name} exists already; give the family another name"
            )
        if isinstance(found, BrokenFamily):
            broken[found.name] = found
    return Catalogue(dict(sorted(families.items())), dict(sorted(broken.items())))


def sensor_families() -> dict[str, SensorFamily]:
    """All families that could be loaded, by name, sorted."""
    return catalogue().families


def sensor_family(name: str) -> SensorFamily:
    """The family called ``name``.

    Raises:
        InputError: Unknown, with the known names; or its package cannot be loaded, with the reason.
    """
    known = catalogue()
    if name in known.families:
        return known.families[name]
    if name in known.broken:
        found = known.broken[name]
        raise InputError(f"the sensor {name} of the package {found.package}: {found.reason}")
    also = "; flat_pad stands for any flat gel" if "flat_pad" in known.families else ""
    raise InputError(f"no sensor {name!r}; known: {', '.join(known.families)}{also}")


@lru_cache(maxsize=1)
def _declared(places: tuple[tuple[str, int], ...]) -> tuple[EntryPoint, ...]:
    """The entry points of packages in ``places``, each with when it last changed: to read the
    metadata of all packages takes 10 to 20 ms, and every command asks several times."""
    return tuple(entry_points(group=ENTRY_POINT_GROUP))


def _changed_ns(place: str) -> int:
    """When something was last installed in a folder of ``sys.path``; 0 where there is none."""
    try:
        return os.stat(place or os.curdir).st_mtime_ns
    except OSError:
        return 0


def _broken(entry: EntryPoint, reason: str) -> BrokenFamily:
    package = entry.dist.name if entry.dist is not None else "unknown"
    return BrokenFamily(entry.name, package, f"the entry point {entry.value} {reason}")


def _load(entry: EntryPoint) -> SensorFamily | BrokenFamily:
    try:
        found = entry.load()
    except Exception as error:  # a foreign module may raise anything while it is imported
        return _broken(entry, f"cannot be loaded: {type(error).__name__}: {error}")
    if not isinstance(found, SensorFamily):
        return _broken(entry, f"is a {type(found).__name__}, not a SensorFamily")
    if found.name != entry.name:
        return _broken(
            entry, f"gives a sensor called {found.name}; entry point and sensor need one name"
        )
    return found
