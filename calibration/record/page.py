# SPDX-License-Identifier: Apache-2.0
"""The page of a session in the browser: what the camera sees, what to press, what is wrong.

Several pictures are one sheet, as large as a window of some proportions lets them be.
"""

from __future__ import annotations

import queue
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import cv2
import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.capture.coverage import CELLS, cell_of
from taccel_lab.calibration.record.folder import QUICK_LEAVES_OUT
from taccel_lab.calibration.record.lamps import Lamp
from taccel_lab.calibration.record.session import Order, SessionStatus
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


WIDTH_PX = 640
TALLEST = 0.75
"""Height over width that a picture of the panel has at most."""
NOISE_SHOWN = 12.0
"""Times the noise that a change has at least where it is drawn in full colour."""
GREEN, AMBER, RED, BLUE, GREY = (
    (46, 160, 90),
    (222, 165, 50),
    (200, 90, 80),
    (50, 100, 210),
    (120, 120, 120),
)


def change_picture(status: SessionStatus) -> np.ndarray:
    """The colour change on grey, the contact circle over it, RGB uint8 [h, WIDTH_PX, 3]."""
    if status.image is None:
        return np.full((WIDTH_PX * 3 // 4, WIDTH_PX, 3), 40, np.uint8)
    size = (WIDTH_PX, round(WIDTH_PX * status.image.shape[0] / status.image.shape[1]))
    if status.change is None:
        return cv2.resize(status.image, size, interpolation=cv2.INTER_AREA)
    largest = float(np.abs(status.change).max())
    gain = 110.0 / max(largest, NOISE_SHOWN * status.noise_levels, 1e-6)
    picture = np.clip(128 + gain * cv2.resize(status.change, size), 0, 255).astype(np.uint8)
    if status.circle is not None:
        _circle(picture, status.circle, status.image.shape, (255, 255, 255), 2)
    return picture


def coverage_picture(status: SessionStatus) -> np.ndarray:
    """Cells by their number of presses, all contacts, and the cell to press next.

    RGB uint8, shape [h, WIDTH_PX, 3]."""
    height, width = (3, 4) if status.image is None else status.image.shape[:2]
    high = min(round(WIDTH_PX * height / width), round(WIDTH_PX * TALLEST))
    size = (round(high * width / height), high)
    picture = np.full((size[1], size[0], 3), 245, np.uint8)
    found = [circle for circle in status.circles if circle is not None]
    made = Counter(cell_of(circle, width, height) for circle in found)
    enough = max(1, round(status.wanted / (CELLS[0] * CELLS[1])))
    xs, ys = (
        np.linspace(0, n, k + 1).round().astype(int) for n, k in zip(size, CELLS, strict=True)
    )
    for column in range(CELLS[0]):
        for row in range(CELLS[1]):
            count = made[column, row]
            tint = GREEN if count >= enough else AMBER if count else RED
            part = picture[ys[row] : ys[row + 1], xs[column] : xs[column + 1]]
            part[:] = (0.72 * 255 + 0.28 * np.array(tint)).astype(np.uint8)
            corner = (int(xs[column]) + 10, int(ys[row]) + 28)
            cv2.putText(picture, str(count), corner, cv2.FONT_HERSHEY_SIMPLEX, 0.8, GREY, 2)
    for circle in found:
        _circle(picture, circle, (height, width), (60, 60, 60), 1)
    if status.advice is not None and not status.finished:
        column, row = status.advice.cell
        first = (int(xs[column]) + 3, int(ys[row]) + 3)
        last = (int(xs[column + 1]) - 4, int(ys[row + 1]) - 4)
        cv2.rectangle(picture, first, last, BLUE, 4)
        if status.advice.radius_px is not None:
            middle = ((first[0] + last[0]) // 2, (first[1] + last[1]) // 2)
            cv2.circle(picture, middle, round(status.advice.radius_px * size[0] / width), BLUE, 2)
    beside = (WIDTH_PX - size[0]) // 2
    sides = ((0, 0), (beside, WIDTH_PX - size[0] - beside), (0, 0))
    return np.pad(picture, sides, constant_values=255)


def _circle(
    picture: np.ndarray,
    circle: ContactCircle,
    shape: tuple[int, ...],
    color: tuple[int, int, int],
    thickness: int,
) -> None:
    zoom = picture.shape[1] / shape[1]
    center = (round((circle.u_px + 0.5) * zoom), round((circle.v_px + 0.5) * zoom))
    cv2.circle(picture, center, round(circle.radius_px * zoom), color, thickness, cv2.LINE_AA)


PAPER, INK = 250, (60, 60, 60)
TITLE_PX, MARGIN_PX, TITLE_SCALE = 26, 8, 0.5
SHEET_PX = 960
JPEG_QUALITY = 85


def tiled(
    pictures: Sequence[tuple[str, np.ndarray]], aspect: float, width_px: int = SHEET_PX
) -> np.ndarray:
    """Pictures with their titles on one sheet, RGB uint8, shape [width_px / aspect, width_px, 3].

    Args:
        pictures: Title and RGB uint8 [h, w, 3] of each, of any proportions.
        aspect: Width over height of the sheet.
        width_px: Its width.
    """
    sheet = np.full((max(64, round(width_px / aspect)), width_px, 3), PAPER, np.uint8)
    count = len(pictures)
    columns = max(
        range(1, count + 1),
        key=lambda n: min(_zoom(image, sheet, n, -(-count // n)) for _, image in pictures),
    )
    rows = -(-count // columns)
    for k, (title, image) in enumerate(pictures):
        zoom = _zoom(image, sheet, columns, rows)
        size = max(1, int(image.shape[1] * zoom)), max(1, int(image.shape[0] * zoom))
        how = cv2.INTER_AREA if zoom < 1 else cv2.INTER_LINEAR
        wide, high = sheet.shape[1] // columns, sheet.shape[0] // rows
        left = (k % columns) * wide + (wide - size[0]) // 2
        top = (k // columns) * high + TITLE_PX + max(0, (high - TITLE_PX - size[1]) // 2)
        sheet[top : top + size[1], left : left + size[0]] = cv2.resize(
            image, size, interpolation=how
        )[: sheet.shape[0] - top]
        room = sheet.shape[1] - left if k % columns == columns - 1 else wide
        title_px = cv2.getTextSize(title, cv2.FONT_HERSHEY_SIMPLEX, TITLE_SCALE, 1)[0][0]
        text = min(TITLE_SCALE, TITLE_SCALE * (room - MARGIN_PX) / title_px)
        where = (left, top - 8)
        cv2.putText(sheet, title, where, cv2.FONT_HERSHEY_SIMPLEX, text, INK, 1, cv2.LINE_AA)
    return sheet


def _zoom(image: np.ndarray, sheet: np.ndarray, columns: int, rows: int) -> float:
    wide = sheet.shape[1] / columns - 2 * MARGIN_PX
    high = sheet.shape[0] / rows - TITLE_PX - MARGIN_PX
    return max(min(wide / image.shape[1], high / image.shape[0]), 1e-3)


def wide_panel(server: ViserServer, dark: bool = False) -> None:
    """A panel as wide as there is, always there: it has pictures of its own."""
    server.gui.configure_theme(
        control_width="large", dark_mode=dark, show_logo=False, show_share_button=False
    )
    server.gui.main_panel.dock_right()


def show_tiles(server: ViserServer, pictures: Sequence[tuple[str, np.ndarray]]) -> None:
    """Show pictures in all the room that the panel leaves, in the window opened last."""
    aspect = 4 / 3
    for client in server.get_clients().values():
        aspect = client.camera.aspect or aspect
    sheet = tiled(pictures, float(np.clip(aspect, 0.4, 4.0)))
    server.scene.set_background_image(sheet, format="jpeg", jpeg_quality=JPEG_QUALITY)
