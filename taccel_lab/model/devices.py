# SPDX-License-Identifier: Apache-2.0
"""Warp devices by name."""

from __future__ import annotations

import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.processes.start_warp import start_warp


def require_device(name: str | wp.Device | None) -> wp.Device:
    """A device by its name, such as "cpu" or "cuda:0"; Warp's default for None.

    Raises:
        InputError: This machine does not have it, or there is nowhere to keep its kernels.
    """
    start_warp()
    try:
        return wp.get_device(name)
    except (ValueError, RuntimeError):  # RuntimeError: "cuda" without a driver.
        known = ", ".join(device.alias for device in wp.get_devices())
        raise InputError(f"device {name!r} is not there; this machine has: {known}") from None
