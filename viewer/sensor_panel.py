# SPDX-License-Identifier: Apache-2.0
"""The sensor's image beside the gel, with its markers and their motion drawn on it."""

from __future__ import annotations

from contextlib import nullcontext
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.report.page_text import add_note
from taccel_lab.viewer.gel_states import SensorImages

if TYPE_CHECKING:
    from viser import ViserServer

MARKER_RGB = (255, 221, 51)
WIDTH_PX = 480
"""Least width at which images are drawn; smaller ones are enlarged by a whole number."""

BLANK = np.full((4, 4, 3), 128, dtype=np.uint8)


class SensorPanel:
    """A window of its own; hidden where there is no image."""

    def __init__(
        self,
        server: ViserServer,
        title: str = "Sensor image",
        single: str = "Only the image of the end was kept.",
        own_panel: bool = True,
    ) -> None:
        """``single``: what is said of an image that is the only one. ``own_panel``: in a window of
        its own, else where the page is being filled."""
        self._single = single
        self.panel = server.gui.add_panel(visible=False) if own_panel else None
        with nullcontext() if self.panel is None else self.panel.add_tab(title):
            self._image = server.gui.add_image(BLANK, format="png")
            self._note = add_note(server.gui)
            self._markers = server.gui.add_checkbox("show markers and their motion", True)
            self._times = server.gui.add_slider("motion of markers times", 1, 10, 1, 3)
        if self.panel is not None:
            self.panel.dock_left()
            self.panel.set_width(330)
        self._shown: tuple[SensorImages | None, int] = (None, 0)
        for control in (self._markers, self._times):
            control.on_update(lambda _: self.show(*self._shown))

    def show(self, images: SensorImages | None, state: int) -> None:
        """Show the image of a state; nothing where there are none."""
        self._shown = (images, state)
        if self.panel is not None:
            self.panel.visible = images is not None
        if images is None:
            return
        row = min(state, len(images.rgb) - 1)
        factor = float(self._times.value) if self._markers.value else None
        self._image.image = drawn(images, row, factor)
        there = images.markers_px is not None
        self._markers.visible = self._times.visible = there
        note = self._single if len(images.rgb) == 1 else ""
        if there and factor is not None:
            note += f"Arrows are the motion of the markers since rest, {factor:g} times."
        self._note.content = note

    def clear(self, note: str) -> None:
        """Take the image away, and say why."""
        self._shown = (None, 0)
        self._image.image, self._note.content = BLANK, note


def drawn(images: SensorImages, row: int, factor: float | None) -> np.ndarray:
    """The image of a state, uint8 [height, width, 3], with its markers where they were at rest and
    arrows of ``factor`` times their motion; without them when None."""
    rgb = images.rgb[row]
    enlarged = max(1, round(WIDTH_PX / rgb.shape[1]))
    rgb = np.ascontiguousarray(rgb.repeat(enlarged, axis=0).repeat(enlarged, axis=1))
    if images.markers_px is None or factor is None:
        return rgb
    import cv2

    rest = (images.markers_px[0] + 0.5) * enlarged - 0.5
    moved = factor * (images.markers_px[row] - images.markers_px[0]) * enlarged
    known = np.isfinite(rest).all(axis=1) & np.isfinite(moved).all(axis=1)
    for start, motion in zip(rest[known], moved[known], strict=True):
        place, end = np.round(start).astype(int), np.round(start + motion).astype(int)
        cv2.circle(rgb, place.tolist(), 3, MARKER_RGB, 1, cv2.LINE_AA)
        if np.linalg.norm(motion) >= 1:
            cv2.arrowedLine(rgb, place.tolist(), end.tolist(), MARKER_RGB, 1, cv2.LINE_AA, 0, 0.35)
    return rgb
