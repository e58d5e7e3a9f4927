# SPDX-License-Identifier: Apache-2.0
"""A calibration as a script holds it: its profile presses, reads and renders."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taccel_lab.api.sensor import Sensor
from taccel_lab.calibration import calibrate as fitting
from taccel_lab.typed import typed

if TYPE_CHECKING:
    from taccel_lab.calibration.capture.folder import CaptureFolder
    from taccel_lab.profile import SensorProfile
    from taccel_lab.progress import Progress


@dataclass(frozen=True, repr=False, eq=False)
class Calibration(fitting.Calibration):
    """A calibration whose profile presses, reads and renders."""

    profile: Sensor


@typed
def calibrate(
    folder: CaptureFolder | Path | str,
    base: SensorProfile | Path | str | None = None,
    only: str | Sequence[str] = (),
    options: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
    unfinished: Path | str | None = None,
) -> Calibration:
    """Fit every block that the captures allow.

    Args:
        folder: Captures, or the path of a capture folder.
        base: Profile to extend, its folder, or a sensor of the catalogue; that of the captures if
            None.
        only: Name of a block, or names of several; all when empty.
        options: Options of a block's fit by its name; its defaults where none are given.
        progress: Told of the tasks of each block, as ``color: fitting the colour model``. When
            None, bars are drawn where somebody watches.
        unfinished: Folder that keeps each block as it is finished. The same call goes on with what
            is there; ``UnfinishedCalibration.remove`` clears it away.

    Raises:
        InputError: An unknown block, files that cannot be read, a base of another sensor, or
            captures that calibrate nothing, with the reason for each block.
    """
    found = fitting.calibrate(folder, base, only, options, progress, unfinished)
    return Calibration(**{**vars(found), "profile": Sensor.of(found.profile)})
