# SPDX-License-Identifier: Apache-2.0
"""What is measured of a step: seconds that count, memory, kernels launched from the host.

Memory is Warp's own record of allocations, the text of ``wp.ScopedMemoryTracker``, which is the
public way to its figures. On a GPU the memory pool's own figures stand beside it: they count what
kernels of a captured graph allocate, too.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import warp as wp

Clock = Callable[[], float]


def clock_of(device: wp.Device | str) -> Clock:
    """Wall time on a GPU; on the CPU the process's own time, to which other work on a shared
    machine adds little. A process of ours computes on one thread."""
    return time.perf_counter if wp.get_device(device).is_cuda else time.process_time


def clock_name(device: wp.Device | str) -> str:
    """Name of the clock for results."""
    return "wall" if wp.get_device(device).is_cuda else "process"


def seconds_of(work: Callable[[], Any], device: wp.Device | str, repeats: int) -> list[float]:
    """Time of each of ``repeats`` calls [s], until the device has done what they ask; two calls
    before are not timed."""
    seconds, clock = [], clock_of(device)
    for _ in range(repeats + 2):
        start = clock()
        work()
        wp.synchronize_device(device)
        seconds.append(clock() - start)
    return seconds[2:]


_UNITS = {"B": 1, "KB": 2**10, "MB": 2**20, "GB": 2**30, "TB": 2**40}
_LINE = re.compile(r"^\s+(\S+)\s+(?:(\d+) \()?([\d.]+) (B|KB|MB|GB|TB)\)?$")


@dataclass(frozen=True)
class Allocations:
    """Allocations on one device."""

    count: int
    """Allocations made, freed ones as well."""
    peak_bytes: float


class MemoryMeter:
    """Use as a context around building and stepping; then read ``allocations``, or ``used_bytes``
    when all is done."""

    def __init__(self, device: str = "cpu") -> None:
        self._device = wp.get_device(device)

    def __enter__(self) -> MemoryMeter:
        self._pool_before = _pool_bytes(self._device)
        self._text = ""
        self._tracker = wp.ScopedMemoryTracker("benchmark", report_func=self._keep)
        self._tracker.__enter__()
        # The record is the process's: without this its peak would be that of an earlier scene.
        self._tracker.clear()
        return self

    def __exit__(self, *error: Any) -> None:
        self._tracker.__exit__(*error)

    def _keep(self, text: str) -> None:
        self._text = text

    def used_bytes(self) -> float:
        """Peak of the record, or what the device's memory pool has grown by, if that is more."""
        peak = self.allocations().peak_bytes
        return max(peak, _pool_bytes(self._device) - self._pool_before)

    def allocations(self) -> Allocations:
        """What the record says of the whole context."""
        sections: dict[str, dict[str, tuple[int, float]]] = {}
        section = ""
        for line in self._text.splitlines():
            title = line.strip().rstrip(":")
            if title in ("Total allocations", "Peak usage", "Live allocations"):
                section = title
            elif found := _LINE.match(line):
                name, number, size, unit = found.groups()
                sections.setdefault(section, {})[name] = (
                    int(number or 0),
                    float(size) * _UNITS[unit],
                )
        name, none = str(self._device), (0, 0.0)
        return Allocations(
            sections.get("Total allocations", {}).get(name, none)[0],
            sections.get("Peak usage", {}).get(name, none)[1],
        )


def _pool_bytes(device: wp.Device) -> int:
    """Bytes in use in the device's memory pool, 0 where there is no pool."""
    if device.is_cuda and device.is_mempool_enabled:
        return wp.get_mempool_used_mem_current(device)
    return 0


class LaunchCounter:
    """Counts ``wp.launch`` and its kin within its context; kernels inside a captured graph count
    as the one launch that they are for the host."""

    _NAMES = ("launch", "launch_tiled", "capture_launch")

    def __init__(self) -> None:
        self.count = 0
        self.kernels: set[str] = set()
        """Names of the kernels launched, with their modules."""

    def __enter__(self) -> LaunchCounter:
        self._real = {name: getattr(wp, name) for name in self._NAMES}
        self._recorded = wp.Launch.launch
        for name, function in self._real.items():
            setattr(wp, name, self._counted(function))
        counter, recorded = self, self._recorded

        def launch(command: wp.Launch, *arguments: Any, **options: Any) -> Any:
            counter._add(command.kernel)
            return recorded(command, *arguments, **options)

        wp.Launch.launch = launch  # type: ignore[method-assign]
        return self

    def __exit__(self, *error: Any) -> None:
        for name, function in self._real.items():
            setattr(wp, name, function)
        wp.Launch.launch = self._recorded  # type: ignore[method-assign]

    def _counted(self, function: Any) -> Any:
        def call(first: Any = None, *arguments: Any, **options: Any) -> Any:
            if not options.get("record_cmd"):
                self._add(options.get("kernel", first))
            if first is None:
                return function(*arguments, **options)
            return function(first, *arguments, **options)

        return call

    def _add(self, kernel: Any) -> None:
        self.count += 1
        module = getattr(getattr(kernel, "module", None), "name", "")
        self.kernels.add(f"{module}.{getattr(kernel, 'key', type(kernel).__name__)}")
