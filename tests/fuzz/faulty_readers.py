# SPDX-License-Identifier: Apache-2.0
"""Readers that do what no reader should, to see that it is noticed."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import numpy as np

from taccel_lab.errors import InputError
from tests.fuzz.reader import Reader

Call = Callable[[Path, Path], object]


def _make(given: Path) -> None:
    (given / "a.bin").write_bytes(b"a")


def _raise(error: Exception) -> NoReturn:
    raise error


def _copy(given: Path, out: Path) -> None:
    out.mkdir()
    shutil.copy(given.parent / "beside" / "outside.png", out)


def _leave_half(given: Path, out: Path) -> None:
    out.mkdir()
    raise InputError("a.bin is damaged")


FAULTS: dict[str, tuple[Call, str]] = {
    "raises": (lambda given, out: _raise(KeyError("shape")), "exception"),
    "crashes": (lambda given, out: os.abort(), "crash"),
    "hangs": (lambda given, out: time.sleep(3600), "hang"),
    "eats": (lambda given, out: np.ones(1200 << 20, np.uint8), "memory"),
    "eats-all": (lambda given, out: np.ones(9 << 30, np.uint8), "memory"),
    "strays": (lambda given, out: (out.parent / "stray").write_text(""), "outside"),
    "damages": (lambda given, out: shutil.rmtree(given), "outside"),
    "copies": (_copy, "outside"),
    "leaves-half": (_leave_half, "outside"),
    "mumbles": (lambda given, out: _raise(InputError("invalid literal")), "message"),
    "shouts": (lambda given, out: _raise(InputError("a.bin: " + "x " * 10_000)), "message"),
    "refuses": (
        lambda given, out: _raise(InputError(f"{given / 'a.bin'} does not hold one letter")),
        "refused",
    ),
}
"""By name: what it does to a sample that is damaged, and what is to be noticed."""


def _faulty(fault: Call) -> Call:
    def call(given: Path, out: Path) -> None:
        path = given / "a.bin"
        if not path.is_file() or path.read_bytes() != b"a":
            fault(given, out)

    return call


READERS = {name: Reader(_make, _faulty(fault)) for name, (fault, _) in FAULTS.items()}
