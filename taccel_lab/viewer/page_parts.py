# SPDX-License-Identifier: Apache-2.0
"""What pages share: where they look from at first and the light that they have, a slider over time,
and the image of the sensor beside the gel.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import nullcontext
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.report.page_text import add_html_note, add_note
from taccel_lab.viewer.arrows import round_length
from taccel_lab.viewer.gel_states import Field, SensorImages
from taccel_lab.viewer.painting import bar_html, map_rgb, shares

if TYPE_CHECKING:
    from viser import ViserServer

DIRECTION = (0.35, -1.0, 0.75)
"""Direction from which a gel is seen: from the front, right and above; z is up."""


def add_axes(server: ViserServer, corner_mm: np.ndarray, length_mm: float) -> None:
    """The axes of the gel frame at a corner, each ``length_mm`` long, with their names."""
    colors = ((213, 60, 50), (0, 158, 115), (0, 114, 178))
    for axis, (name, color) in enumerate(zip("xyz", colors, strict=True)):
        end = corner_mm + length_mm * np.eye(3)[axis]
        server.scene.add_arrows(
            f"/axes/{name}", np.stack([corner_mm, end])[None], color,
            shaft_radius=0.03 * length_mm, head_radius=0.08 * length_mm,
            head_length=0.2 * length_mm,
        )  # fmt: skip
        text = f"{name}, {length_mm:g} mm" if name == "x" else name
        server.scene.add_label(f"/axes/{name}/label", text, position=tuple(end))


def look_at(
    server: ViserServer,
    points_mm: np.ndarray,
    direction: tuple[float, float, float] = DIRECTION,
    distance: float = 1.6,
) -> None:
    """Point the view of a page at the middle of points [n, 3], ``distance`` times their extent
    away."""
    low, high = points_mm.min(axis=0), points_mm.max(axis=0)
    middle, size = (low + high) / 2, float(np.linalg.norm(high - low))
    toward = np.asarray(direction) / np.linalg.norm(direction)
    scene = server.scene
    scene.set_up_direction("+z")
    scene.configure_default_lights(cast_shadow=False)
    server.gui.main_panel.dock_right()
    # Above the far left corner, where nothing hides them and no panel is.
    corner = np.array([low[0], high[1], high[2] + 0.04 * size])
    add_axes(server, corner, round_length(0.15 * size))
    camera = server.initial_camera
    camera.position = middle + distance * size * toward
    camera.look_at = middle
    camera.fov = float(np.radians(38))
    for client in server.get_clients().values():
        client.camera.position = tuple(camera.position)
        client.camera.look_at = tuple(middle)


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


MARKER_RGB = (255, 221, 51)
WIDTH_PX = 480
"""Least width at which images are drawn; smaller ones are enlarged by a whole number."""

IMAGE: str = "tactile image"
COLORS = "viridis"
BESIDE_RGB = 128
"""Grey of pixels beside the gel."""
BLANK = np.full((4, 4, 3), 128, dtype=np.uint8)


class SensorPanel:
    """A window; hidden where there is no image."""

    def __init__(
        self,
        server: ViserServer,
        title: str = "Sensor image",
        single: str = "Only the image of the end was kept.",
        own_panel: bool = True,
    ) -> None:
        """``single``: what is said of an image that is the only one. ``own_panel``: in its own
        window, else where the page is being filled."""
        self._single = single
        self.panel = server.gui.add_panel(visible=False) if own_panel else None
        with nullcontext() if self.panel is None else self.panel.add_tab(title):
            self._choice = server.gui.add_dropdown("shows", (IMAGE,), visible=False)
            self._image = server.gui.add_image(BLANK, format="png")
            self._bar = add_html_note(server.gui, visible=False)
            self._note = add_note(server.gui)
            self._markers = server.gui.add_checkbox("show markers and their motion", True)
            self._times = server.gui.add_slider("motion of markers times", 1, 10, 1, 3)
        if self.panel is not None:
            self.panel.dock_left()
            self.panel.set_width(330)
        self._shown: tuple[SensorImages | None, int] = (None, 0)
        for control in (self._choice, self._markers, self._times):
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
        labels = (IMAGE, *(one.label for one in images.maps))
        if tuple(self._choice.options) != labels:
            self._choice.options, self._choice.visible = labels, len(labels) > 1
        shown = next((one for one in images.maps if one.label == self._choice.value), None)
        pixels = images.rgb[row] if shown is None else map_pixels(shown, row)
        self._bar.visible = shown is not None
        if shown is not None:
            self._bar.content = bar_html(shown.label, shown.unit, shown.limits(), map_rgb(COLORS))
        self._image.image = drawn(pixels, images.markers_px, row, factor)
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


def map_pixels(field: Field, row: int) -> np.ndarray:
    """A map of a state in the colours of its bar, uint8 [height, width, 3]; grey where unknown."""
    values = field.values[row]
    index = np.round(255 * shares(values, field.limits())).astype(int)
    return np.where(np.isfinite(values)[..., None], map_rgb(COLORS)[index], BESIDE_RGB).astype(
        np.uint8
    )


def drawn(
    rgb: np.ndarray, markers_px: np.ndarray | None, row: int, factor: float | None
) -> np.ndarray:
    """An image, uint8 [height, width, 3], with markers where they were at rest and arrows of
    ``factor`` times their motion in a state.

    Args:
        rgb: The image, uint8 [height, width, 3].
        markers_px: [state, marker, 2], at rest in the first; None for none.
        row: The state.
        factor: None leaves them out.
    """
    enlarged = max(1, round(WIDTH_PX / rgb.shape[1]))
    rgb = np.ascontiguousarray(rgb.repeat(enlarged, axis=0).repeat(enlarged, axis=1))
    if markers_px is None or factor is None:
        return rgb
    import cv2

    rest = (markers_px[0] + 0.5) * enlarged - 0.5
    moved = factor * (markers_px[row] - markers_px[0]) * enlarged
    known = np.isfinite(rest).all(axis=1) & np.isfinite(moved).all(axis=1)
    for start, motion in zip(rest[known], moved[known], strict=True):
        place, end = np.round(start).astype(int), np.round(start + motion).astype(int)
        cv2.circle(rgb, place.tolist(), 3, MARKER_RGB, 1, cv2.LINE_AA)
        if np.linalg.norm(motion) >= 1:
            cv2.arrowedLine(rgb, place.tolist(), end.tolist(), MARKER_RGB, 1, cv2.LINE_AA, 0, 0.35)
    return rgb
