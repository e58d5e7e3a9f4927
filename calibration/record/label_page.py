# SPDX-License-Identifier: Apache-2.0
"""The page on which labels are clicked: one press at a time, its circle, places on the rim."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.record.labelling import RIM_POINTS, Labelling, Shown
from taccel_lab.calibration.record.page import BLUE, JPEG_QUALITY, PAPER, RED, wide_panel
from taccel_lab.errors import InputError
from taccel_lab.report.page_text import PageText, add_note

if TYPE_CHECKING:
    from viser import ClientHandle, SceneClickEvent, ViserServer

SHEET_PX = 1280
DARK = 25
"""Level of the sheet on a dark page."""
MARGIN_SHARE = 0.03
"""Margin round the image over the width of the sheet."""
_CHANGE_LEVELS = 40.0
"""Change of a level that is drawn in full colour."""
_ASPECT_SLACK = 0.01
_SAID = {
    "clicked": "Circle as clicked earlier (contacts.toml).",
    "label": "Circle as labelled (captures.toml).",
    "found": "No label: the circle is the one found in the image.",
    "none": "No label, and no contact is found in the image.",
    "left out": "Left out of every calibration (contacts.toml).",
}


@dataclass(frozen=True)
class Sheet:
    """An image in the middle of a sheet of some proportions."""

    picture: np.ndarray
    """RGB uint8, [h, w, 3]."""
    left: int
    top: int
    zoom: float
    """Pixels of the sheet in one of the image."""

    def pixel(self, across: float, down: float) -> tuple[float, float]:
        """Pixel (u, v) of the image at a place of the sheet, from 0 to 1 in both directions."""
        height, width = self.picture.shape[:2]
        u = (across * width - self.left) / self.zoom - 0.5
        v = (down * height - self.top) / self.zoom - 0.5
        return u, v

    def place(self, u_px: float, v_px: float) -> tuple[float, float]:
        """Place of the sheet of a pixel; inverse of ``pixel``."""
        height, width = self.picture.shape[:2]
        across = (self.left + (u_px + 0.5) * self.zoom) / width
        down = (self.top + (v_px + 0.5) * self.zoom) / height
        return across, down


def sheet_of(
    image: np.ndarray, aspect: float, labelling: Labelling, shown: Shown, paper: int = PAPER
) -> Sheet:
    """``image`` of a press with its circle (blue), the clicks and the circle through them (red).

    Args:
        image: RGB uint8, [h, w, 3].
        aspect: Width over height of the sheet.
        labelling: Clicks and pixels.
        shown: Press and circle.
        paper: Level round the image.
    """
    height, width = max(64, round(SHEET_PX / aspect)), SHEET_PX
    margin = round(MARGIN_SHARE * width)
    zoom = min((width - 2 * margin) / image.shape[1], (height - 2 * margin) / image.shape[0])
    size = max(1, round(image.shape[1] * zoom)), max(1, round(image.shape[0] * zoom))
    # In a tall window, as on a phone, the panel lies over the lower part.
    left, top = (width - size[0]) // 2, (height - size[1]) // 2 if aspect >= 1 else margin
    picture = np.full((height, width, 3), paper, np.uint8)
    how = cv2.INTER_AREA if zoom < 1 else cv2.INTER_LINEAR
    picture[top : top + size[1], left : left + size[0]] = cv2.resize(image, size, interpolation=how)
    sheet = Sheet(picture, left, top, zoom)
    ratio = labelling.grid.mm_per_px_x / labelling.grid.mm_per_px_y

    def draw(circle: ContactCircle, color: tuple[int, int, int]) -> None:
        across, down = sheet.place(circle.u_px, circle.v_px)
        center = round(across * width), round(down * height)
        axes = round(circle.radius_px * zoom), round(circle.radius_px * ratio * zoom)
        cv2.ellipse(picture, center, axes, 0, 0, 360, (255, 255, 255), 5, cv2.LINE_AA)
        cv2.ellipse(picture, center, axes, 0, 0, 360, color, 2, cv2.LINE_AA)

    if shown.circle is not None:
        draw(shown.circle, BLUE)
    clicked = labelling.circle()
    if clicked is not None:
        draw(clicked, RED)
    for u, v in labelling.clicks:
        across, down = sheet.place(u, v)
        at = round(across * width), round(down * height)
        cv2.circle(picture, at, 7, (255, 255, 255), -1, cv2.LINE_AA)
        cv2.circle(picture, at, 5, RED, -1, cv2.LINE_AA)
    return sheet


def change_of(image: np.ndarray, background: np.ndarray) -> np.ndarray:
    """What a press changes, on grey, RGB uint8 [h, w, 3]."""
    change = image.astype(np.float32) - background.astype(np.float32)
    return np.clip(128 + change * (110 / _CHANGE_LEVELS), 0, 255).astype(np.uint8)


class LabelPage:
    """Buttons and clicks over a ``Labelling``."""

    def __init__(self, server: ViserServer, labelling: Labelling, dark: bool = False) -> None:
        """Fill the page of ``server``; ``dark``: its background."""
        self._server, self._labelling = server, labelling
        self._lock = threading.RLock()
        self.done = threading.Event()
        self._aspect = 4 / 3
        self._sheet: Sheet | None = None
        self._paper = DARK if dark else PAPER
        wide_panel(server, dark)
        gui = server.gui
        self._title = add_note(gui)
        names = [press.name for press in labelling.folder.presses]
        self._choice = gui.add_dropdown("Press", names, initial_value=names[0])
        self._choice.on_update(lambda _: self._act(self._choose))
        steps = gui.add_button_group("", ["Previous", "Next"])
        steps.on_click(lambda event: self._act(lambda: self._step(event.target.value)))
        self._change = gui.add_checkbox("Show the change", initial_value=True)
        self._change.on_update(lambda _: self._act(lambda: None))
        for label, order in (
            ("Save circle", self._save),
            ("Take the clicks back", labelling.clicks.clear),
            ("Leave this press out", self._leave_out),
        ):
            gui.add_button(label).on_click(lambda _, order=order: self._act(order))
        gui.add_button("Done", color="gray").on_click(lambda _: self.done.set())
        self._told = add_note(gui)
        server.scene.on_click()(self._clicked)
        server.on_client_connect(self._joined)
        self._act(lambda: None)

    def place(self, u_px: float, v_px: float) -> tuple[float, float]:
        """Place of a pixel in the window, from 0 to 1 in both directions."""
        with self._lock:
            assert self._sheet is not None  # Drawn before the page is there.
            return self._sheet.place(u_px, v_px)

    def _act(self, order: Callable[[], object]) -> None:
        """Do what was asked for, say what came of it, and draw."""
        with self._lock:
            try:
                words = order()
            except InputError as error:
                words = f"Not saved: {error}"
            self._told.content = PageText.escape(words if isinstance(words, str) else "")
            self._draw()

    def _choose(self) -> None:
        names = [press.name for press in self._labelling.folder.presses]
        if names[self._labelling.at] != self._choice.value:
            self._labelling.go(names.index(self._choice.value))

    def _step(self, word: str) -> None:
        self._labelling.go(self._labelling.at + (1 if word == "Next" else -1))
        self._choice.value = self._labelling.press.name

    def _save(self) -> str:
        circle = self._labelling.save()
        return (
            f"Saved: centre ({circle.u_px:.1f}, {circle.v_px:.1f}) px, radius "
            f"{circle.radius_px:.1f} px, in {self._labelling.path}"
        )

    def _leave_out(self) -> str:
        self._labelling.leave_out()
        return f"Left out, in {self._labelling.path}. A saved circle brings the press back"

    def _joined(self, client: ClientHandle) -> None:
        client.camera.on_update(self._turned)

    def _turned(self, camera: object) -> None:
        """Draw anew where the window has other proportions."""
        aspect = float(np.clip(getattr(camera, "aspect", 0.0) or self._aspect, 0.4, 4.0))
        if abs(aspect / self._aspect - 1) > _ASPECT_SLACK:
            with self._lock:
                self._aspect = aspect
                self._draw()

    def _clicked(self, event: SceneClickEvent) -> None:
        with self._lock:
            if self._sheet is None:
                return
            across, down = event.screen_pos
            self._labelling.click(*self._sheet.pixel(across, down))
            self._told.content = PageText.escape("")
            self._draw()

    def _draw(self) -> None:
        labelling, shown = self._labelling, self._labelling.shown()
        image = shown.press.image()
        if self._change.value:
            image = change_of(image, labelling.folder.require_background().image())
        self._sheet = sheet_of(image, self._aspect, labelling, shown, self._paper)
        self._server.scene.set_background_image(
            self._sheet.picture, format="jpeg", jpeg_quality=JPEG_QUALITY
        )
        left = RIM_POINTS - len(labelling.clicks)
        more = (
            f"Click {left} places on the rim of the contact."
            if left > 0
            else "Save the red circle, or click more of the rim."
        )
        text = PageText("## {}: {} of {}\n\n{}\n\n**{}**")
        self._title.content = text.format(
            shown.press.name,
            labelling.at + 1,
            len(labelling.folder.presses),
            _SAID[shown.origin],
            more,
        )
