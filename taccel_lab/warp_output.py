# SPDX-License-Identifier: Apache-2.0
"""Warp's own lines, which are for its developers."""

from __future__ import annotations

import ctypes
import os
import sys
from pathlib import Path

import warp as wp

_DRIVERS = ("libcuda.so", "libcuda.so.1")


def quiet_warp() -> None:
    """Initialise Warp without its lines on modules loaded and, where there is no GPU, on a missing
    driver, which its library writes to the standard error of the process itself."""
    wp.config.log_level = wp.LOG_ERROR
    if sys.platform != "linux" or any(map(_loads, _DRIVERS)):
        wp.init()
        return
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        wp.init()
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


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
