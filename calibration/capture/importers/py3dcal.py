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
from taccel_lab.inner_path import inner_path, real_path
from taccel_lab.reading.json_file import read_json
from taccel_lab.reading.plain_values import number_at
from taccel_lab.reading.table_file import read_table

_DEPTH_COLUMNS = ("penetration_depth_mm", "penetration_mm", "depth_mm")


def _tables(path: Path) -> list[Path]:
    places = [path / "annotations" / n for n in ("annotations.csv", "probe_data.csv")]
    return [place for place in places if place.is_file()]


def _recognises(path: Path) -> bool:
    return (path / "probe_images").is_dir() and bool(_tables(path))


def _read(path: Path, options: ImportOptions) -> list[Draft]:
    is_digit = "digit" in "/".join(real_path(path).parts[-3:]).lower()
    draft = Draft("", "digit" if is_digit else "gelsight_mini", path)
    draft.assume(
        "sensor",
        "digit, by the folder's path"
        if is_digit
        else "gelsight_mini, since the folder's path does not say digit; --sensor names another",
    )
    blank = first_existing(path / "blank_images" / "blank.png", path / "blank_images" / "blank.jpg")
    if blank is not None:
        draft.set_background(blank, f"{blank.name}, by its name")
    elif options.background is None:
        draft.notes.append(
            "no background: blank_images/blank.png is missing; --background gives one"
        )
    _read_metadata(path / "annotations" / "metadata.json", draft, options)
    tables = _tables(path)
    draft.used.add(tables[0])
    if tables[1:]:
        draft.leave_out(tables[1], f"{tables[0].name} is read instead")
    table = read_table(tables[0])
    name, depth = table.require_column("img_name"), table.column(*_DEPTH_COLUMNS)
    for row in table.rows():
        image = inner_path(path / "probe_images", row.text(name))
        if not image.is_file():
            raise row.error(f"{image} does not exist")
        travel = None if depth is None or not row.text(depth) else row.number(depth)
        draft.add_press(image, depth_mm=travel)
    draft.notes.append("the travel of the probe is kept; circles are found in the images")
    return [draft]


def _read_metadata(metadata: Path, draft: Draft, options: ImportOptions) -> None:
    """Scale and ball, where options do not state them."""
    asked = {"--mm-per-px-x": options.mm_per_px_x, "--radius-mm": options.radius_mm}
    missing = [flag for flag, value in asked.items() if value is None]
    if not missing:
        return
    if not metadata.is_file():
        draft.notes.append(
            f"annotations/{metadata.name} is missing; {' and '.join(missing)} give what it states"
        )
        return
    values = read_json(metadata)
    draft.used.add(metadata)
    if options.mm_per_px_x is None:
        px_per_mm = number_at(values, "px_per_mm", str(metadata))
        if px_per_mm <= 0:
            raise InputError(f"{metadata}: px_per_mm is {px_per_mm:g}; a positive number is needed")
        draft.set_scale(1 / px_per_mm)
    if options.radius_mm is None:
        draft.set_ball(number_at(values, "probe_radius_mm", str(metadata)))


LAYOUT = Layout("py3dcal", "py3DCal: annotations, probe_images, blank_images", _recognises, _read)
