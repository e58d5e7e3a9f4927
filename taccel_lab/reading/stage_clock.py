# SPDX-License-Identifier: Apache-2.0
"""The time that each stage of a reading takes."""

from __future__ import annotations

import time


class StageClock:
    """Counts time to one stage after another."""

    def __init__(self) -> None:
        self.stages_s: dict[str, float] = {}
        """Time of each stage so far [s], in the order in which they began."""
        self._stage, self._since_s = "", 0.0

    def restart(self) -> None:
        """Forget all times, for the next image."""
        self.stages_s, self._stage = {}, ""

    def begin(self, stage: str = "") -> None:
        """Count time to ``stage`` from now on, and to none where it is empty."""
        now_s = time.perf_counter()
        if self._stage:
            self.stages_s[self._stage] += now_s - self._since_s
        if stage:
            self.stages_s.setdefault(stage, 0.0)
        self._stage, self._since_s = stage, now_s
