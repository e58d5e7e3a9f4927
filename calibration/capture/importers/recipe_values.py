# SPDX-License-Identifier: Apache-2.0
"""What the files of a recipe's set state: its ball, its scale, and tables of another header."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from taccel_lab.calibration.capture.importers.draft import Draft, ImportOptions
from taccel_lab.calibration.capture.importers.path_pattern import regex_of
from taccel_lab.calibration.capture.importers.recipe import Set, Setting
from taccel_lab.calibration.capture.importers.recipe_images import ImagePlace
from taccel_lab.errors import InputError
from taccel_lab.files.cell_number import number
from taccel_lab.files.json_file import read_json
from taccel_lab.files.plain_values import number_at
from taccel_lab.files.table_file import read_table_text
from taccel_lab.files.text_file import shown
from taccel_lab.files.yaml_file import read_yaml

_SHOWN_TEXT = 500
"""Characters of a text in which a number is looked for."""


class RecipeSettings:
    """The set's file of numbers, read when the first of them is needed."""

    def __init__(self, place: ImagePlace, of: Set, draft: Draft) -> None:
        self._draft = draft
        self.path = next(iter(place.files(of.settings)), None)
        self.name = (of.settings or [""])[0]
        self._values: dict[str, Any] | None = None

    def values(self) -> dict[str, Any]:
        """All of it; InputError where the file is damaged."""
        assert self.path is not None
        if self._values is None:
            is_json = self.path.suffix.lower() == ".json"
            self._values = read_json(self.path) if is_json else read_yaml(self.path)
            self._draft.used.add(self.path)
        return self._values

    def number(self, setting: Setting) -> float:
        """A positive number of the file; InputError with its name and the key."""
        if setting.text is None:
            value = number_at(self.values(), setting.key, str(self.path))
        else:
            said = str(_at(self.values(), setting.key))[:_SHOWN_TEXT]
            fit = regex_of(setting.text).fullmatch(said)
            if fit is None:
                raise InputError(
                    f"{self.path}: {setting.key} is {shown(said)}; {setting.text} is needed"
                )
            try:
                value = number(fit["value"])
            except ValueError as error:
                raise InputError(f"{self.path}: {setting.key}: {error}") from None
        if value <= 0:
            raise InputError(
                f"{self.path}: {setting.key} is {value:g}; a positive number is needed"
            )
        return value

    def lists(self, keys: Mapping[str, str]) -> str:
        """A CSV of lists of numbers, by the column that each becomes."""
        columns = []
        for key in keys.values():
            found = _at(self.values(), key)
            if not isinstance(found, list) or not all(type(v) in (int, float) for v in found):
                raise InputError(
                    f"{self.path}: {key} is {shown(found)}; a list of numbers is needed"
                )
            columns.append([repr(float(value)) for value in found])
        if len({len(column) for column in columns}) > 1:
            counts = " and ".join(str(len(column)) for column in columns)
            raise InputError(
                f"{self.path}: {', '.join(keys.values())} have {counts} numbers; as many are needed"
            )
        rows = [",".join(row) for row in zip(*columns, strict=True)]
        return "\n".join([",".join(keys), *rows]) + "\n"


def _at(values: Any, key: str) -> Any:
    for part in key.split("."):
        values = values.get(part) if isinstance(values, dict) else None
    return values


def set_values(
    draft: Draft,
    place: ImagePlace,
    of: Set,
    settings: RecipeSettings,
    options: ImportOptions,
    why: str,
) -> float | None:
    """State scale and ball where options do not; returns the ball's radius [mm], if it is known.

    Raises InputError for a file that has something else in the place of a number.
    """
    radius, scale = options.radius_mm, options.mm_per_px_x
    asked = {
        "--mm-per-px-x": (scale, of.mm_per_px, of.px_per_mm),
        "--radius-mm": (radius, of.radius_mm, of.diameter_mm),
    }
    missing = [flag for flag, (given, *kinds) in asked.items()
               if given is None and any(isinstance(kind, Setting) for kind in kinds)]  # fmt: skip
    if missing and settings.path is None:
        draft.notes.append(
            f"{settings.name} is missing; {' and '.join(missing)} give what it states"
        )

    def value(kind: float | Setting | None) -> tuple[float | None, bool]:
        """The number, and whether a file states it."""
        if not isinstance(kind, Setting):
            return kind, False
        return (None, True) if settings.path is None else (settings.number(kind), True)

    if radius is None:
        for kind, factor in ((of.radius_mm, 1.0), (of.diameter_mm, 0.5)):
            found, stated = value(kind)
            if found is not None:
                radius = factor * found
                if of.presses is not None:
                    draft.set_ball(radius, None if stated else of.why.get("radius_mm", why))
    if scale is None:
        for kind, inverse in ((of.mm_per_px, False), (of.px_per_mm, True)):
            found, stated = value(kind)
            if found is not None:
                mm_per_px = 1 / found if inverse else found
                draft.set_scale(mm_per_px, why=None if stated else of.why.get("mm_per_px", why))
    return radius


def renamed_table(path: Path, columns: Mapping[str, str]) -> str:
    """Text of a CSV whose columns are called otherwise."""
    head, _, rows = read_table_text(path).partition("\n")
    names = [name.strip() for name in head.split(",")]
    if columns.keys() & set(names):
        head = ",".join(columns.get(name, name) for name in names)
    return f"{head}\n{rows.removesuffix(chr(10))}\n"
