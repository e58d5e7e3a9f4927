# SPDX-License-Identifier: Apache-2.0
"""Tables of contact circles beside images that follow no manifest."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from taccel_lab.calibration.capture.records import is_record
from taccel_lab.errors import InputError
from taccel_lab.files.table_file import number, numbered_lines, read_table, read_table_text

Circle = dict[str, float]
"""``u_px``, ``v_px`` and ``radius_px``."""
_FILE_COLUMNS = ("file", "image", "img_name", "img_names", "filename", "name", "frame", "press")
_U_COLUMNS = ("cx_px", "u_px", "cx", "center_x", "x_px", "x", "u")
_V_COLUMNS = ("cy_px", "v_px", "cy", "center_y", "y_px", "y", "v")
_RADIUS_COLUMNS = (
    "contact_r_px",
    "radius_px",
    "contact_r",
    "contact_radius",
    "r_px",
    "radius",
    "r",
)
_NUMBER = r"([-+.0-9]{1,64})"
_TUPLE_LINE = re.compile(
    rf"(\S{{1,255}}\.\w{{1,16}}(?=[\s(])|[^\s(]{{1,255}}(?=\s*\())\s*\(?\s*{_NUMBER}\s*,\s*{_NUMBER}[\s,)]+{_NUMBER}\s*"
)
"""``name.png (204, 98) 31``, as some labelling scripts print it; names without an ending need the
bracket to be distinguished from numbers."""
NAMES = (
    "images are named by their file name or their path below the folder, with or without the ending"
)
_MAX_TUPLE_LINE = 500
"""Characters: a file name has up to 255."""


@dataclass
class LabelTables:
    """Circles of all label tables of a folder."""

    folder: Path
    circles: dict[str, tuple[Circle, Path]] = field(default_factory=dict)
    """Circles, with the table that says so, by the image as that names it: path below the folder,
    file name, or stem."""
    read: set[Path] = field(default_factory=set)
    """Tables with circles."""
    left_out: dict[Path, str] = field(default_factory=dict)
    """Tables that were not used, with the reason."""

    def of_images(self, images: Sequence[Path]) -> dict[Path, Circle]:
        """The circle of each image that has one.

        Raises InputError for a name that stands for several of the images.
        """
        found: dict[Path, Circle] = {}
        taken: dict[str, Path] = {}
        paths = {self._names(image)[0] for image in images}
        for image in images:
            path, *shorter = self._names(image)
            # What is the whole path of an image is no shorter name of another.
            names = [path, *(n for n in shorter if n not in paths)]
            name = next((n for n in names if n in self.circles), None)
            if name is None:
                continue
            if name in taken:
                other = self._names(taken[name])[0]
                raise InputError(
                    f"{self.circles[name][1]}: {name!r} may be {other} or {path}; name images by "
                    f"their path below {self.folder}, with the ending"
                )
            taken[name] = image
            found[image] = self.circles[name][0]
        return found

    def _names(self, image: Path) -> tuple[str, str, str, str]:
        """What a table may call an image, the most certain first."""
        path = image.relative_to(self.folder)
        return path.as_posix(), image.name, path.with_suffix("").as_posix(), image.stem

    def lost(self, images: Sequence[Path]) -> list[str]:
        """Names of the tables that none of these images has."""
        used = {name for image in images for name in self._names(image)}
        return sorted(name for name in self.circles if name not in used)


def read_label_tables(folder: Path) -> LabelTables:
    """Label tables of a folder and its ``labels``.

    Raises InputError for a table of circles with a fault, and for two circles of one image.
    """
    found = LabelTables(folder)
    for place in (folder, folder / "labels"):
        for path in sorted([*place.glob("*.txt"), *place.glob("*.csv")]):
            try:
                circles = read_labels(path)
                is_foreign = circles is None and path.suffix == ".csv" and place == folder
                if is_foreign and not is_record(path):
                    found.left_out[path] = _no_labels(path)
            except NotATable as error:
                found.left_out[path] = without_path(path, error)
                continue
            if circles:
                found.read.add(path)
            for name, circle in (circles or {}).items():
                known, other = found.circles.setdefault(name, (circle, path))
                if known != circle:
                    raise InputError(f"{path} and {other} have different circles of {name!r}")
    return found


def _no_labels(path: Path) -> str:
    """Which columns a table lacks to be one of labels, with all names that these may have."""
    table = read_table(path)
    kinds = {"the image": _FILE_COLUMNS, "the centre's column": _U_COLUMNS,
             "its row": _V_COLUMNS, "the radius": _RADIUS_COLUMNS}  # fmt: skip
    lacking = [f"{what} ({', '.join(names)})" for what, names in kinds.items()
               if table.column(*names) is None]  # fmt: skip
    # A table that has them all has no rows.
    lacks = f"no columns for {'; '.join(lacking)}" if lacking else "no rows"
    return f"{lacks}: a table of contact circles has one of each kind, and {NAMES}"


class NotATable(InputError):
    """A file that has no columns at all, so that it may well be something else."""


def without_path(path: Path, cause: Exception) -> str:
    """What an error says of a file that is named beside it."""
    return str(cause).removeprefix(str(path)).lstrip(": ")


def read_labels(path: Path) -> dict[str, Circle] | None:
    """Contact circles by image (as the table names it), or None when the file is no such table.

    A table with a header in any of the usual spellings, or lines of the form ``name (u, v) r``.

    Raises:
        NotATable: The file cannot be read as text with columns.
        InputError: It is a table of circles, and has a fault.
    """
    try:
        written = _tuple_lines(numbered_lines(read_table_text(path), 1, path))
        table = None if written is not None else read_table(path)
    except InputError as error:
        raise NotATable(str(error)) from None
    circles: dict[str, Circle] = {}
    if table is None:
        for line, name, *cells in written or []:
            _add(circles, name, _circle(cells, f"{path}: line {line}: {name}"), path)
        return circles
    kinds = (_FILE_COLUMNS, _U_COLUMNS, _V_COLUMNS, _RADIUS_COLUMNS)
    columns = [column for names in kinds if (column := table.column(*names)) is not None]
    if len(columns) < len(kinds):
        return None
    for row in table.rows():
        values = [row.number(column) for column in columns[1:]]
        _add(circles, row.text(columns[0]), dict(zip(_KEYS, values, strict=True)), path)
    return circles or None


_KEYS = ("u_px", "v_px", "radius_px")


def _tuple_lines(lines: Iterable[tuple[int, str]]) -> list[tuple[int, str, str, str, str]] | None:
    """Number of the line, name and three numbers; None when a line is of another form."""
    found = []
    for count, line in lines:
        text = line.strip()
        match = _TUPLE_LINE.fullmatch(text) if len(text) <= _MAX_TUPLE_LINE else None
        if match is None:
            return None
        found.append((count, match[1], match[2], match[3], match[4]))
    return found or None


def _circle(cells: Sequence[str], place: str) -> Circle:
    try:
        return dict(zip(_KEYS, map(number, cells), strict=True))
    except ValueError as error:
        raise InputError(f"{place}: {error}; three finite numbers of pixels are needed") from None


def _add(circles: dict[str, Circle], name: str, circle: Circle, path: Path) -> None:
    if circles.setdefault(name, circle) != circle:
        raise InputError(f"{path} has two circles of {name!r}")
