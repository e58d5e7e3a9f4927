# SPDX-License-Identifier: Apache-2.0
"""Presses that a 3D printer made (``taccel-lab capture guide --printer``), one picture each."""

from __future__ import annotations

from pathlib import Path

from taccel_lab.calibration.capture.importers.draft import (
    FALLBACK_SENSOR,
    CaptureLayout,
    Draft,
    ImportOptions,
)
from taccel_lab.calibration.capture.importers.files import images_in, press_rows
from taccel_lab.calibration.capture.importers.label_tables import read_label_tables
from taccel_lab.calibration.capture.printer import COLUMNS, PRESSES_TABLE


def _recognises(path: Path) -> bool:
    return (path / PRESSES_TABLE).is_file()


def _read(path: Path, options: ImportOptions) -> list[Draft]:
    if not _recognises(path):
        return []
    table = path / PRESSES_TABLE
    draft = Draft("", FALLBACK_SENSOR, path)
    draft.assume_sensor()
    draft.used.add(table)
    background = draft.find_background(options, "background.png", "background.jpg")
    for image in images_in(path, "untouched_*"):
        if background not in (None, image):
            draft.add_untouched(image)
    image_column, x, y, depth, radius = COLUMNS
    rows = [row for row in press_rows(table, path, image_column) if row.image != background]
    labels = read_label_tables(path)
    images = [row.image for row in rows]
    circles = labels.of_images(images)
    for row in rows:
        draft.add_press(
            row.image,
            contact=circles.get(row.image),
            depth_mm=row.first(depth),
            stage_mm=row.together(x, y),
            radius_mm=row.first(radius),
        )
    for name in (x, y, depth, radius) if rows else ():
        if rows[0].row.table.column(name) is None:
            draft.notes.append(f"no press has its {name}: no column is called so")
    draft.tell_labels(labels, images)
    return [draft]


LAYOUT = CaptureLayout(
    "printer",
    "printer_presses.csv of capture guide --printer, with its images",
    _recognises,
    _read,
)
