# SPDX-License-Identifier: Apache-2.0
"""What counts as a sensor."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

from taccel_lab.errors import InputError
from taccel_lab.profile import SensorProfile


class HasProfile(Protocol):
    """What a profile came out of, such as a calibration."""

    @property
    def profile(self) -> SensorProfile: ...


AnySensor = SensorProfile | HasProfile | Path | str
"""A profile, what has one, the folder of one, or a sensor of the catalogue."""


def load_sensor(
    name: Path | str, parameters: Mapping[str, Any] | None = None, **gel: Any
) -> SensorProfile:
    """Load the profile of a sensor.

    Args:
        name: A sensor of the catalogue, such as ``"gelsight_mini"``; the folder of a profile; or
            a file of a gel (STEP, STL, OBJ, 3MF, .msh, .vtu).
        parameters: Design parameters other than the catalogue's, such as
            ``{"thickness_mm": 3}``; with a file those of the sensor that it is ``like``.
        gel: With such a file, as of ``taccel-lab import-gel``: ``contact``, ``bond``, ``window``
            and the other fields of ``FaceSelection``, ``edge_mm`` and ``like``.

    Raises:
        InputError: No such sensor, a damaged profile, or options that cannot be used.
    """
    from taccel_lab.sensors.profile import catalogue_profile, stock_sensor
    from taccel_lab.sensors.registry import sensor_families

    if _is_gel(name):
        return _of_gel(Path(name), parameters, **gel)
    if gel:
        raise InputError(f"{', '.join(gel)} select faces of a gel's file; {name} is none")
    if not parameters:
        return stock_sensor(str(name))
    if str(name) not in sensor_families():
        raise InputError(
            f"parameters change a sensor of the catalogue; {name} is none "
            f"({', '.join(sorted(sensor_families()))})"
        )
    return catalogue_profile(str(name), parameters)


def _is_gel(name: Path | str) -> bool:
    """Whether a name is that of a file that a gel is read from, rather than of a folder."""
    from taccel_lab.cad.gel_import import SUFFIXES

    return Path(name).suffix.lower() in SUFFIXES and not Path(name).is_dir()


def _of_gel(
    path: Path,
    parameters: Mapping[str, Any] | None,
    edge_mm: float | None = None,
    like: str = "flat_pad",
    **faces: Any,
) -> SensorProfile:
    from taccel_lab.cad.gel_import import FaceSelection
    from taccel_lab.sensors.imported import imported_sensor

    unknown = sorted(set(faces) - set(FaceSelection.model_fields))
    if unknown:
        raise InputError(
            f"{', '.join(unknown)}: no option of such a file; there are "
            f"{', '.join([*FaceSelection.model_fields, 'edge_mm', 'like'])}"
        )
    selection = FaceSelection(**faces)
    return imported_sensor(path, selection, edge_mm, like=like, overrides=parameters)


def profile_of(sensor: AnySensor) -> SensorProfile:
    """The profile of whatever stands for a sensor, a catalogue name for its design without a
    starter; errors as of ``load_sensor``."""
    if isinstance(sensor, SensorProfile):
        return sensor
    if isinstance(sensor, (Path, str)):
        from taccel_lab.sensors.profile import load_sensor as load

        return load_sensor(sensor) if _is_gel(sensor) else load(str(sensor))
    return sensor.profile


def reading_profile_of(sensor: AnySensor) -> SensorProfile:
    """Profile as of ``profile_of``, for who reads images: a catalogue name stands for its
    starter."""
    return load_sensor(sensor) if isinstance(sensor, (Path, str)) else profile_of(sensor)
