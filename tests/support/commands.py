# SPDX-License-Identifier: Apache-2.0
"""Runs ``taccel-lab`` in this process."""

from __future__ import annotations

from typing import NamedTuple

import pytest

from taccel_lab.cli.app import main


class Done(NamedTuple):
    """Exit code and texts of a command."""

    code: int
    out: str
    err: str


def run(*words: object) -> int:
    """Exit code of ``taccel-lab WORDS``; ``--help`` and refused words exit inside the parser."""
    try:
        return main([str(word) for word in words])
    except SystemExit as end:
        return int(end.code or 0)


def done(capsys: pytest.CaptureFixture[str], *words: object) -> Done:
    """The same with what it printed, and nothing that was printed before."""
    capsys.readouterr()
    code = run(*words)
    return Done(code, *capsys.readouterr())


def refusal(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """The one sentence with which the command refuses bad input (exit code 2), in one line."""
    code, _, err = done(capsys, *words)
    assert code == 2, err
    return " ".join(err.split())
