# SPDX-License-Identifier: Apache-2.0
"""How much memory an example takes: of this process and of the readers' processes below it.

Linux alone tells and resets the peak; elsewhere nothing is measured.
"""

from __future__ import annotations

import os
from pathlib import Path

_before: dict[int, int] = {}


def limit(more_bytes: int) -> None:
    """Let this process and those that it starts take that much more than now, and no more."""
    import resource

    if not hasattr(resource, "RLIMIT_DATA"):
        return
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    soft = _of(os.getpid(), "VmData") + more_bytes
    resource.setrlimit(resource.RLIMIT_DATA, (soft, resource.RLIM_INFINITY))


def begin() -> None:
    """From here on."""
    _before.clear()
    for process in (os.getpid(), *_children()):
        try:
            Path(f"/proc/{process}/clear_refs").write_text("5")
        except OSError:
            return
        _before[process] = _of(process, "VmRSS")


def taken() -> int:
    """Peak of the process that took most since ``begin``, above what it had then [bytes]."""
    if not _before:
        return 0
    processes = (os.getpid(), *_children())
    return max(_of(process, "VmHWM") - _before.get(process, 0) for process in processes)


def children_cpu_s() -> float:
    """CPU time of the processes below this one that are alive [s]."""
    ticks = 0
    for process in _children():
        try:
            words = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        ticks += int(words[11]) + int(words[12])  # proc(5): utime, stime.
    return ticks / os.sysconf("SC_CLK_TCK")


def _children() -> list[int]:
    found: list[int] = []
    for path in Path("/proc/self/task").glob("*/children"):
        try:
            found += [int(word) for word in path.read_text().split()]
        except OSError:
            continue
    return found


def _of(process: int, what: str) -> int:
    try:
        for line in Path(f"/proc/{process}/status").read_text().splitlines():
            if line.startswith(what + ":"):
                return int(line.split()[1]) * 1024
    except OSError:
        pass
    return 0
