# SPDX-License-Identifier: Apache-2.0
"""Pictures of a live reading, drawn fast: no axes, one colour scale a map."""

from __future__ import annotations

import cv2
import numpy as np

from taccel_lab.calibration.live.reader import LiveReading

LEAST_DEEPEST_MM = 0.3
"""The colour scale of the depth ends here at least, so that noise stays dark."""
BEYOND = (225, 60, 160)
"""Pixels beyond the calibration."""
REFUSED = (170, 170, 170)
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
    if reading.markers_px is not None:
        shown.append((f"markers, arrows x{ARROWS:g}", _markers(reading)))
    return shown


def depth_picture(reading: LiveReading) -> tuple[str, np.ndarray]:
    """Title with the scale, and the depth in colours; what the calibration does not reach is
    marked, and a depth that is refused is grey."""
    surface = reading.surface
    assert surface is not None
    depth_mm = -1e3 * surface.rise_m
    deepest = max(float(depth_mm.max()), LEAST_DEEPEST_MM)
    levels = np.clip(255 * depth_mm / deepest, 0, 255).astype(np.uint8)
    picture = cv2.cvtColor(cv2.applyColorMap(levels, cv2.COLORMAP_VIRIDIS), cv2.COLOR_BGR2RGB)
    for marked in (surface.beyond_balls, surface.saturated):
        if marked is not None:
            picture[marked] = BEYOND
    title = f"depth 0 to {deepest:.2f} mm (pink: beyond the calibration)"
    if reading.refused:
        picture[:], title = REFUSED, "depth: rejected"
    return title, picture


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
