# SPDX-License-Identifier: Apache-2.0
"""A small data set from a large one: whole parts, as they are, of all sensors and objects."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from taccel_lab.datasets.folder import ABOUT, PARTS, DatasetFolder
from taccel_lab.datasets.reading import Dataset
from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import write_json
from taccel_lab.files.inner_path import copy_inner, inner_files
from taccel_lab.files.output_folder import atomic_directory, require_replaceable

RESERVE_BYTES = 1_000_000
"""Kept for tables and other files of the parts."""


def make_lite(
    folders: Sequence[Path | str], out: Path | str, limit_bytes: int = 100_000_000
) -> int:
    """Copy parts of ``folders`` to ``out`` until the limit; returns the size in bytes.

    Sensors and objects take turns, so that all are in it where they fit. Parts are the same to the
    byte, so ``dataset check`` still knows them.

    Raises:
        InputError: Folders of different data sets, a limit below the smallest part, or links that
            lead out of a folder: what they name would be published with it.
    """
    require_replaceable(out)
    data = Dataset(folders)
    if len({about["plan"] for about in data.about}) > 1:
        raise InputError("these folders are of different data sets; make a lite one of each")
    chosen = _chosen(data, limit_bytes)
    about = data.about[0]
    table = data.episode_table
    with atomic_directory(out) as staging:
        lite = DatasetFolder(staging)
        source = data.folders[0].root
        for name in _shared(source):
            copy_inner(source, name, staging)
        episodes = 0
        for folder, part in chosen:
            copy_inner(data.folders[folder].root, f"{PARTS}/{part:06d}", staging)
            episodes += int(((table["folder"] == folder) & (table["part"] == part)).sum())
        lite.write_index()
        write_json(
            staging / ABOUT,
            {**about, "episodes": episodes, "parts": len(chosen), "lite_of": about["episodes"]},
        )
    return _size(Path(out))


def _chosen(data: Dataset, limit_bytes: int) -> list[tuple[int, int]]:
    """Folder and number of the parts that fit, groups taking turns."""
    table = data.episode_table
    groups: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for sensor, thing, folder, part in zip(
        table["sensor_index"], table["object_index"], table["folder"], table["part"], strict=True
    ):
        group = groups.setdefault((int(sensor), int(thing)), [])
        if (int(folder), int(part)) not in group:
            group.append((int(folder), int(part)))
    sizes = {
        key: _size(data.folders[key[0]].root, f"{PARTS}/{key[1]:06d}")
        for group in groups.values()
        for key in group
    }
    room = limit_bytes - RESERVE_BYTES
    source = data.folders[0].root
    room -= sum(_size(source, name) for name in (*_shared(source), ABOUT))
    chosen: list[tuple[int, int]] = []
    turn = 0
    while any(len(group) > turn for group in groups.values()):
        for group in groups.values():
            if len(group) > turn and sizes[group[turn]] <= room:
                chosen.append(group[turn])
                room -= sizes[group[turn]]
        turn += 1
    if not chosen:
        smallest = min(sizes.values())
        raise InputError(
            f"the smallest part takes {smallest / 1e6:.1f} MB, the limit is {limit_bytes / 1e6:.1f}"
            " MB, of which 1 MB is kept for tables"
        )
    return sorted(chosen)


def _shared(source: Path) -> list[str]:
    """What there is of all that parts share."""
    names = ("profiles", "objects", "spec.toml")
    return [name for name in names if os.path.lexists(source / name)]


def _size(folder: Path, name: str = "") -> int:
    return sum(file.stat().st_size for file in inner_files(folder, name))
