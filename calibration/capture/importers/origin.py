# SPDX-License-Identifier: Apache-2.0
"""Where captures come from and under which licence: what lies beside them says, or nothing does."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from taccel_lab.errors import InputError
from taccel_lab.files.inner_path import real_path
from taccel_lab.files.regular_file import read_text
from taccel_lab.printable import printable

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
    for file in _files(places, _LICENSE_FILE):
        text = _text(file)
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
    for file in _files(places, _ABOUT_FILE):
        text = _text(file)
        found = line.search(text) or heading.search(text)
        if found is not None:
            yield _quoted(found[1]), file


def _files(places: list[Path], name: re.Pattern[str]) -> Iterator[Path]:
    for place in places:
        yield from sorted(p for p in place.iterdir() if name.fullmatch(p.name) and p.is_file())


def _text(file: Path) -> str:
    """Text of a file that may be anything; one that cannot be read says nothing."""
    try:
        return read_text(file, _LIMIT_BYTES, "a text", latin_1=True)
    except InputError:
        return ""


def _quoted(text: str) -> str:
    text = printable(text.strip())
    return text if len(text) <= _QUOTED else text[: _QUOTED - 4] + " ..."
