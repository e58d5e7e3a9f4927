# SPDX-License-Identifier: Apache-2.0
"""Finding images in folders that follow no manifest, and reading what lies beside them: tables, and
where captures come from under which licence.

Every file of a source is imported, read, or told with the reason why it is not.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from taccel_lab.calibration.capture.camera.recording import is_picture, natural_key
from taccel_lab.calibration.capture.schema import MANIFEST_NAME
from taccel_lab.errors import InputError
from taccel_lab.files.arrays import finite_numbers, read_npz
from taccel_lab.files.documents import number_at, read_json, read_yaml
from taccel_lab.files.inner_path import inner_path, real_path
from taccel_lab.files.regular_file import read_text
from taccel_lab.files.table_file import Row, read_table
from taccel_lab.printable import printable


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


UNKNOWN = "unknown"
_LIMIT_BYTES = 1 << 20
_QUOTED = 120
"""Characters of a README that are quoted."""
_LICENSE_FILE = re.compile(r"(licen[sc]e|copying)([-_.].*)?", re.IGNORECASE)
_ABOUT_FILE = re.compile(r"(readme|manifest)(\.(md|txt|rst))?", re.IGNORECASE)
_KNOWN = (
    ("CC-BY-NC-SA-4.0", r"Attribution[- ]NonCommercial[- ]ShareAlike 4\.0"),
    ("CC-BY-NC-ND-4.0", r"Attribution[- ]NonCommercial[- ]NoDerivatives 4\.0"),
    ("CC-BY-NC-4.0", r"Attribution[- ]NonCommercial 4\.0"),
    ("CC-BY-SA-4.0", r"Attribution[- ]ShareAlike 4\.0"),
    ("CC-BY-4.0", r"Attribution 4\.0"),
    ("CC0-1.0", r"CC0 1\.0"),
    ("AGPL-3.0", r"GNU AFFERO GENERAL PUBLIC LICENSE\s+Version 3"),
    ("LGPL-3.0", r"GNU LESSER GENERAL PUBLIC LICENSE\s+Version 3"),
    ("GPL-3.0", r"GNU GENERAL PUBLIC LICENSE\s+Version 3"),
    ("GPL-2.0", r"GNU GENERAL PUBLIC LICENSE\s+Version 2"),
    ("Apache-2.0", r"Apache License\s+Version 2\.0"),
    ("MPL-2.0", r"Mozilla Public License,?\s+Version 2\.0"),
    ("BSD-3-Clause", r"Redistribution and use in source and binary forms[\s\S]*Neither the name"),
    ("BSD-2-Clause", r"Redistribution and use in source and binary forms"),
    ("MIT", r"Permission is hereby granted, free of charge"),
)
"""SPDX identifiers, with words that only the text of that licence has; the narrower first."""


@dataclass(frozen=True)
class Origin:
    """Source and licence as files state them, ``unknown`` where none does, and these files."""

    source: str
    license: str
    files: frozenset[Path]


def read_origin(path: Path) -> Origin:
    """Origin of the captures in ``path``, a folder or a file.

    Looked at are licence files, READMEs and MANIFESTs of the folder and of those directly below
    it, none above: captures that were put into a project's folder are not under its licence. A
    licence file counts before what a README says. The source is what a line ``Source: ...`` of a
    README or MANIFEST says.
    """
    path = real_path(path)
    folder = path if path.is_dir() else path.parent
    below = [p for p in sorted(folder.iterdir()) if p.is_dir() and p.name[0] != "."]
    places = [folder, *below]
    found_license = _first(_licenses(places), folder)
    found_source = _first(_said(places, "source"), folder)
    files = {file for _, file in (found_license, found_source) if file is not None}
    return Origin(found_source[0], found_license[0], frozenset(files))


def _first(found: Iterator[tuple[str, Path]], folder: Path) -> tuple[str, Path | None]:
    for text, file in found:
        return f"{text} ({os.path.relpath(file, folder)} says)", file
    return UNKNOWN, None


def _licenses(places: list[Path]) -> Iterator[tuple[str, Path]]:
    for file in _files_called(places, _LICENSE_FILE):
        text = _text_of(file)
        name = next((name for name, words in _KNOWN if re.search(words, text)), None)
        if name is not None:
            yield name, file
        elif text.strip():
            yield f"not recognised: {_quoted(text.strip().splitlines()[0])}", file
    yield from _said(places, "licen[sc]e")


def _said(places: list[Path], word: str) -> Iterator[tuple[str, Path]]:
    """What READMEs say after ``word:``, or below a heading of this one word."""
    line = re.compile(rf"^[ \t]*[-*#> ]*\**{word}\**[ \t]*:\**[ \t]*(\S.*)$", re.I | re.M)
    heading = re.compile(rf"^#+[ \t]*{word}[ \t]*#*[ \t]*\n+[ \t]*(\S.*)$", re.I | re.M)
    for file in _files_called(places, _ABOUT_FILE):
        text = _text_of(file)
        found = line.search(text) or heading.search(text)
        if found is not None:
            yield _quoted(found[1]), file


def _files_called(places: list[Path], name: re.Pattern[str]) -> Iterator[Path]:
    for place in places:
        yield from sorted(p for p in place.iterdir() if name.fullmatch(p.name) and p.is_file())


def _text_of(file: Path) -> str:
    """Text of a file that may be anything; one that cannot be read says nothing."""
    try:
        return read_text(file, _LIMIT_BYTES, "a text", latin_1=True)
    except InputError:
        return ""


def _quoted(text: str) -> str:
    text = printable(text.strip())
    return text if len(text) <= _QUOTED else text[: _QUOTED - 4] + " ..."
