# SPDX-License-Identifier: Apache-2.0
"""Whether a data set is what was written, and whether its columns say anything."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.datasets.folder import (
    ABOUT,
    PARTS,
    DatasetFolder,
    is_as_written,
    read_parquet,
)
from taccel_lab.datasets.part import ARRAYS, EPISODES, STEPS
from taccel_lab.datasets.reading import Dataset
from taccel_lab.datasets.sensor import profile_digest
from taccel_lab.errors import InputError
from taccel_lab.files.documents import read_json
from taccel_lab.files.file_cache import content_key
from taccel_lab.files.inner_path import inner_files
from taccel_lab.files.output_marker import OUTPUT_MARKER
from taccel_lab.files.regular_file import file_sha256
from taccel_lab.profile import Finding, load_profile
from taccel_lab.progress import Progress, silent
from taccel_lab.version import __version__

FORCE_TOLERANCE = 1e-5
"""Error of the sum of patch forces beside the force, as a part of the largest force."""
READ_ROWS = 256


def check_dataset(folders: Sequence[Path | str], progress: Progress = silent) -> list[Finding]:
    """Everything wrong (errors) or odd (warnings): files against their digests, empty, constant and
    NaN columns, forces that do not add up, episodes that are missing or stopped.

    Raises InputError where there is no data set.
    """
    found: list[Finding] = []
    for folder in map(DatasetFolder, folders):
        found += _check_sources(folder)
        found += _check_files(folder, progress)
    if _faulty(found):
        return found
    data = Dataset(list(folders))
    return found + _check_episodes(data) + _check_columns(data, progress)


def _faulty(found: Sequence[Finding]) -> bool:
    return any(finding.severity == "error" for finding in found)


def _check_sources(folder: DatasetFolder) -> list[Finding]:
    """What all parts share: the recipe, profiles and objects."""
    about, name = folder.about(), folder.root.name
    recipe = about["recipe"]
    found = []
    if content_key(recipe) != about["plan"]:
        found.append(Finding("error", f"{name}/{ABOUT}", "its recipe is not what was written"))
        return found
    for number, digest in enumerate(recipe["profiles"]):
        where = f"{name}/profiles/{number}"
        try:
            kept = profile_digest(load_profile(folder.root / "profiles" / str(number)))
        except (InputError, OSError) as error:
            found.append(Finding("error", where, f"cannot be read: {error}"))
            continue
        # Another version may have read it with keys of its own.
        if kept != digest and recipe["tool_version"] == __version__:
            found.append(Finding("error", where, "is not the profile that was used"))
    for number, digest in enumerate(recipe["objects"]):
        if digest:
            kept = list((folder.root / "objects").glob(f"{number}_*"))
            where = f"{name}/objects/{number}"
            if not kept:
                found.append(Finding("error", where, "is missing"))
            elif file_sha256(kept[0]) != digest:
                found.append(Finding("error", where, "is not what was written (SHA-256)"))
    return found


def _check_index(folder: DatasetFolder) -> list[Finding]:
    """The tables of all parts beside those of each, where they tell of the same parts."""
    faults = [_index_fault(folder, name) for name in (EPISODES, STEPS)]
    return [fault for fault in faults if fault]


def _index_fault(folder: DatasetFolder, name: str) -> Finding | None:
    path, where = folder.root / name, f"{folder.root.name}/{name}"
    if not path.is_file():
        return None
    there = {int(part.name) for part in folder.part_folders()}
    advice = "delete it, and the parts' own are read"
    wrong = Finding("error", where, f"is not what its parts say; {advice}")
    try:
        index = read_parquet(path)
        if set(index["part"].to_pylist()) != there:
            return None
        parts = folder.gathered(name)
    except (InputError, KeyError):
        return wrong
    if not _same(index, parts):
        return wrong
    if is_as_written(path, parts):
        return None
    # Limits and counts beside the rows, by which readers filter.
    text = f"says what its parts say, but is not the file that was written; {advice}"
    return Finding("warning", where, text)


def _same(one: Any, other: Any) -> bool:
    """Whether two tables say the same; NaN is what NaN is."""
    if one.schema != other.schema or len(one) != len(other):
        return False
    columns = zip(one.itercolumns(), other.itercolumns(), strict=True)
    pairs = [[column.to_numpy() for column in pair] for pair in columns]
    return all(np.array_equal(a, b, equal_nan=a.dtype.kind == "f") for a, b in pairs)


def _belongs(part: Path, plan: str) -> bool:
    """Whether a part is the one that its name says, of this data set."""
    attributes = read_json(part / ARRAYS / "zarr.json").get("attributes")
    said = attributes if isinstance(attributes, dict) else {}
    return (said.get("part"), said.get("plan")) == (int(part.name), plan)


def _check_files(folder: DatasetFolder, progress: Progress) -> list[Finding]:
    found: list[Finding] = []
    parts, plan = folder.part_folders(), folder.about()["plan"]
    for done, part in enumerate(parts):
        before = len(found)
        progress("digests", done, len(parts))
        where = f"{folder.root.name}/parts/{part.name}"
        try:
            there = {
                path.relative_to(part).as_posix()
                for path in inner_files(folder.root, f"{PARTS}/{part.name}")
                if path.name != OUTPUT_MARKER
            }
            marker = read_json(part / OUTPUT_MARKER)
            files = dict(marker["files"])
        except (InputError, OSError, KeyError, TypeError, ValueError) as error:
            found.append(Finding("error", where, f"its files cannot be listed: {error}"))
            continue
        for name in sorted(set(files) - there):
            found.append(Finding("error", f"{where}/{name}", "is missing"))
        for name in sorted(there - set(files)):
            found.append(Finding("warning", f"{where}/{name}", "was not written with the part"))
        for name in sorted(there & set(files)):
            with open(part / name, "rb") as file:
                if hashlib.file_digest(file, "sha256").hexdigest() != files[name]:
                    found.append(
                        Finding("error", f"{where}/{name}", "is not what was written (SHA-256)")
                    )
        if not _faulty(found[before:]) and not _belongs(part, plan):
            found.append(Finding("error", where, "is another part, or one of another data set"))
    return found if _faulty(found) else found + _check_index(folder)


def _check_episodes(data: Dataset) -> list[Finding]:
    found = []
    table = data.episode_table
    wanted = {about["plan"]: int(about["episodes"]) for about in data.about}
    for plan, count in wanted.items():
        those = [k for k, about in enumerate(data.about) if about["plan"] == plan]
        there = table["episode"][np.isin(table["folder"], those)]
        name = data.about[those[0]]["name"]
        if len(set(there.tolist())) < len(there):
            repeated = len(there) - len(set(there.tolist()))
            found.append(Finding("error", name, f"{repeated} episodes are there twice"))
        if len(set(there.tolist())) < count:
            missing = count - len(set(there.tolist()))
            found.append(
                Finding("warning", name, f"{missing} of {count} episodes are not made yet")
            )
    for status in ("stopped", "failed"):
        which = np.flatnonzero(table["status"] == status)
        if len(which):
            one = data.episodes[int(which[0])]
            message = f"{len(which)} of {len(table['episode'])} episodes {status}"
            found.append(
                Finding("warning", f"episode {one['episode']}", f"{message}; here: {one['cause']}")
            )
    return found


def _check_columns(data: Dataset, progress: Progress) -> list[Finding]:
    found: list[Finding] = []
    if len(data) == 0:
        return [Finding("error", "steps", "there is no step in the whole data set")]
    pressed = data.steps["step"] > 0
    for done, (name, about) in enumerate(data.channels.items()):
        progress("columns", done, len(data.channels))
        summary = _summary(data, name)
        if summary.nan and not about["may_be_nan"]:
            found.append(Finding("error", name, f"NaN or infinite in {summary.nan} steps"))
        if summary.size == 0 or summary.nan == len(data):
            found.append(Finding("error", name, "is empty: no value in any step"))
        elif summary.low == summary.high and name != "status" and len(data) > 1:
            text = f"is constant: {summary.low:g} everywhere"
            found.append(Finding("warning", name, text))
    if "patch_forces_n" in data.channels and pressed.any():
        total = data.read("wrench", slice(None))[:, :3]
        patches = np.concatenate([
            data.read("patch_forces_n", rows).sum(axis=(1, 2)) for rows in _blocks(len(data))
        ])  # fmt: skip
        off = np.abs(patches - total).max()
        if off > FORCE_TOLERANCE * np.abs(total).max():
            found.append(Finding("error", "patch_forces_n", f"do not add up: {off:.2g} N off"))
    return found


@dataclass(frozen=True)
class _Summary:
    low: float
    high: float
    nan: int
    """Steps with a value that is not finite."""
    size: int


def _blocks(count: int) -> list[np.ndarray]:
    return [np.arange(k, min(k + READ_ROWS, count)) for k in range(0, count, READ_ROWS)]


def _summary(data: Dataset, name: str) -> _Summary:
    low, high, nan, size = np.inf, -np.inf, 0, 0
    table = data.steps
    parts = np.stack([table["folder"], table["part"]], axis=1)
    for folder, part in np.unique(parts, axis=0).tolist():
        group = data.group(folder, part)
        with data.sound(folder, part):
            array = group[name]
            for first in range(0, array.shape[0], READ_ROWS):
                values = np.asarray(array[first : first + READ_ROWS])
                size += values.size
                finite = np.isfinite(values)
                nan += int((~finite.reshape(len(values), -1).all(axis=1)).sum())
                if finite.any():
                    low = min(low, float(values[finite].min()))
                    high = max(high, float(values[finite].max()))
    return _Summary(low, high, nan, size)
