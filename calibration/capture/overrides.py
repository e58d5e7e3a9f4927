# SPDX-License-Identifier: Apache-2.0
"""``contacts.toml``: contact circles that a person has corrected, and presses to leave out.

``taccel-lab capture check --report`` writes one with the circles it found, as comments. Whoever
disagrees takes the ``#`` away and edits, and puts the file into the capture folder: every command
that reads the folder then takes it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from pydantic import Field, model_validator

from taccel_lab.calibration.capture.captures import CapturedPress, ContactCircle
from taccel_lab.errors import InputError
from taccel_lab.files.documents import first_repeated
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


def read_overrides(path: Path | str) -> dict[str, ContactOverride]:
    """Overrides by the name of the press; InputError names the file and what is wrong."""
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path} does not exist; taccel-lab capture check --report writes one")
    entries = _OverrideFile.read(path).contact
    twice = first_repeated(entry.press for entry in entries)
    if twice is not None:
        raise InputError(f"{path}: {twice} appears twice")
    return {entry.press: entry for entry in entries}


def override_presses(presses: Sequence[CapturedPress], path: Path) -> tuple[CapturedPress, ...]:
    """The presses with the circles of ``path``, less those that it leaves out."""
    overrides = read_overrides(path)
    unknown = sorted(set(overrides) - {press.name for press in presses})
    if unknown:
        raise InputError(
            f"{path} names {', '.join(unknown)}, which is no press of the captures (there are "
            f"{', '.join(press.name for press in presses[:6])}{' ...' if len(presses) > 6 else ''})"
        )
    kept = []
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
