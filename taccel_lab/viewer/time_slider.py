# SPDX-License-Identifier: Apache-2.0
"""A slider over states with play, stop and steps."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from viser import ViserServer

FRAMES_PER_S = 8.0


class TimeSlider:
    """Calls ``show(state)`` whenever another state is chosen or played."""

    def __init__(self, server: ViserServer, count: int, show: Callable[[int], None]) -> None:
        self._count, self._show = count, show
        self._playing = threading.Event()
        self._slider = server.gui.add_slider("step", 0, max(count - 1, 1), 1, 0)
        self._buttons = server.gui.add_button_group("", ("first", "play", "stop", "last"))
        self._slider.on_update(lambda _: self._show(min(self.state, self._count - 1)))
        self._buttons.on_click(lambda event: self._pressed(event.target.value))

    @property
    def state(self) -> int:
        """Which is shown."""
        return int(self._slider.value)

    def set(self, state: int) -> None:
        """Show a state; the slider follows."""
        self._slider.value = int(state)

    def resize(self, count: int, state: int = 0) -> None:
        """Another row of states, of which ``state`` is shown."""
        self._playing.clear()
        self._count = count
        self._slider.max = max(count - 1, 1)
        self.set(min(state, count - 1))

    def _pressed(self, button: str) -> None:
        playing = self._playing.is_set()
        self._playing.clear()
        if button == "play" and not playing:
            self._playing.set()
            threading.Thread(target=self._play, daemon=True).start()
        elif button in ("first", "last"):
            self.set(0 if button == "first" else self._count - 1)

    def _play(self) -> None:
        pause = threading.Event()
        while self._playing.is_set():
            self.set((self.state + 1) % self._count)
            pause.wait(1 / FRAMES_PER_S)
