# SPDX-License-Identifier: Apache-2.0
"""Finding images in folders that follow no manifest, and what archives say of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from taccel_lab.calibration.capture.importers.draft import is_picture
from taccel_lab.calibration.capture.importers.left_out import capture_folders
from taccel_lab.calibration.capture.importers.path_pattern import natural_key
from taccel_lab.errors import InputError
from taccel_lab.files.arrays import finite_numbers


def images_in(folder: Path, *, recursive: bool = False) -> list[Path]:
    """Image files of a folder in natural order; hidden ones, and those of capture folders below it,
    are left out."""
    paths = folder.rglob("*") if recursive else folder.iterdir()
    written = capture_folders(folder) if recursive else frozenset()
    found = [
        path
        for path in paths
        if is_picture(path)
        and path.is_file()
        and path.name[0] != "."
        and written.isdisjoint(path.parents)
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
