# SPDX-License-Identifier: Apache-2.0
"""How long frames take, stage by stage."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np

KEPT = 600
"""Frames that figures are of: the last half minute or so."""


@dataclass
class Latency:
    """Times of the last frames."""

    _frames: deque[dict[str, float]] = field(default_factory=lambda: deque(maxlen=KEPT))
    _ends_s: deque[float] = field(default_factory=lambda: deque(maxlen=KEPT))

    _cpu_s: deque[float] = field(default_factory=lambda: deque(maxlen=KEPT))

    def add(self, stages_s: dict[str, float], cpu_s: float) -> None:
        """A frame is done, whose stages took so long [s], and so long of a core's time."""
        self._frames.append(dict(stages_s))
        self._cpu_s.append(cpu_s)
        self._ends_s.append(time.perf_counter())

    def rate_hz(self) -> float:
        """Frames a second, waiting for the camera among it; 0 before the second one."""
        if len(self._ends_s) < 2:
            return 0.0
        return (len(self._ends_s) - 1) / max(self._ends_s[-1] - self._ends_s[0], 1e-9)

    def figures(self) -> dict[str, Any]:
        """Median and 95th percentile of each stage, of their sum and of a core's time for it [ms],
        which is less where others keep the core busy; the rate [Hz]."""
        names = list(dict.fromkeys(name for frame in self._frames for name in frame))
        stages = {
            name: _spread([frame[name] for frame in self._frames if name in frame])
            for name in names
        }
        busy = [sum(t for name, t in f.items() if name not in NOT_BUSY) for f in self._frames]
        return {
            "frames": len(self._frames),
            "rate_hz": self.rate_hz(),
            "stages_ms": stages,
            "busy_ms": _spread(busy),
            "cpu_ms": _spread(list(self._cpu_s)),
        }


NOT_BUSY = ("wait", "age")
"""Times that are no work: for the camera, and from the moment a frame was taken to its result."""


def _spread(times_s: list[float]) -> dict[str, float]:
    if not times_s:
        return {}
    ms = 1e3 * np.array(times_s)
    return {"median": float(np.median(ms)), "p95": float(np.percentile(ms, 95))}
