# SPDX-License-Identifier: Apache-2.0
"""What counts as a sensor."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from taccel_lab.errors import InputError
from taccel_lab.guards import unknown
from taccel_lab.profile import SensorProfile


@runtime_checkable
class HasProfile(Protocol):
    """What a profile came out of, such as a calibration."""

    @property
    def profile(self) -> SensorProfile: ...


AnySensor = SensorProfile | HasProfile | Path | str
"""A profile, what has one, the folder of one, a gel's file, or a sensor of the catalogue."""


def profile_of(sensor: AnySensor) -> SensorProfile:
    """The profile of whatever stands for a sensor, a catalogue name for its design without a
    starter; errors as of ``load_sensor``."""
    from taccel_lab.sensors.profile import load_sensor

    if not isinstance(sensor, (Path, str)):
        return sensor if isinstance(sensor, SensorProfile) else sensor.profile
    return _of_gel(Path(sensor), {}) if is_gel_file(sensor) else load_sensor(str(sensor))


def reading_profile_of(sensor: AnySensor) -> SensorProfile:
    """Profile as of ``profile_of``, for who reads images: a catalogue name stands for its
    starter."""
    from taccel_lab.sensors.profile import stock_sensor

    if isinstance(sensor, (Path, str)) and not is_gel_file(sensor):
        return stock_sensor(str(sensor))
    return profile_of(sensor)


def changed_profile(sensor: AnySensor, parameters: Mapping[str, Any]) -> SensorProfile:
    """A design with other parameters, as of ``load_sensor``."""
    from taccel_lab.sensors.profile import catalogue_profile
    from taccel_lab.sensors.registry import catalogue_family, sensor_families

    if isinstance(sensor, (Path, str)):
        if is_gel_file(sensor):
            return _of_gel(Path(sensor), parameters)
        if catalogue_family(str(sensor)) is not None:
            return catalogue_profile(str(sensor), parameters)
    name = sensor if isinstance(sensor, (Path, str)) else profile_of(sensor).sensor.name
    known = unknown(str(name), sensor_families(), "taccel-lab sensors list")
    raise InputError(
        f"{', '.join(parameters)}: only sensors of the catalogue and files of a gel are changed by "
        f"parameters, and {name} is a profile or unknown{known}"
    )


def is_gel_file(name: Path | str) -> bool:
    """Whether a name is that of a file that a gel is read from, rather than of a folder."""
    from taccel_lab.cad.gel_import import SUFFIXES

    return Path(name).suffix.lower() in SUFFIXES and not Path(name).is_dir()


def _of_gel(path: Path, options: Mapping[str, Any]) -> SensorProfile:
    """The sensor of a gel's file; options that select no faces are parameters of what it is
    ``like``."""
    from taccel_lab.cad.gel_import import FaceSelection
    from taccel_lab.sensors.imported import imported_sensor
    from taccel_lab.sensors.registry import sensor_family

    left = dict(options)
    edge_mm, like = left.pop("edge_mm", None), left.pop("like", "flat_pad")
    faces = {name: left.pop(name) for name in FaceSelection.model_fields if name in left}
    parameters = sensor_family(like).parameters_type.parameters()
    for name in left:
        if name not in parameters:
            known = (*FaceSelection.model_fields, "edge_mm", "like", *parameters)
            more = unknown(name, known, f"taccel-lab import-gel --help and sensors show {like}")
            raise InputError(f"{path} takes no option {name!r}{more}")
    return imported_sensor(path, FaceSelection(**faces), edge_mm, like=like, overrides=left)
