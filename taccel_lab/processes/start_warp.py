# SPDX-License-Identifier: Apache-2.0
"""Warp started: its kernels where they can be kept, without lines that are for its developers."""

from __future__ import annotations

import ctypes
import os
import sys
from pathlib import Path

import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.processes.cache_place import CACHE_VARIABLE, place_kernels

_DRIVERS = ("libcuda.so", "libcuda.so.1")
_started: list[bool] = []
"""Whether this process has called Warp's initialisation."""


def start_warp() -> None:
    """Initialise Warp, unless it is, without its lines on modules loaded and, where there is no
    GPU, on a missing driver, which its library writes to the standard error of the process itself.

    ``wp.config.log_level`` set afterwards brings its lines back.

    Raises:
        InputError: There is no folder for its kernels that can be written.
    """
    if _started:
        return
    wp.config.log_level = wp.LOG_ERROR
    if sys.platform != "linux" or any(map(_loads, _DRIVERS)):
        _initialise()
        return
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        _initialise()
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def _initialise() -> None:
    if wp.config.kernel_cache_dir is None:
        place_kernels()
    try:
        wp.init()
    except OSError as error:
        raise InputError(
            f"Warp cannot keep its kernels in {error.filename} ({error.strerror}); set "
            f"{CACHE_VARIABLE} to a folder that can be written"
        ) from None
    _started.append(True)


def first_step() -> str:
    """What a press does before its first step: in a cache of kernels without a solver it compiles
    one, which needs no second time on this machine."""
    cache = Path(wp.config.kernel_cache_dir or "")
    if any(cache.glob("wp_taccel_lab.solvers.*")):
        return "first step"
    return "compiling the solver, once on this machine: about 30 s"


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True
