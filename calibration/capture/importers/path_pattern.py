# SPDX-License-Identifier: Apache-2.0
"""Patterns of paths with named fields: ``sensor_{unit}/press_{n:number}_*.png``.

``*`` stands for any characters of a name, ``{unit}`` for some that are kept under this word,
``{n:number}`` for digits. A field that is known already stands for its own text. Patterns may come
from anybody: none leads out of its folder, and few wildcards a name keep the time of any short.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BeforeValidator, Field

from taccel_lab.files.inner_path import require_inner_name

_WILD = re.compile(r"\*|\{([a-z][a-z0-9_]{0,39})(:number)?\}")
MAX_CHARACTERS = 300
MAX_WILDCARDS = 3
"""In one name: of 255 characters, so many are tried in a hundredth of a second at worst."""


def natural_key(path: Path | str) -> list[tuple[int, int, str]]:
    """Sort key under which ``frame_2`` comes before ``frame_10``."""
    # ASCII's alone: there are other characters that `isdigit`, but not `int`, takes for digits.
    parts = re.split(r"([0-9]+)", str(path))
    return [
        (0, int(part), "") if index % 2 else (1, 0, part.lower())
        for index, part in enumerate(parts)
    ]


def _checked(text: str) -> str:
    for name in require_inner_name(text).split("/"):
        words = fields_of(name)
        if re.search(r"[{}]", _WILD.sub("", name)) or len(set(words)) < len(words):
            raise ValueError("wildcards are *, {word} and {word:number}, each word once in a name")
        if len(_WILD.findall(name)) > MAX_WILDCARDS:
            raise ValueError(f"one name may have {MAX_WILDCARDS} wildcards")
    return text


Pattern = Annotated[str, Field(min_length=1, max_length=MAX_CHARACTERS), AfterValidator(_checked)]
one_or_several = BeforeValidator(lambda value: [value] if isinstance(value, str) else value)
Patterns = Annotated[list[Pattern], one_or_several, Field(min_length=1, max_length=20)]
"""One, or several, the best first."""


@dataclass(frozen=True)
class Match:
    """A path that a pattern stands for, and the text of its fields."""

    path: Path
    fields: Mapping[str, str]


def find(
    folder: Path,
    pattern: str,
    fields: Mapping[str, str],
    wanted: Callable[[Path], bool] = Path.is_file,
) -> list[Match]:
    """What is ``wanted`` of the paths below ``folder`` that a pattern stands for, in natural order;
    hidden ones are found by their whole name alone."""
    found = [Match(folder, fields)]
    for name in pattern.split("/"):
        found = [inner for match in found for inner in _inside(match, name)]
    found = [match for match in found if wanted(match.path)]
    return sorted(found, key=lambda match: natural_key(match.path.relative_to(folder)))


def filled(pattern: str, fields: Mapping[str, str]) -> str:
    """The pattern with the text of the fields that are known."""
    return _WILD.sub(lambda wild: fields.get(wild[1] or "", wild[0]), pattern)


def fields_of(pattern: str) -> list[str]:
    """Words of its fields."""
    return [wild[1] for wild in _WILD.finditer(pattern) if wild[1]]


def regex_of(text: str, known: Mapping[str, str] | None = None) -> re.Pattern[str]:
    """What matches the same as a pattern of one name, or of a line of text."""
    known, regex, place = known or {}, "", 0
    for wild in _WILD.finditer(text):
        regex += re.escape(text[place : wild.start()])
        word, place = wild[1], wild.end()
        if word in known:
            regex += re.escape(known[word])
        else:
            regex += f"(?P<{word}>{'[0-9]' if wild[2] else '.'}+?)" if word else ".*"
    return re.compile(regex + re.escape(text[place:]), re.DOTALL)


def _inside(match: Match, name: str) -> list[Match]:
    if all(wild[1] in match.fields for wild in _WILD.finditer(name)):
        return [Match(match.path / filled(name, match.fields), match.fields)]
    if not match.path.is_dir():
        return []
    regex = regex_of(name, match.fields)
    fits = ((path, regex.fullmatch(path.name)) for path in match.path.iterdir())
    return [
        Match(path, {**match.fields, **fit.groupdict()})
        for path, fit in fits
        if fit is not None and path.name[0] != "."
    ]
