# SPDX-License-Identifier: Apache-2.0
"""Readers that do what no reader should, to see that it is noticed."""

from __future__ import annotations

import os
import shutil
import time
from pathlib import Path

import numpy as np

from taccel_lab.errors import InputError
from tests.fuzz.reader import Reader


def _make(given: Path) -> None:
    (given / "a.bin").write_bytes(b"a")


def _is_sound(given: Path) -> bool:
    """The sample itself is accepted."""
    path = given / "a.bin"
    return path.is_file() and path.read_bytes() == b"a"


def _raises(given: Path, out: Path) -> None:
    if not _is_sound(given):
        raise KeyError("shape")


def _crashes(given: Path, out: Path) -> None:
    if not _is_sound(given):
        os.abort()


def _hangs(given: Path, out: Path) -> None:
    while not _is_sound(given):
        time.sleep(0.1)


def _eats(given: Path, out: Path) -> None:
    if not _is_sound(given):
        np.ones(1200 << 20, np.uint8)


def _eats_all(given: Path, out: Path) -> None:
    if not _is_sound(given):
        np.ones(9 << 30, np.uint8)


def _strays(given: Path, out: Path) -> None:
    if not _is_sound(given):
        (out.parent / "stray").write_text("")


def _damages(given: Path, out: Path) -> None:
    if not _is_sound(given):
        shutil.rmtree(given)


def _copies(given: Path, out: Path) -> None:
    out.mkdir()
    if not _is_sound(given):
        shutil.copy(given.parent / "beside" / "outside.png", out)


def _leaves_half(given: Path, out: Path) -> None:
    if not _is_sound(given):
        out.mkdir()
        raise InputError("a.bin is damaged")


def _mumbles(given: Path, out: Path) -> None:
    if not _is_sound(given):
        raise InputError("invalid literal")


def _shouts(given: Path, out: Path) -> None:
    if not _is_sound(given):
        raise InputError("a.bin: " + "x " * 10_000)


def _refuses(given: Path, out: Path) -> None:
    if not _is_sound(given):
        raise InputError(f"{given / 'a.bin'} does not hold one letter")


FAULTS = {
    "raises": (_raises, "exception"),
    "crashes": (_crashes, "crash"),
    "hangs": (_hangs, "hang"),
    "eats": (_eats, "memory"),
    "eats-all": (_eats_all, "memory"),
    "strays": (_strays, "outside"),
    "damages": (_damages, "outside"),
    "copies": (_copies, "outside"),
    "leaves-half": (_leaves_half, "outside"),
    "mumbles": (_mumbles, "message"),
    "shouts": (_shouts, "message"),
    "refuses": (_refuses, "refused"),
}
"""By name, with what is to be noticed."""
READERS = {name: Reader(_make, call) for name, (call, _) in FAULTS.items()}
