# SPDX-License-Identifier: Apache-2.0
"""Warp devices by name, and Warp's own lines."""

from __future__ import annotations

import ctypes
import os
import sys

import warp as wp

from taccel_lab.errors import InputError

_DRIVERS = ("libcuda.so", "libcuda.so.1")


def require_device(name: str) -> None:
    """Refuse a device that this machine does not have."""
    try:
        wp.get_device(name)
    except ValueError:
        known = ", ".join(device.alias for device in wp.get_devices())
        raise InputError(f"device {name!r} is not there; this machine has: {known}") from None


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


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True
