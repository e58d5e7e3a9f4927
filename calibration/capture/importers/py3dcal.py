# SPDX-License-Identifier: Apache-2.0
"""py3DCal: ``annotations``, ``probe_images`` and ``blank_images`` of a 3D printer's probing.

``annotations.csv`` names each image with the probe's centre in px, ``metadata.json`` holds
``px_per_mm`` and ``probe_radius_mm``; the rims of the contacts are not labelled.
"""

from __future__ import annotations

import csv
import json
from pathlib import Path

from taccel_lab.calibration.capture.importers.draft import Draft, ImportOptions
from taccel_lab.calibration.capture.importers.files import first_existing
from taccel_lab.calibration.capture.importers.layout import Layout
from taccel_lab.errors import InputError

SOURCE = "py3DCal layout (rohankotanu/py3DCal)"
_DEPTH_COLUMNS = ("penetration_depth_mm", "penetration_mm", "depth_mm")


def _tables(path: Path) -> list[Path]:
    places = [path / "annotations" / n for n in ("annotations.csv", "probe_data.csv")]
    return [place for place in places if place.is_file()]


def _recognises(path: Path) -> bool:
    return (path / "probe_images").is_dir() and bool(_tables(path))


def _read(path: Path, options: ImportOptions) -> list[Draft]:
    draft = Draft("", "digit" if "digit" in str(path).lower() else "gelsight_mini", SOURCE)
    blank = first_existing(path / "blank_images" / "blank.png", path / "blank_images" / "blank.jpg")
    if blank is not None:
        draft.set_background(blank)
    metadata = path / "annotations" / "metadata.json"
    if metadata.is_file():
        try:
            values = json.loads(metadata.read_text(encoding="utf-8"))
            draft.set_scale(1 / float(values["px_per_mm"]))
            draft.set_ball(float(values["probe_radius_mm"]))
        except (ValueError, KeyError, TypeError, ZeroDivisionError) as error:
            raise InputError(
                f"{metadata}: px_per_mm and probe_radius_mm cannot be read: {error}"
            ) from error
    table = _tables(path)[0]
    rows = list(csv.DictReader(table.read_text(encoding="utf-8").splitlines()))
    if not rows or "img_name" not in rows[0]:
        raise InputError(f"{table} needs rows with a column img_name")
    depth = next((name for name in _DEPTH_COLUMNS if name in rows[0]), None)
    for row in rows:
        image = path / "probe_images" / row["img_name"]
        if not image.is_file():
            raise InputError(f"{image} does not exist; {table} names it")
        draft.add_press(image, depth_mm=_travel(table, row, depth))
    draft.notes.append("the travel of the probe is kept; circles are found in the images")
    return [draft]


def _travel(table: Path, row: dict[str, str], column: str | None) -> float | None:
    if column is None or not row[column]:
        return None
    try:
        return float(row[column])
    except ValueError as error:
        raise InputError(f"{table}: {column} {row[column]!r} is not a number") from error


LAYOUT = Layout("py3dcal", "py3DCal: annotations, probe_images, blank_images", _recognises, _read)
