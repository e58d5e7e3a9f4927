# SPDX-License-Identifier: Apache-2.0
"""What a person says of contact circles: ``contacts.toml`` beside the manifest, whose labels stay.

A line that is replaced stays as a comment, so that the file tells what was said before.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from pydantic import Field, model_validator

from taccel_lab.calibration.capture.captures import CapturedPress, ContactCircle
from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import atomic_file
from taccel_lab.files.documents import TOML_LIMIT_BYTES, first_repeated
from taccel_lab.files.inner_path import own_place
from taccel_lab.files.regular_file import read_text
from taccel_lab.files.strict_model import Flag, Number, StrictModel
from taccel_lab.printable import printable

CONTACTS_NAME = "contacts.toml"

HEADER = """\
# Contact circles of {source}
# Lines that begin with # have no effect. To correct a circle, take the # away and edit it; to leave
# a press out, write skip = true in its table. Then put this file into the capture folder.
"""


class ContactOverride(StrictModel):
    """What a person says about one press: its circle, or that it is left out."""

    press: str = Field(min_length=1)
    """Name of the press."""
    u_px: Number | None = None
    v_px: Number | None = None
    radius_px: Number | None = Field(default=None, gt=0)
    skip: Flag = False
    """Leave the press out of every calibration."""

    @model_validator(mode="after")
    def _check_whole(self) -> ContactOverride:
        given = [value is not None for value in (self.u_px, self.v_px, self.radius_px)]
        if any(given) and not all(given):
            raise ValueError("u_px, v_px and radius_px go together; one is missing")
        return self

    def circle(self) -> ContactCircle | None:
        """The circle, or None when the found one stays."""
        if self.u_px is None or self.v_px is None or self.radius_px is None:
            return None
        return ContactCircle(self.u_px, self.v_px, self.radius_px)


class _OverrideFile(StrictModel):
    contact: list[ContactOverride] = Field(default_factory=list)


def read_overrides(presses: Sequence[CapturedPress], path: Path) -> dict[str, ContactOverride]:
    """What ``path`` says of presses, by their names. Raises InputError with the file and what is
    wrong."""
    entries = _OverrideFile.read(path).contact
    twice = first_repeated(entry.press for entry in entries)
    if twice is not None:
        raise InputError(f"{path}: {twice} appears twice")
    overrides = {entry.press: entry for entry in entries}
    unknown = sorted(set(overrides) - {press.name for press in presses})
    if unknown:
        raise InputError(
            f"{path} names {', '.join(unknown)}, which is no press of the captures (there are "
            f"{', '.join(press.name for press in presses[:6])}{' ...' if len(presses) > 6 else ''})"
        )
    return overrides


def override_presses(presses: Sequence[CapturedPress], path: Path) -> tuple[CapturedPress, ...]:
    """The presses with the circles of ``path``, less those that it leaves out.

    Raises InputError with the file and what is wrong.
    """
    overrides, kept = read_overrides(presses, path), []
    for press in presses:
        override = overrides.get(press.name)
        if override is None:
            kept.append(press)
        elif not override.skip:
            circle = override.circle()
            checked = dataclasses.replace(press, circle=circle, checked=True)
            kept.append(press if circle is None else checked)
    if presses and not kept:
        raise InputError(f"{path} leaves out every press; at least one has to stay")
    return tuple(kept)


def override_text(source: str, entries: Sequence[tuple[str, ContactCircle | None, str]]) -> str:
    """Contents of a ``contacts.toml``: (press, circle found, note); no circle leaves it out."""
    import tomli_w

    blocks = [HEADER.format(source=printable(source))]
    for name, circle, note in entries:
        quoted = tomli_w.dumps({"press": name}).strip()
        lines = [f"# {printable(line)}" for line in note.splitlines() if line]
        if circle is None:
            lines += ["[[contact]]", quoted, "skip = true"]
        else:
            lines += [
                "# [[contact]]",
                f"# {quoted}",
                f"# u_px = {circle.u_px:.2f}",
                f"# v_px = {circle.v_px:.2f}",
                f"# radius_px = {circle.radius_px:.2f}",
            ]
        blocks.append("\n".join(lines) + "\n")
    return "\n".join(blocks)


def with_contact(
    text: str, names: Sequence[str], press: str, circle: ContactCircle | None, when: str
) -> str:
    """Contents of a ``contacts.toml`` in which ``press`` has another circle, or is left out.

    Every line stays; those of the press before become comments. ``names`` are the presses of its
    tables, in order. Raises InputError where the file has others, as entries of one list.
    """
    import tomli_w

    lines = text.rstrip("\n").split("\n")
    tables = _tables(lines)
    if len(tables) != len(names):
        raise InputError(
            f"{CONTACTS_NAME} has entries that are no table; write each as [[contact]]"
        )
    for name, (begin, end) in zip(names, tables, strict=True):
        if name == press:
            lines[begin:end] = [f"# until {when}: {line}" for line in lines[begin:end]]
    entry: dict[str, object] = {"press": press}
    if circle is None:
        entry["skip"] = True
    else:
        entry |= {key: round(value, 2) for key, value in dataclasses.asdict(circle).items()}
    lines += ["", f"# {when}", "[[contact]]", tomli_w.dumps(entry).rstrip()]
    return "\n".join(lines).lstrip("\n") + "\n"


def _tables(lines: Sequence[str]) -> list[tuple[int, int]]:
    """Lines of each table of a contact: its head and the values right below."""
    found = []
    for begin, line in enumerate(lines):
        if line.split("#")[0].strip() != "[[contact]]":
            continue
        end = begin + 1
        while end < len(lines) and not lines[end].lstrip().startswith(("[", "#")):
            end += 1
        found.append((begin, end))
    return found


def save_contact(
    path: Path, presses: Sequence[CapturedPress], name: str, circle: ContactCircle | None, when: str
) -> None:
    """Write a press's circle, or that it is left out, into the file; nothing else of it changes.

    Raises InputError where the file is damaged or a link, and where no press would be left.
    """
    own_place(path.parent, path.name)
    text, names = HEADER.format(source=printable(str(path.parent))), []
    if path.is_file():
        names = list(read_overrides(presses, path))
        text = read_text(path, TOML_LIMIT_BYTES, "a file of contacts")
    with atomic_file(path) as staging:
        staging.write_text(with_contact(text, names, name, circle, when), encoding="utf-8")
        override_presses(presses, staging)
