# SPDX-License-Identifier: Apache-2.0
"""A live reading that somebody wants to keep."""

from __future__ import annotations

import re
from pathlib import Path

from taccel_lab.calibration.capture.importers.draft import write_png
from taccel_lab.calibration.live.reader import LiveReader, LiveReading
from taccel_lab.calibration.pressure.reading_files import write_reading
from taccel_lab.calibration.pressure.touch import TouchReading

_SNAPSHOT = re.compile(r"snapshot_(\d+)_image\.png")


def save_snapshot(reading: LiveReading, reader: LiveReader, folder: Path) -> Path:
    """Write ``snapshot_N_image.png``, and the files of ``taccel-lab depth`` where the depth is not
    refused; returns the image's path. Nothing is overwritten: N is the next that is free."""
    folder.mkdir(parents=True, exist_ok=True)
    taken = [int(found[1]) for p in folder.iterdir() if (found := _SNAPSHOT.fullmatch(p.name))]
    stem = f"snapshot_{max(taken, default=-1) + 1:03d}"
    path = folder / f"{stem}_image.png"
    write_png(path, reading.image)
    if reading.surface is not None and not reading.refused:
        touch = TouchReading(
            **vars(reading.surface),
            grid=reader.grid,
            press=reading.press,
            no_press=reader.no_pressure,
        )
        write_reading(touch, reading.image, path, folder, stem)
    return path
