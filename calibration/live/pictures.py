# SPDX-License-Identifier: Apache-2.0
"""Pictures of a live reading, drawn fast: no axes, one colour scale with its numbers a map."""

from __future__ import annotations

import cv2
import numpy as np

from taccel_lab.calibration.live.reader import LiveReading
from taccel_lab.calibration.pressure.contact_pressure import ContactPressure

LEAST_DEEPEST_MM = 0.3
"""The colour scale of the depth ends here at least, so that noise stays dark."""
BEYOND = (225, 60, 160)
"""Pixels beyond the calibration."""
REFUSED = (170, 170, 170)
LEAST_PRESSURE_PA = 1e4
"""The colour scale of the pressure ends here at least."""
PAPER, INK = 250, (60, 60, 60)
ARROWS = 3.0
"""Times the markers' displacement."""


def pictures(reading: LiveReading, background: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Title and RGB uint8 picture of all that was read."""
    change = reading.image.astype(np.int16) - background.astype(np.int16)
    shown = [
        ("camera", reading.image),
        ("change", np.clip(128 + 2 * change, 0, 255).astype(np.uint8)),
    ]
    if reading.surface is not None:
        shown += [depth_picture(reading), ("normals", _normals(reading.surface.normals))]
        if reading.press is not None:
            shown.append(pressure_picture(reading.press))
    if reading.markers_px is not None:
        shown.append((f"markers, arrows x{ARROWS:g}", _markers(reading)))
    return shown


def depth_picture(reading: LiveReading) -> tuple[str, np.ndarray]:
    """Title with the scale, and the depth in colours; what the calibration does not reach is
    marked, and a depth that is rejected is grey."""
    surface = reading.surface
    assert surface is not None
    depth_mm = -1e3 * surface.rise_m
    deepest = max(float(depth_mm.max()), LEAST_DEEPEST_MM)
    levels = np.clip(255 * depth_mm / deepest, 0, 255).astype(np.uint8)
    picture = _colored(levels, cv2.COLORMAP_VIRIDIS)
    for marked in (surface.beyond_balls, surface.saturated):
        if marked is not None:
            picture[marked] = BEYOND
    if reading.refused:
        picture[:] = REFUSED
        return "depth: rejected", picture
    title = "depth [mm] (pink: beyond the calibration)"
    return title, _with_bar(picture, cv2.COLORMAP_VIRIDIS, deepest)


def pressure_picture(press: ContactPressure) -> tuple[str, np.ndarray]:
    """Title and the contact pressure in colours."""
    peak = max(float(press.pressure_pa.max()), LEAST_PRESSURE_PA)
    levels = np.clip(255 * press.pressure_pa / peak, 0, 255).astype(np.uint8)
    picture = _colored(levels, cv2.COLORMAP_INFERNO)
    return "pressure [kPa]", _with_bar(picture, cv2.COLORMAP_INFERNO, 1e-3 * peak)


def _colored(levels: np.ndarray, colors: int) -> np.ndarray:
    return cv2.cvtColor(cv2.applyColorMap(levels, colors), cv2.COLOR_BGR2RGB)


def _with_bar(picture: np.ndarray, colors: int, high: float) -> np.ndarray:
    """The picture with its colour bar from 0 to ``high`` on the right."""
    height = picture.shape[0]
    text = max(0.3, height / 600)
    wide = max(6, height // 24)
    bar = np.full((height, wide + round(110 * text), 3), PAPER, np.uint8)
    levels = np.linspace(255, 0, height).astype(np.uint8)[:, None]
    bar[:, 2 : 2 + wide] = _colored(np.repeat(levels, wide, axis=1), colors)
    digits = 0 if high >= 20 else 2
    for share in (0.0, 0.5, 1.0):
        row = round((1 - share) * (height - 1))
        where = (wide + 6, min(max(row + round(10 * text), round(24 * text)), height - 2))
        label = f"{share * high:.{digits}f}"
        cv2.putText(bar, label, where, cv2.FONT_HERSHEY_SIMPLEX, text, INK, 1, cv2.LINE_AA)
    return np.hstack([picture, bar])


def _normals(normals: np.ndarray) -> np.ndarray:
    return np.clip(127.5 * (normals + 1.0), 0, 255).astype(np.uint8)


def _markers(reading: LiveReading) -> np.ndarray:
    picture = reading.image.copy()
    assert reading.markers_px is not None
    assert reading.rest_px is not None
    assert reading.seen is not None
    for place, rest, seen in zip(reading.markers_px, reading.rest_px, reading.seen, strict=True):
        if not np.isfinite(place).all():
            continue
        tip = rest + ARROWS * (place - rest)
        color = (255, 220, 0) if seen else (160, 160, 160)
        ends = [(round(float(u)), round(float(v))) for u, v in (rest, tip)]
        cv2.arrowedLine(picture, ends[0], ends[1], color, 1, cv2.LINE_AA, tipLength=0.3)
    return picture
