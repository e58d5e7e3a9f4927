# SPDX-License-Identifier: Apache-2.0
"""The page of a session in the browser: what the camera sees, what to press, what is wrong."""

from __future__ import annotations

import queue
import time
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.calibration.record.facts import QUICK_LEAVES_OUT
from taccel_lab.calibration.record.lamps import Lamp
from taccel_lab.calibration.record.pictures import change_picture, coverage_picture
from taccel_lab.calibration.record.run import Order
from taccel_lab.calibration.record.session import SessionStatus
from taccel_lab.calibration.record.tiles import show_tiles, wide_panel
from taccel_lab.report.page_text import PageText, add_html_note, add_note

if TYPE_CHECKING:
    from viser import ViserServer

EVERY_S = 0.1
"""Time between two pictures on the page; frames in between are looked at all the same."""


LAMP_COLORS = {"ok": "#2ea05a", "warn": "#dea532", "bad": "#d0453a", "unknown": "#9a9a9a"}


class RecordPage:
    """A ``Watcher`` with buttons."""

    def __init__(self, server: ViserServer, quick: bool = False) -> None:
        """Fill the page of ``server``."""
        self._orders: queue.Queue[Order] = queue.Queue()
        self._shown_s, self._taken = float("-inf"), -1
        self._server = server
        wide_panel(server)
        gui = server.gui
        self._prompt = add_note(gui)
        self._bar = gui.add_progress_bar(0.0, color="blue")
        self._button("Take now", "take", "CAMERA")
        self._button("Undo last", "undo", "ARROW_BACK_UP")
        self._button("Finish", "finish", "CHECK")
        self._lamps = add_html_note(gui)
        blank = np.full((120, 160, 3), 245, np.uint8)
        self._coverage = gui.add_image(blank, label="Presses by place", format="png")
        self._messages = add_note(gui)
        if quick:
            with gui.add_folder("What a quick session leaves out", expand_by_default=False):
                add_note(gui, _items(QUICK_LEAVES_OUT))

    def show(self, status: SessionStatus) -> None:
        """Bring the page up to date, not more often than it can be looked at."""
        now = time.monotonic()
        if now - self._shown_s < EVERY_S and not status.finished:
            return
        self._shown_s = now
        if status.image is not None:
            show_tiles(self._server, [("camera", status.image), ("change", change_picture(status))])
        prompt = PageText("## {} of {}\n\n**{}**")
        self._prompt.content = prompt.format(status.taken, status.wanted, status.prompt)
        self._bar.value = 100.0 * min(status.taken / max(status.wanted, 1), 1.0)
        self._lamps.content = _lamps_html(status.lamps)
        self._messages.content = _items(status.messages)
        key = hash((status.circles, status.advice, status.finished))
        if key != self._taken:
            self._coverage.image, self._taken = coverage_picture(status), key

    def orders(self) -> list[Order]:
        """Buttons that were pressed since the last call."""
        given: list[Order] = []
        while not self._orders.empty():
            given.append(self._orders.get())
        return given

    def _button(self, label: str, order: Order, icon: str) -> None:
        import viser

        handle = self._server.gui.add_button(label, icon=getattr(viser.Icon, icon))

        @handle.on_click
        def _(_: object) -> None:
            self._orders.put(order)


def _items(lines: Iterable[str]) -> PageText:
    return PageText("\n").join(PageText("- {}").format(line) for line in lines)


def _lamps_html(lamps: tuple[Lamp, ...]) -> PageText:
    row = PageText(
        '<div style="display:flex;gap:8px;margin:4px 12px;font-size:13px">'
        '<span style="color:{}">&#9679;</span><span><b>{}</b> {}</span></div>'
    )
    return PageText().join(
        row.format(PageText(LAMP_COLORS[lamp.state]), lamp.name, lamp.text) for lamp in lamps
    )
