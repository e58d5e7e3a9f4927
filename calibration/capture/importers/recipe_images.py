# SPDX-License-Identifier: Apache-2.0
"""The images of a set of a recipe, with what stands of each in names, tables and archives."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from taccel_lab.calibration.capture.importers.path_pattern import Match, filled, find
from taccel_lab.calibration.capture.importers.recipe import ImageRecipe
from taccel_lab.calibration.capture.suffixes import is_picture
from taccel_lab.errors import InputError
from taccel_lab.files.arrays import finite_numbers, read_npz
from taccel_lab.files.cell_number import number
from taccel_lab.files.inner_path import inner_path
from taccel_lab.files.table_file import read_table


@dataclass(frozen=True)
class ImagePlace:
    """A folder in which patterns begin, and the fields that are known there."""

    folder: Path
    fields: Mapping[str, str]

    def matches(self, patterns: Sequence[str] | None, images: bool = False) -> list[Match]:
        """Files that any of the patterns stands for, those of the first first; ``images``: those
        that are some by their ending."""
        found = {
            match.path: match
            for pattern in patterns or ()
            for match in find(self.folder, pattern, self.fields)
            if not images or is_picture(match.path)
        }
        return list(found.values())

    def files(self, patterns: Sequence[str] | None) -> list[Path]:
        """Files to be read; errors of ``own``."""
        return [self.own(match.path) for match in self.matches(patterns)]

    def own(self, path: Path) -> Path:
        """A path of the folder; InputError for a link that leads out of it."""
        return inner_path(self.folder, path.relative_to(self.folder).as_posix())

    def images(self, patterns: Sequence[str] | None) -> list[Path]:
        """Paths of images."""
        return [match.path for match in self.matches(patterns, images=True)]


@dataclass(frozen=True)
class Found:
    """An image, and how its values are found."""

    image: Path
    name: str
    """In the capture folder, without the ending."""
    numbers: Callable[[str], list[float] | None]
    """What stands under a word; None where there is no such word, or no value."""
    said_by: Path
    """The file that errors name."""
    whole: bool = False
    """Whether it has to have what is known of others."""

    def first(self, words: Sequence[str] | None) -> float | None:
        """The one number of the first word that has any."""
        for word in words or ():
            if (numbers := self.numbers(word)) is not None:
                return self._checked(numbers, [word], ["number"])["number"]
        return None

    def together(self, words: Sequence[str] | None, keys: Sequence[str]) -> dict | None:
        """The numbers of all words by these keys; None where none has any."""
        parts = {word: self.numbers(word) for word in words or ()}
        lacking = [word for word, part in parts.items() if part is None]
        if lacking and (self.whole or len(lacking) < len(parts)):
            raise InputError(f"{self.said_by} lacks {' and '.join(lacking)} for {self.image.name}")
        if not parts or lacking:
            return None
        return self._checked([v for part in parts.values() for v in part or ()], [*parts], keys)

    def _checked(self, numbers: list[float], words: Sequence[str], keys: Sequence[str]) -> dict:
        if len(numbers) != len(keys):
            raise InputError(
                f"{self.said_by}: {' and '.join(words)}: {len(keys)} in all are needed "
                f"({', '.join(keys)}), found {len(numbers)} numbers"
            )
        return dict(zip(keys, numbers, strict=True))


def any_images(place: ImagePlace, images: ImageRecipe, words: Sequence[str] | None) -> bool:
    """Whether there is something to look at: an archive, with arrays of these words, or a file."""
    if images.table is not None:
        return _folder(place, images).is_dir() and bool(place.files(images.table))
    if images.arrays is None:
        return bool(place.images(images.files))
    archives = place.files([images.arrays])
    return bool(archives) and set(words or ()) <= read_npz(archives[0]).keys()


def _folder(place: ImagePlace, images: ImageRecipe) -> Path:
    """Where a table's images lie."""
    return inner_path(place.folder, filled(images.folder, place.fields))


def images_of(place: ImagePlace, images: ImageRecipe) -> Iterator[Found]:
    """All of them, in natural order or that of the table.

    Raises InputError for an image that a table names, or that belongs to an archive, and that is
    not there; for values that are no numbers.
    """
    if images.table is not None:
        yield from _of_table(place, images)
    elif images.arrays is None:
        for match in place.matches(images.files, images=True):
            name = named(images.name, match.fields, match.path)
            yield Found(match.path, name, _by_name(match), match.path)
    else:
        for match in place.matches([images.arrays]):
            yield _of_archive(place, images, match)


def named(name: str, fields: Mapping[str, str], image: Path) -> str:
    """The name of an image in the capture folder, without the ending."""
    return filled(name, {**fields, "stem": image.stem}).replace("/", "_")


def _by_name(match: Match) -> Callable[[str], list[float] | None]:
    def numbers(word: str) -> list[float] | None:
        try:
            return [number(match.fields[word])] if word in match.fields else None
        except ValueError as error:
            raise InputError(f"{match.path}: {{{word}}}: {error}") from None

    return numbers


def _of_archive(place: ImagePlace, images: ImageRecipe, match: Match) -> Found:
    wanted = [place.folder / filled(pattern, match.fields) for pattern in images.files or ()]
    image = next((path for path in wanted if path.is_file()), None)
    if image is None:
        raise InputError(f"{wanted[0]} does not exist")
    path = place.own(match.path)
    arrays, by_name = read_npz(path), _by_name(match)

    def numbers(word: str) -> list[float] | None:
        if word in match.fields:
            return by_name(word)
        known = word in arrays
        return finite_numbers(arrays, word, path).astype(float).ravel().tolist() if known else None

    return Found(image, named(images.name, match.fields, image), numbers, path, whole=True)


def _of_table(place: ImagePlace, images: ImageRecipe) -> Iterator[Found]:
    path = place.files(images.table)[0]
    table = read_table(path)
    column = table.require_column((images.image or "").lower())
    folder = _folder(place, images)
    for row in table.rows():
        image = inner_path(folder, row.text(column))
        if not image.is_file():
            raise row.error(f"{image} does not exist")

        def numbers(word: str, row=row) -> list[float] | None:
            at = table.column(word.lower())
            return None if at is None or not row.text(at) else [row.number(at)]

        yield Found(image, named(images.name, place.fields, image), numbers, path)
