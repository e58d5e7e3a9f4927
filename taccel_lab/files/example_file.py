# SPDX-License-Identifier: Apache-2.0
"""Example files that are installed with the package, by their names."""

from __future__ import annotations

from pathlib import Path

from taccel_lab.errors import InputError

_PACKAGE = Path(__file__).parents[1]


def file_or_example(given: Path, room: str) -> Path:
    """``given`` where it is a file, else the example of that name.

    A folder does not hide an example: it may be the output of an earlier run.

    Args:
        given: A path, or an example's name with or without ``.toml``, alone or behind the folder
            where examples stand in a checkout.
        room: Package of the examples: ``studies`` or ``datasets``.

    Raises:
        InputError: Neither a file nor an example; lists the examples.
    """
    folders = ((), (room, "examples"), (_PACKAGE.name, room, "examples"))
    if given.is_file() or given.parts[:-1] not in folders or given.suffix not in ("", ".toml"):
        return given
    examples = _PACKAGE / room / "examples"
    found = examples / f"{given.stem}.toml"
    if not found.is_file():
        if given.exists():
            return given
        names = ", ".join(sorted(path.stem for path in examples.glob("*.toml")))
        raise InputError(f"{given} does not exist, and no example has that name; known: {names}")
    return found
