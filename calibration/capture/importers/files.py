# SPDX-License-Identifier: Apache-2.0
"""Finding images in folders that follow no manifest."""

from __future__ import annotations

from pathlib import Path

from taccel_lab.calibration.capture.importers.left_out import capture_folders
from taccel_lab.calibration.capture.importers.path_pattern import natural_key
from taccel_lab.calibration.capture.suffixes import is_picture


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
