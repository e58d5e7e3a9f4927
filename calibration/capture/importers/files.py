# SPDX-License-Identifier: Apache-2.0
"""Finding images in folders that follow no manifest, and reading what lies beside them.

Every file of a source is imported, read, or told with the reason why it is not.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from taccel_lab.calibration.capture.schema import MANIFEST_NAME
from taccel_lab.calibration.capture.suffixes import is_picture
from taccel_lab.errors import InputError
from taccel_lab.files.arrays import finite_numbers, read_npz
from taccel_lab.files.documents import number_at, read_json, read_yaml
from taccel_lab.files.inner_path import inner_path
from taccel_lab.files.table_file import Row, read_table


def natural_key(path: Path | str) -> list[tuple[int, int, str]]:
    """Sort key under which ``frame_2`` comes before ``frame_10``."""
    # ASCII's alone: there are other characters that `isdigit`, but not `int`, takes for digits.
    parts = re.split(r"([0-9]+)", str(path))
    return [
        (0, int(part), "") if index % 2 else (1, 0, part.lower())
        for index, part in enumerate(parts)
    ]


def images_in(folder: Path, *patterns: str) -> list[Path]:
    """Image files below a folder that match one of the glob patterns (default: those in it), in
    natural order, those of the first pattern first.

    Hidden ones, and for ``**`` those of capture folders below, are left out.
    """
    found: dict[Path, None] = {}
    for pattern in patterns or ("*",):
        written = capture_folders(folder) if "**" in pattern else frozenset()
        matching = (
            path
            for path in folder.glob(pattern)
            if is_picture(path)
            and path.is_file()
            and path.name[0] != "."
            and written.isdisjoint(path.parents)
        )
        found |= dict.fromkeys(sorted(matching, key=lambda p: natural_key(p.relative_to(folder))))
    return list(found)


def first_existing(*paths: Path) -> Path | None:
    """The first of these files that exists."""
    return next((path for path in paths if path.is_file()), None)


def stated_number(path: Path, key: str) -> float:
    """The positive number under a dotted key of a JSON or YAML file.

    Raises InputError with file and key where there is no such number.
    """
    values = read_json(path) if path.suffix.lower() == ".json" else read_yaml(path)
    value = number_at(values, key, str(path))
    if value <= 0:
        raise InputError(f"{path}: {key} is {value:g}; a positive number is needed")
    return value


def label_numbers(path: Path, words: Sequence[str], keys: Sequence[str]) -> dict[str, float]:
    """Numbers by ``keys``, those of the arrays ``words`` of a ``.npz``, one after the other.

    Raises InputError where an array is missing, has something else than finite numbers, or where
    they are not as many as the keys.
    """
    arrays = read_npz(path)
    lacking = [word for word in words if word not in arrays]
    if lacking:
        raise InputError(f"{path} lacks {' and '.join(lacking)}")
    numbers = [float(n) for word in words for n in finite_numbers(arrays, word, path).ravel()]
    if len(numbers) != len(keys):
        raise InputError(
            f"{path}: {' and '.join(words)}: {len(keys)} in all are needed ({', '.join(keys)}), "
            f"found {len(numbers)} numbers"
        )
    return dict(zip(keys, numbers, strict=True))


@dataclass(frozen=True)
class PressRow:
    """A row of a table of presses."""

    image: Path
    row: Row

    def first(self, *columns: str) -> float | None:
        """The number of the first column that there is; None where there is none, or no value."""
        column = self.row.table.column(*columns)
        empty = column is None or not self.row.text(column)
        return None if column is None or empty else self.row.number(column)

    def together(self, *columns: str) -> list[float] | None:
        """The numbers of all columns, None where none has any; InputError where some have."""
        found = {column: self.first(column) for column in columns}
        lacking = [column for column, value in found.items() if value is None]
        if 0 < len(lacking) < len(found):
            raise self.row.error(f"lacks {' and '.join(lacking)}")
        return None if lacking else [value for value in found.values() if value is not None]


def press_rows(table: Path, folder: Path, image: str) -> Iterator[PressRow]:
    """Rows of a table whose column ``image`` names images of ``folder``.

    Raises InputError without that column, and for an image that is not there.
    """
    rows = read_table(table)
    column = rows.require_column(image)
    for row in rows.rows():
        path = inner_path(folder, row.text(column))
        if not path.is_file():
            raise row.error(f"{path} does not exist")
        yield PressRow(path, row)


MAX_SHOWN = 8
"""Names, or patterns of names, that a sentence lists."""
MAX_REASONS = 20


def capture_folders(folder: Path) -> frozenset[Path]:
    """Folders below this one that are capture folders already: what an import has written."""
    return frozenset(path.parent for path in folder.rglob(MANIFEST_NAME)) - {folder}


def files_of(source: Path) -> Iterator[Path]:
    """Files of a folder and of those below it, without hidden ones; none of a single file."""
    if not source.is_dir():
        return
    for path in sorted(source.rglob("*")):
        hidden = any(part[0] == "." for part in path.relative_to(source).parts)
        if path.is_file() and not hidden:
            yield path


def left_out_sentences(left_out: Mapping[Path, str], root: Path) -> list[str]:
    """One sentence a reason: how many files, their names, and why; most files first."""
    by_reason: dict[str, list[Path]] = {}
    for path, why in left_out.items():
        by_reason.setdefault(why, []).append(path)
    ordered = sorted(by_reason.items(), key=lambda item: -len(item[1]))
    sentences = [
        f"left out, {len(paths)} file{'s' if paths[1:] else ''} ({_named(paths, root)}): {why}"
        for why, paths in ordered[:MAX_REASONS]
    ]
    if rest := ordered[MAX_REASONS:]:
        count = sum(len(paths) for _, paths in rest)
        sentences.append(f"left out, {count} more files for {len(rest)} more reasons")
    return sentences


def _named(paths: Iterable[Path], root: Path) -> str:
    """Their paths below ``root``, those that differ in numbers alone as ``frame_<n>.png, 12 x``."""
    names = [path.relative_to(root).as_posix() if root in path.parents else str(path)
             for path in paths]  # fmt: skip
    patterns = Counter(re.sub(r"[0-9]+", "<n>", name) for name in names)
    shown = [
        f"{pattern}, {count} x"
        if count > 1
        else next(name for name in names if re.sub(r"[0-9]+", "<n>", name) == pattern)
        for pattern, count in patterns.most_common(MAX_SHOWN)
    ]
    more = sum(count for _, count in patterns.most_common()[MAX_SHOWN:])
    return "; ".join(shown) + (f"; and {more} more" if more else "")
