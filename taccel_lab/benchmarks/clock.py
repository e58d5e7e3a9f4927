# SPDX-License-Identifier: Apache-2.0
"""Which seconds count."""

from __future__ import annotations

import time
from collections.abc import Callable

import warp as wp

Clock = Callable[[], float]


def clock_of(device: wp.Device | str) -> Clock:
    """On a GPU wall time; on the CPU the process's own time, to which other work on a shared
    machine adds little. A process of ours computes on one thread."""
    return time.perf_counter if wp.get_device(device).is_cuda else time.process_time


def clock_name(device: wp.Device | str) -> str:
    """For results."""
    return "wall" if wp.get_device(device).is_cuda else "process"
