# SPDX-License-Identifier: Apache-2.0
"""py3DCal: ``annotations``, ``probe_images`` and ``blank_images`` of a 3D printer's probing.

``annotations.csv`` names each image with the probe's centre in px, ``metadata.json`` holds
``px_per_mm`` and ``probe_radius_mm``; the rims of the contacts are not labelled.
"""

from __future__ import annotations

from pathlib import Path

from taccel_lab.calibration.capture.importers.draft import Draft, ImportOptions
from taccel_lab.calibration.capture.importers.files import first_existing
from taccel_lab.calibration.capture.importers.layout import Layout
from taccel_lab.errors import InputError
from taccel_lab.inner_path import inner_path
from taccel_lab.reading.json_file import read_json
from taccel_lab.reading.plain_values import number_at
from taccel_lab.reading.table_file import read_table

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
        values = read_json(metadata)
        px_per_mm = number_at(values, "px_per_mm", str(metadata))
        if px_per_mm <= 0:
            raise InputError(f"{metadata}: px_per_mm is {px_per_mm:g}; a positive number is needed")
        draft.set_scale(1 / px_per_mm)
        draft.set_ball(number_at(values, "probe_radius_mm", str(metadata)))
    table = read_table(_tables(path)[0])
    name, depth = table.require_column("img_name"), table.column(*_DEPTH_COLUMNS)
    for row in table.rows():
        image = inner_path(path / "probe_images", row.text(name))
        if not image.is_file():
            raise row.error(f"{image} does not exist")
        travel = None if depth is None or not row.text(depth) else row.number(depth)
        draft.add_press(image, depth_mm=travel)
    draft.notes.append("the travel of the probe is kept; circles are found in the images")
    return [draft]


LAYOUT = Layout("py3dcal", "py3DCal: annotations, probe_images, blank_images", _recognises, _read)
