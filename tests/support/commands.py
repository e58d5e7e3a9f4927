# SPDX-License-Identifier: Apache-2.0
"""Runs ``taccel-lab``, or another program with its exit codes, in this process."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import pytest

from taccel_lab.cli.app import Command, main

Parser = Callable[[Sequence[str]], Command]


class Done(NamedTuple):
    """Exit code and texts of a command."""

    code: int
    out: str
    err: str


def run(*words: object, parsed: Parser | None = None) -> int:
    """Exit code of ``taccel-lab WORDS``, or of the program whose parser is given; ``--help`` and
    refused words exit inside the parser."""
    try:
        return main([str(word) for word in words], parsed)
    except SystemExit as end:
        return int(end.code or 0)


def done(capsys: pytest.CaptureFixture[str], *words: object, parsed: Parser | None = None) -> Done:
    """The same with what it printed, and nothing that was printed before."""
    capsys.readouterr()
    code = run(*words, parsed=parsed)
    return Done(code, *capsys.readouterr())


def refusal(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """The one sentence with which the command refuses bad input (exit code 2), in one line."""
    code, _, err = done(capsys, *words)
    assert code == 2, err
    return " ".join(err.split())
