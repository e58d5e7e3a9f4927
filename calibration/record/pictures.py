# SPDX-License-Identifier: Apache-2.0
"""Pictures of a session: the change with the contact in it, and where presses were."""

from __future__ import annotations

from collections import Counter

import cv2
import numpy as np

from taccel_lab.calibration.capture.captures import ContactCircle
from taccel_lab.calibration.capture.coverage import CELLS, cell_of
from taccel_lab.calibration.record.session import SessionStatus

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
