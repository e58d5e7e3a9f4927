# SPDX-License-Identifier: Apache-2.0
"""Tasks that can be learned, by name, as vector environments."""

from __future__ import annotations

import math
from numbers import Integral
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from taccel_lab.errors import InputError
from taccel_lab.files.documents import read_toml
from taccel_lab.guards import require_known, require_range
from taccel_lab.learning.grasp_lift import GraspLiftLearning
from taccel_lab.learning.peg_insertion import PegInsertionLearning
from taccel_lab.learning.task import LearningTask
from taccel_lab.learning.vector_env import TactileVectorEnv
from taccel_lab.registration import FILES, KINDS, names

if TYPE_CHECKING:
    from taccel_lab.profile import SensorProfile
    from taccel_lab.tasks.catalogue import Task

_CLASSES: tuple[type[LearningTask], ...] = (GraspLiftLearning, PegInsertionLearning)
"""The class of each of ``KINDS``."""


def make_vec(
    task: str | Task,
    num_envs: int,
    sensor: SensorProfile | Path | str | None = None,
    **options: Any,
) -> TactileVectorEnv:
    """Environments of a task.

    Args:
        task: Of the package by its name, or one that was read from a file
            (``tasks.catalogue.read_task``).
        num_envs: How many.
        sensor: Whose gels stand in place of the task's; pixels see what its camera does. A profile,
            the folder of one, or a sensor of the catalogue by its name.
        options: Of ``TactileVectorEnv``.

    Raises:
        InputError: A task that cannot be learned, or a sensor that it does not take.
    """
    if isinstance(num_envs, bool) or not isinstance(num_envs, Integral):
        raise InputError(f"num_envs must be a whole number, got {num_envs!r}")
    require_range("num_envs", int(num_envs), 1, math.inf)
    if isinstance(task, str):
        require_known("task to be learned", task, names())
        # Tests check the package's files by their models, which need pydantic; a machine that
        # learns may have none.
        parameters = _values(read_toml(FILES / f"{task}.toml"))
    else:
        parameters = task.parameters
    if parameters.kind not in KINDS:
        raise InputError(f"tasks of kind {parameters.kind!r} cannot be learned: {', '.join(KINDS)}")
    profile = None if sensor is None else _profile(sensor)
    learned = dict(zip(KINDS, _CLASSES, strict=True))[parameters.kind]
    return TactileVectorEnv(learned(parameters, int(num_envs), profile), **options)


def _profile(sensor: SensorProfile | Path | str) -> SensorProfile:
    # Profiles need pydantic, which a machine that learns may lack.
    from taccel_lab.profile import SensorProfile
    from taccel_lab.sensors.profile import stock_sensor

    if isinstance(sensor, (Path, str)):
        return stock_sensor(str(sensor))
    if not isinstance(sensor, SensorProfile):
        raise InputError(f"sensor is a profile, its folder or a name, got {sensor!r}")
    return sensor


def _values(table: Any) -> Any:
    """A table with its keys as attributes."""
    if isinstance(table, dict):
        return SimpleNamespace(**{key: _values(value) for key, value in table.items()})
    return tuple(map(_values, table)) if isinstance(table, list) else table
