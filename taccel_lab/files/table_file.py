# SPDX-License-Identifier: Apache-2.0
"""Tables: CSV files with a header, as spreadsheets, scripts and other projects write them.

Cells are parted by commas, semicolons or tabs, whichever the header has most of; beside the latter
two, a comma in a number is a decimal one. Cells in quotes may hold the separator, but no line
break. Empty lines and lines that begin with ``#`` are left out. Text is UTF-8, or else Latin-1.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from taccel_lab.errors import InputError
from taccel_lab.files.declared import require_few
from taccel_lab.files.documents import first_repeated
from taccel_lab.files.regular_file import read_text, shown

MAX_CHARACTERS = 64
"""A double needs 24."""
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")


def number(text: str) -> float:
    """The finite number that ``text`` is, spaces around it aside: ``1``, ``-0.5``, ``2.5e-3``.

    Python reads ``1_0``, ``nan``, ``infinity`` and the digits of any script as numbers, too; in a
    table they are slips. Raises ValueError otherwise.
    """
    stripped = text.strip(" \t")
    if len(stripped) > MAX_CHARACTERS or not _NUMBER.fullmatch(stripped):
        raise ValueError(f"{text[:MAX_CHARACTERS]!r} is not a number")
    value = float(stripped)
    if not math.isfinite(value):
        raise ValueError(f"{text[:MAX_CHARACTERS]!r} is not a finite number")
    return value


TABLE_LIMIT_BYTES = 64 << 20
"""A million rows of eight numbers."""
MAX_LINES = 1_000_000
"""A quarter of an hour at 1 kHz; more makes hundreds of megabytes of a table of labels."""
MAX_LINE_CHARACTERS = 1 << 17
"""The most that Python's csv module takes as one cell; a row of 1,000 columns has a fifth."""
_DELIMITERS = ",;\t"


@dataclass(frozen=True)
class Row:
    """One row."""

    table: TextTable
    line: int
    """Number in the file, from 1."""
    cells: Sequence[str]

    def text(self, column: int) -> str:
        """The cell, without spaces around it."""
        return self.cells[column].strip()

    def number(self, column: int) -> float:
        """The cell as a finite number; InputError with file, line and column."""
        cell = self.cells[column]
        try:
            return number(cell.replace(",", ".") if self.table.decimal_comma else cell)
        except ValueError:
            name = self.table.header[column]
            raise self.error(f"column {name}: {shown(cell)} is not a finite number") from None

    def error(self, problem: str) -> InputError:
        """The error that names this row."""
        return InputError(f"{self.table.path}: line {self.line}: {problem}")


@dataclass(frozen=True)
class TextTable:
    """A table, whose rows are split on demand."""

    path: Path
    header: tuple[str, ...]
    """Names of the columns, without spaces around them; empty where a column has none."""
    delimiter: str
    body: str
    """The text below the header."""
    first_line: int
    """Number of its first line in the file."""

    @property
    def decimal_comma(self) -> bool:
        return self.delimiter != ","

    def column(self, *names: str) -> int | None:
        """Index of the column with the first of these names that there is, whatever its case.

        Raises InputError where two columns differ in case alone.
        """
        lower = [name.lower() for name in self.header]
        for name in names:
            if lower.count(name) > 1:
                both = [known for known in self.header if known.lower() == name]
                raise InputError(f"{self.path} has the columns {' and '.join(both)}; one is needed")
            if name in lower:
                return lower.index(name)
        return None

    def require_column(self, *names: str) -> int:
        """``column``; InputError when there is none."""
        found = self.column(*names)
        if found is None:
            raise InputError(
                f"{self.path} lacks a column {' or '.join(names)} (found {self.columns_shown()})"
            )
        return found

    def columns_shown(self) -> str:
        """Names of the columns for a message."""
        return shown(", ".join(self.header))[1:-1]

    def rows(self) -> Iterator[Row]:
        """The rows; InputError for one with other than a cell a column."""
        for line, text in numbered_lines(self.body, self.first_line, self.path):
            cells = _split(text, self.delimiter, line, self.path)
            if len(cells) != len(self.header):
                commas = self.delimiter == "," and len(cells) > len(self.header)
                raise InputError(
                    f"{self.path}: line {line} has {len(cells)} cells, the header "
                    f"{len(self.header)}"
                    + ("; beside decimal commas, cells are parted by semicolons" if commas else "")
                )
            yield Row(self, line, cells)


def read_table(path: Path) -> TextTable:
    """Read a table and its header.

    Raises InputError with the path, here or as the rows are read: no file, too large, no text, no
    header, a column that stands twice, quotes that are not closed, rows of another length.
    """
    text = read_table_text(path)
    found = next(numbered_lines(text, 1, path), None)
    if found is None:
        raise InputError(f"{path} is empty; a table begins with the names of its columns")
    line, head = found
    delimiter = max(_DELIMITERS, key=head.count)
    header = tuple(name.strip() for name in _split(head, delimiter, line, path))
    twice = first_repeated(name for name in header if name)
    if twice is not None:
        raise InputError(f"{path} has the column {shown(twice)} twice; which one counts?")
    rest = text.split("\n", line)[line:]
    return TextTable(path, header, delimiter, rest[0] if rest else "", line + 1)


def read_table_text(path: Path) -> str:
    """Text of a table, whose lines end with a line feed; InputError as ``read_table``."""
    text = read_text(path, TABLE_LIMIT_BYTES, "a table", latin_1=True)
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    require_few(path, "lines", text.count("\n"), MAX_LINES)
    return text


def numbered_lines(text: str, first: int, path: Path) -> Iterator[tuple[int, str]]:
    """Lines with something in them, by number; one by one, since a list of them takes 30 times
    their size."""
    start, line = 0, first
    while start < len(text):
        end = text.find("\n", start)
        end = len(text) if end < 0 else end
        if end - start > MAX_LINE_CHARACTERS:
            raise InputError(
                f"{path}: line {line} has {end - start:,} characters; a row may have "
                f"{MAX_LINE_CHARACTERS:,}"
            )
        content = text[start:end].strip(" ")
        if content and content[0] != "#":
            yield line, content
        start, line = end + 1, line + 1


def _split(text: str, delimiter: str, line: int, path: Path) -> list[str]:
    try:
        return next(csv.reader([text], delimiter=delimiter, strict=True))
    except csv.Error as error:
        cause = "a quote is not closed" if "unexpected end" in str(error) else str(error)
        raise InputError(f"{path}: line {line}: {cause}") from None
