# SPDX-License-Identifier: Apache-2.0
"""Warp devices by name."""

from __future__ import annotations

import warp as wp

from taccel_lab.errors import InputError


def require_device(name: str) -> None:
    """Refuse a device that this machine does not have."""
    try:
        wp.get_device(name)
    except ValueError:
        known = ", ".join(device.alias for device in wp.get_devices())
        raise InputError(f"device {name!r} is not there; this machine has: {known}") from None
