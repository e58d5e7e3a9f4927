# SPDX-License-Identifier: Apache-2.0
"""How much memory a device has left, so that an allocation that must fail is not tried."""

from __future__ import annotations

from pathlib import Path

import warp as wp

_MEMINFO = Path("/proc/meminfo")


def free_memory(device: wp.Device) -> int | None:
    """Bytes that could still be allocated on a device; None where nobody says.

    Of a CPU what the system calls available, of a GPU what is free on it; what a pool keeps for
    later does not count.
    """
    if device.is_cuda:
        return int(device.free_memory)
    if not _MEMINFO.exists():
        return None
    for line in _MEMINFO.read_text().splitlines():
        name, _, amount = line.partition(":")
        if name == "MemAvailable":
            return 1024 * int(amount.split()[0])
    return None
