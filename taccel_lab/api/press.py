# SPDX-License-Identifier: Apache-2.0
"""A rigid indenter pressed into the gel of a sensor: one call, everything that the sensor reads."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from taccel_lab.api.read import image_reader
from taccel_lab.presses.options import PressOptions
from taccel_lab.presses.run import PressRun, steps_if_watched
from taccel_lab.sensors.any_sensor import AnySensor
from taccel_lab.typed import typed

if TYPE_CHECKING:
    from taccel_lab.presses.force_search import StepProgress
    from taccel_lab.presses.press import Press
    from taccel_lab.profile import SensorProfile
    from taccel_lab.reading.reader import Reader


@typed
def press(
    sensor: AnySensor,
    indenter: str | Path = PressOptions.indenter,
    *,
    progress: StepProgress | None = None,
    **options: Any,
) -> Press:
    """Press an indenter into a sensor's gel.

    Args:
        sensor: A profile, the folder of one, a sensor of the catalogue, or a calibration.
        indenter: Its shape, such as ``"sphere:4"``, see ``PressOptions.indenter``; or the path of
            a mesh.
        progress: Receives step, step count and what each step gave. When None, a bar is drawn where
            somebody watches.
        options: Fields of ``PressOptions``: ``depth_mm`` or ``force_n`` is needed.

    Raises:
        InputError: A sensor, shape, place, depth or setting that cannot be used.
        SimulationError: A step did not converge; ``PressRun.run`` hands over those before it.
    """
    run = planned_press(sensor, PressOptions.of(indenter=indenter, **options))
    with steps_if_watched(progress, f"pressing {indenter} {run.options.aim()}") as on_step:
        return run.run(on_step)


def planned_press(sensor: AnySensor, options: PressOptions) -> PressRun:
    """A press that is checked but for what only its mesh shows; the photo of one that is like a
    photo is read. Errors as of ``press``."""
    return PressRun.plan(sensor, options, photo_reader)


def photo_reader(profile: SensorProfile, photo: Path, untouched: Path | None) -> Reader:
    """The reader of a photo; with a starter profile its untouched image is looked for beside it."""
    return image_reader(profile, [photo], untouched, option="--untouched")
