# SPDX-License-Identifier: Apache-2.0
"""Several pictures in one, as large as a window of some proportions lets them be."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from viser import ViserServer

PAPER, INK = 250, (60, 60, 60)
TITLE_PX, MARGIN_PX, TITLE_SCALE = 26, 8, 0.5
WIDTH_PX = 960
JPEG_QUALITY = 85


def tiled(
    pictures: Sequence[tuple[str, np.ndarray]], aspect: float, width_px: int = WIDTH_PX
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
        text = min(TITLE_SCALE, TITLE_SCALE * (room - MARGIN_PX) / _title_px(title))
        where = (left, top - 8)
        cv2.putText(sheet, title, where, cv2.FONT_HERSHEY_SIMPLEX, text, INK, 1, cv2.LINE_AA)
    return sheet


def _title_px(title: str) -> int:
    return cv2.getTextSize(title, cv2.FONT_HERSHEY_SIMPLEX, TITLE_SCALE, 1)[0][0]


def _zoom(image: np.ndarray, sheet: np.ndarray, columns: int, rows: int) -> float:
    wide = sheet.shape[1] / columns - 2 * MARGIN_PX
    high = sheet.shape[0] / rows - TITLE_PX - MARGIN_PX
    return max(min(wide / image.shape[1], high / image.shape[0]), 1e-3)


def wide_panel(server: ViserServer) -> None:
    """A panel as wide as there is, always there: it has pictures of its own."""
    server.gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
    server.gui.main_panel.dock_right()


def show_tiles(server: ViserServer, pictures: Sequence[tuple[str, np.ndarray]]) -> None:
    """Show pictures in all the room that the panel leaves, in the window opened last."""
    aspect = 4 / 3
    for client in server.get_clients().values():
        aspect = client.camera.aspect or aspect
    sheet = tiled(pictures, float(np.clip(aspect, 0.4, 4.0)))
    server.scene.set_background_image(sheet, format="jpeg", jpeg_quality=JPEG_QUALITY)
