# SPDX-License-Identifier: Apache-2.0
"""Errors that are addressed to a user of the tool rather than to its programmer."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeGuard

from taccel_lab.printable import readable


class InputError(ValueError):
    """Input that cannot be used: a file, an option or a parameter.

    The message names the file or parameter, says what was found and what is allowed; whatever it
    quotes from a damaged file is made readable. The command line prints it without a traceback and
    exits with code 2.
    """

    def __init__(self, message: object) -> None:
        super().__init__(readable(str(message)))


class InputWarning(UserWarning):
    """Input that is used otherwise than it stands: the command line prints it as a note, readable
    as an InputError."""

    def __init__(self, message: object) -> None:
        super().__init__(readable(str(message)))


@contextmanager
def naming(source: object) -> Iterator[None]:
    """Put ``source``, a file, before the message of an InputError that does not name it."""
    try:
        yield
    except InputError as error:
        if readable(str(source)) in str(error):
            raise
        raise InputError(f"{source}: {error}") from None


class _Kept(str):
    """What stays; other notes of an error, such as where a library raised it, are programmers'."""


@contextmanager
def keeping(what: Callable[[], str]) -> Iterator[None]:
    """Note ``what`` stays for the same command to go on with, unless it is empty, on whatever ends
    the block early: the command line says it of interrupts and of files that cannot be written."""
    try:
        yield
    except BaseException as error:
        if words := what():
            error.add_note(_Kept(words))
        raise


def kept_notes(error: BaseException) -> str:
    """What was noted of state that stays, see ``keeping``; by what the error came of, too."""
    found = [note for one in causes(error) for note in getattr(one, "__notes__", ())]
    return "; ".join(dict.fromkeys(note for note in found if isinstance(note, _Kept)))


def causes(error: BaseException | None) -> Iterator[BaseException]:
    """An exception and those that it came of: what interrupts the load of a library, such as the
    CAD kernel, comes out as ImportError or RuntimeError."""
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__


def is_of_a_file(error: BaseException | None) -> TypeGuard[OSError]:
    """Whether the system says why a file cannot be read or written, as on a full disk."""
    return isinstance(error, OSError) and error.errno is not None


def file_sentence(error: OSError) -> str:
    """Which file, and what the system says of it; of a copy, that which is written."""
    name = error.filename if error.filename2 is None else error.filename2
    return f"{error.strerror}" if name is None else f"{os.fsdecode(name)}: {error.strerror}"


class SimulationError(RuntimeError):
    """A simulation that did not reach its stated tolerance, with the cause and the numbers.

    The command line prints it without a traceback and exits with code 3.
    """
