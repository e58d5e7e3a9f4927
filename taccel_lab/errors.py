# SPDX-License-Identifier: Apache-2.0
"""Errors that are addressed to a user of the tool rather than to its programmer."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

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


class SimulationError(RuntimeError):
    """A simulation that did not reach its stated tolerance, with the cause and the numbers.

    The command line prints it without a traceback and exits with code 3.
    """
