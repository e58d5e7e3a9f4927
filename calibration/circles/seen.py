# SPDX-License-Identifier: Apache-2.0
"""The contact of one press as its image alone shows it, without ball or scale.

The check of the captures, which may be made before and after the scale is known, and the scale
itself look for the same circles.
"""

from __future__ import annotations

import numpy as np

from taccel_lab.calibration.capture.captures import CapturedPress
from taccel_lab.calibration.circles.contact_finder import detect_contact
from taccel_lab.calibration.circles.result import DetectedContact
from taccel_lab.errors import InputError
from taccel_lab.files.file_cache import content_key
from taccel_lab.geometry import PixelGrid
from taccel_lab.signals.depth_response import Channel


def seen_contact(
    press: CapturedPress,
    background: np.ndarray,
    grid: PixelGrid,
    mask: np.ndarray | None = None,
    grey: Channel | None = None,
) -> DetectedContact:
    """Contact of ``press`` before ``background``, found once; of ``grid`` only the proportions of a
    pixel count. Errors as of ``detect_contact``, with the press's source."""
    ratio = round(grid.mm_per_px_y / grid.mm_per_px_x, 9)
    own = PixelGrid(grid.width_px, grid.height_px, min(1.0, 1 / ratio), min(1.0, ratio))

    def look() -> DetectedContact | InputError:
        try:
            return detect_contact(
                press.image(), background, own, mask=mask, name=press.source, label=press.circle,
                grey=grey, once=press.once,
            )  # fmt: skip
        except InputError as fault:
            return fault

    seen = content_key({"background": background, "mask": mask, "ratio": ratio, "grey": grey})
    found = press.once.of(("contact", seen), look)
    if isinstance(found, InputError):
        raise found
    return found
