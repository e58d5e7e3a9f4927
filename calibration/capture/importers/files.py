# SPDX-License-Identifier: Apache-2.0
"""Finding images and label tables in folders that follow no manifest."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from taccel_lab.calibration.capture.importers.draft import IMAGE_SUFFIXES
from taccel_lab.calibration.capture.records import kind_of_record
from taccel_lab.errors import InputError
from taccel_lab.reading.arrays import finite_numbers

_FILE_COLUMNS = ("file", "image", "img_name", "img_names", "filename", "name", "frame")
_U_COLUMNS = ("cx_px", "u_px", "cx", "center_x", "x_px", "x", "u")
_V_COLUMNS = ("cy_px", "v_px", "cy", "center_y", "y_px", "y", "v")
_RADIUS_COLUMNS = (
    "contact_r_px",
    "radius_px",
    "contact_r",
    "contact_radius",
    "r_px",
    "radius",
    "r",
)
_TUPLE_LINE = re.compile(
    r"^\s*(\S+\.\w+)\s*\(?\s*([-+.\d]+)\s*,\s*([-+.\d]+)\s*\)?\s*[,\s]\s*([-+.\d]+)\s*$"
)
"""``name.png (204, 98) 31``, as some labelling scripts print it."""


def natural_key(path: Path | str) -> list[tuple[int, int, str]]:
    """Sort key under which ``frame_2`` comes before ``frame_10``."""
    parts = re.split(r"(\d+)", str(path))
    return [(0, int(part), "") if part.isdigit() else (1, 0, part.lower()) for part in parts]


def images_in(folder: Path, *, recursive: bool = False) -> list[Path]:
    """Image files of a folder in natural order; hidden ones are left out."""
    paths = folder.rglob("*") if recursive else folder.iterdir()
    found = [
        path
        for path in paths
        if path.suffix.lower() in IMAGE_SUFFIXES and path.is_file() and path.name[0] != "."
    ]
    return sorted(found, key=lambda path: natural_key(path.relative_to(folder)))


def first_existing(*paths: Path) -> Path | None:
    """The first of these files that exists."""
    return next((path for path in paths if path.is_file()), None)


def sensor_image(folder: Path) -> Path:
    """The image of one press in the layouts of gs_sdk; InputError where it is missing."""
    image = first_existing(folder / "gelsight.png", folder / "digit.png")
    if image is None:
        raise InputError(f"{folder / 'gelsight.png'} does not exist")
    return image


def read_labels(path: Path) -> dict[str, dict[str, float]] | None:
    """Contact circles by image (as the table names it), or None when the file is no such table.

    A CSV with a header in any of the usual spellings, or lines of the form ``name (u, v) r``.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        # Any bytes are Latin-1: names of columns are ASCII, those of files are then compared.
        text = path.read_text(encoding="latin-1")
    except OSError:
        return None
    if "\0" in text:
        return None
    lines = [line for line in text.splitlines() if line.strip() and line.lstrip()[0] != "#"]
    found = [_TUPLE_LINE.match(line) for line in lines]
    if lines and all(found):
        return {
            match[1]: _circle(path, match[1], match[2], match[3], match[4])
            for match in found
            if match is not None
        }
    delimiter = max(",;\t", key=lines[0].count) if lines else ","
    if delimiter != ",":  # Spreadsheets of many countries write 3,5 for 3.5.
        lines = [line.replace(",", ".") for line in lines]
    rows = list(csv.DictReader(lines, delimiter=delimiter))
    if not rows:
        return None
    header = {(name or "").strip().lower(): name for name in rows[0] if name is not None}
    columns = [
        next((header[name] for name in names if name in header), None)
        for names in (_FILE_COLUMNS, _U_COLUMNS, _V_COLUMNS, _RADIUS_COLUMNS)
    ]
    if any(column is None for column in columns):
        return None
    file, u, v, radius = columns
    return {str(row[file]): _circle(path, row[file], row[u], row[v], row[radius]) for row in rows}


def _circle(path: Path, name: object, *cells: object) -> dict[str, float]:
    values = []
    for cell in cells:
        try:
            values.append(float(str(cell)))
        except ValueError:
            values.append(math.nan)
    if not all(map(math.isfinite, values)):
        raise InputError(f"{path}: the circle of {name} is {cells}; three finite numbers of pixels")
    return dict(zip(("u_px", "v_px", "radius_px"), values, strict=True))


def labels_of(folder: Path) -> dict[str, dict[str, float]]:
    """Circles of all label tables in a folder (and its ``labels``), by file name and by path."""
    circles: dict[str, dict[str, float]] = {}
    for place in (folder, folder / "labels"):
        if place.is_dir():
            for table in sorted([*place.glob("*.txt"), *place.glob("*.csv")]):
                circles |= read_labels(table) or {}
    return circles


def label_notes(
    folder: Path, circles: dict[str, dict[str, float]], images: Sequence[Path]
) -> list[str]:
    """What of the tables in a folder has no effect, in sentences."""
    notes = [
        f"{table.name} was not used: it has no columns for file, centre and radius of circles"
        for table in sorted(folder.glob("*.csv"))
        if read_labels(table) is None and kind_of_record(table) is None
    ]
    used = {image.name for image in images} | {image.stem for image in images}
    used |= {image.relative_to(folder).as_posix() for image in images}
    lost = sorted(name for name in circles if name not in used)
    if lost:
        shown = ", ".join(lost[:5]) + (f" and {len(lost) - 5} more" if len(lost) > 5 else "")
        notes.append(f"circles of images that are not there, or no presses: {shown}")
    return notes


def label_for(
    image: Path, root: Path, circles: dict[str, dict[str, float]]
) -> dict[str, float] | None:
    """The circle of an image, looked up by its path below ``root`` or by its file name."""
    relative = image.relative_to(root).as_posix() if image.is_relative_to(root) else image.name
    for key in (relative, image.name, image.stem):
        if key in circles:
            return circles[key]
    return None


def number_in(arrays: dict[str, np.ndarray], key: str, path: Path) -> float:
    """A single finite number of an archive."""
    values = finite_numbers(arrays, key, path)
    if values.size != 1:
        raise InputError(f"{path}: {key} has to be a single number, found {values.size}")
    return float(values.item())


def point_in(arrays: dict[str, np.ndarray], key: str, path: Path) -> tuple[float, float]:
    """Two finite numbers of an archive."""
    values = finite_numbers(arrays, key, path)
    if values.size != 2:
        raise InputError(f"{path}: {key} has to be two numbers (u, v), found {values.size}")
    u, v = (float(value) for value in values.ravel())
    return u, v


def load_yaml(path: Path) -> dict[str, object]:
    """A YAML file as a dictionary."""
    import yaml

    try:
        found = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise InputError(f"{path} is not valid YAML: {error}") from error
    if not isinstance(found, dict):
        raise InputError(f"{path} holds a {type(found).__name__}, a table of keys is needed")
    return found
