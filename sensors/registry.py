# SPDX-License-Identifier: Apache-2.0
"""The sensors known here: the built-in families, those of installed packages, and any profile.

A package adds a family with an entry point of the group ``taccel_lab.sensors`` whose object is a
``SensorFamily`` (docs/sensors.md shows one). A package that cannot be loaded takes nothing from the
others: it is kept aside with the reason, which whoever asks for its sensor reads.

``sensor_family`` is the one place that says what the name of a sensor means: a family of the
catalogue, or a profile, whose sensor then has the parameters of its family with the profile's
values, or the profile's own gel where that was imported.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import TYPE_CHECKING

from taccel_lab.errors import InputError
from taccel_lab.guards import unknown
from taccel_lab.sensors.base import FamilyParameters, SensorFamily
from taccel_lab.sensors.profile_family import ProfileFamily, like_name, profile_family

if TYPE_CHECKING:
    from taccel_lab.profile import SensorBlock, SensorProfile
    from taccel_lab.profile.schema import ParameterVerdict

ENTRY_POINT_GROUP = "taccel_lab.sensors"

_PROFILE_FILE = "profile.toml"
_BUILT_IN = (
    "digit",
    "digit_360",
    "flat_pad",
    "gelsight",
    "gelsight_40",
    "gelsight_mini",
    "gelsight_r15",
    "gelsight_wedge",
    "9dtact",
    "rtac",
    "stereo_pad",
)
"""Families with a module in ``families``."""
_MODULES = {"9dtact": "ninedtact"}
"""Modules that are not called as their family: no module's name begins with a digit."""


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
    """Families by name, sorted."""
    broken: dict[str, BrokenFamily]
    """Faults by name of the entry point, sorted."""


def catalogue() -> Catalogue:
    """Load the built-in families and those of installed packages."""
    families = {name: _built_in(name) for name in _BUILT_IN}
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


def _built_in(name: str) -> SensorFamily:
    return import_module(f"taccel_lab.sensors.families.{_MODULES.get(name, name)}").FAMILY


def sensor_families() -> dict[str, SensorFamily]:
    """All families that could be loaded, by name, sorted."""
    return catalogue().families


def catalogue_family(name: str) -> SensorFamily | None:
    """The family of the catalogue that is called ``name``; None where none is."""
    # To load one family takes a third of the time of all.
    return _built_in(name) if name in _BUILT_IN else sensor_families().get(name)


def sensor_family(name: str) -> SensorFamily:
    """The sensor called ``name``: a family of the catalogue, or that of a profile (see
    ``profile_folder``).

    Raises:
        InputError: Unknown, with the known names; or its package or profile cannot be loaded, with
            the reason.
    """
    if (family := catalogue_family(name)) is not None:
        return family
    known = catalogue()
    if name in known.broken:
        found = known.broken[name]
        raise InputError(f"the sensor {name} of the package {found.package}: {found.reason}")
    folder = profile_folder(name)
    if folder is not None:
        return _of_folder(folder, _changed_ns(str(folder / _PROFILE_FILE)))
    also = "; flat_pad stands for any flat gel" if "flat_pad" in known.families else ""
    raise InputError(
        f"no sensor {name!r}{unknown(name, known.families, 'taccel-lab sensors list')}"
        f"{also}; the folder of a profile (taccel-lab import-gel, taccel-lab design) is a sensor, "
        "too"
    )


def known_sensor(name: str) -> SensorFamily | None:
    """Finds as ``sensor_family``; None where nothing is called so."""
    if catalogue_family(name) is None and profile_folder(name) is None:
        return None
    return sensor_family(name)


def profile_folder(name: Path | str) -> Path | None:
    """The folder of the profile that ``name`` means, absolute: the folder itself, its profile.toml,
    or an output folder with a profile in it; None where there is none, or where it is the name of a
    family of the catalogue (``./gelsight`` is a folder of that name)."""
    if catalogue_family(str(name)) is not None:
        return None
    path = Path(os.path.abspath(name))
    if path.name == _PROFILE_FILE:
        path = path.parent
    for folder in (path, path / "profile"):
        if (folder / _PROFILE_FILE).is_file():
            return folder
    return None


@lru_cache(maxsize=4)
def profile_sensor(profile: SensorProfile, name: str = "") -> ProfileFamily:
    """The sensor of a profile; ``name`` is that of the profile when empty.

    Raises:
        InputError: Its family is not in the catalogue.
    """
    like = sensor_family(like_name(profile.sensor))
    return profile_family(profile, name or profile.sensor.name, like)


@lru_cache(maxsize=4)
def profile_parameters(profile: SensorProfile) -> FamilyParameters:
    """What the sensor of a profile is made of; raises InputError as ``profile_sensor``."""
    return profile_sensor(profile).parameters()


def judge_parameters(sensor: SensorBlock) -> ParameterVerdict:
    """What the bounds of its family refuse of a profile's parameters; nothing of parameters that
    the family no longer has. A family that is not here, as one of a package that is not installed
    or cannot be loaded, judges nothing: the profile's gel and networks are of use without it."""
    from taccel_lab.profile.schema import ParameterVerdict

    try:
        name = like_name(sensor)
    except InputError:  # An imported gel of a version that did not keep it.
        return ParameterVerdict()
    like = catalogue_family(name)
    if like is None:
        broken = catalogue().broken.get(name)
        why = "is not in the catalogue here" if broken is None else f"is broken: {broken.reason}"
        return ParameterVerdict(unjudged=f"sensor.family: {name} {why}; parameters are not judged")
    specs = like.parameters_type.parameters()
    faults = []
    for key, value in sensor.parameters.items():
        try:
            if key in specs:
                specs[key].check(value)
        except InputError as fault:
            faults.append(f"sensor.parameters.{fault}")
    return ParameterVerdict(tuple(faults))


def is_of_sensor(profile: SensorProfile, name: str) -> bool:
    """Whether ``profile`` is of the sensor called ``name``: of that family, or of that very gel."""
    folder = profile_folder(name)
    if folder is None:
        return profile.sensor.family == name
    other = _of_folder(folder, _changed_ns(str(folder / _PROFILE_FILE)))
    return profile_sensor(profile).identity == other.identity


@lru_cache(maxsize=16)
def _of_folder(folder: Path, changed_ns: int) -> ProfileFamily:
    """Read once for the many that ask for it."""
    from taccel_lab.profile import load_profile

    return profile_sensor(load_profile(folder), str(folder))


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
