# SPDX-License-Identifier: Apache-2.0
"""Whether something touched the gel when the background was taken.

What only the background shows stands, negative, at one place of every press, also of those that
touch the gel elsewhere. The median of the presses shows it as well, but so it does a place where
nearly all presses were made; hence only presses whose own contact lies elsewhere have a say.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from taccel_lab.calibration.capture.captures import CapturedPress
from taccel_lab.calibration.capture.framing import in_light_of, thumb
from taccel_lab.calibration.check.remarks import BACKGROUND_PRESSED
from taccel_lab.report.remark import Remark

MIN_PRESSES = 5
MIN_GHOST_LEVELS = 12.0
GHOST_SHARE = 0.3
"""Strength of the ghost against that of the presses' own contacts."""
GHOST_AREA = 0.25
"""Its area against that of a contact: dust that settled later is smaller."""
AGREE = 0.35
"""Presses that see the ghost differ from each other there by this share of it at most."""
MIN_WITNESSES = 3
MAX_COMPARED = 30
"""Presses that are held against the background."""
OPENING_SHARE = 1 / 40
"""Half width of what is too small for a contact, as a part of the image's shorter side."""


def find_pressed_background(
    background: np.ndarray, presses: Sequence[CapturedPress], mask: np.ndarray | None = None
) -> Remark | None:
    """An error when the background shows a contact that most of the presses do not.

    ``background`` is RGB levels of the presses' size, shape [height_px, width_px, 3]; pixels where
    ``mask`` is false have no effect.
    """
    if len(presses) < MIN_PRESSES:
        return None
    small = thumb(_blanked(background, mask))
    used = np.ones((*small.shape[:2], 1), dtype=np.float32)
    if mask is not None:
        used[thumb(np.repeat(mask[..., None], 3, axis=-1).astype(np.float32)).min(axis=-1) < 1] = 0
    stack = np.stack(
        [
            cv2.GaussianBlur((t - in_light_of(t, small)) * used, (0, 0), 1.0)
            for t in (thumb(_blanked(press.image(), mask)) for press in presses)
        ]
    )
    common = np.median(stack, axis=0)
    size = np.linalg.norm(common, axis=-1)
    apart = np.linalg.norm(stack - common, axis=-1)
    typical = float(np.median([np.percentile(own, 99) for own in apart]))
    floor = max(MIN_GHOST_LEVELS, GHOST_SHARE * typical)
    ghost = _largest_part(size > floor)
    own = apart > floor
    if ghost.sum() < GHOST_AREA * max(1.0, float(np.median(own.sum(axis=(1, 2))))):
        return None
    near = cv2.dilate(ghost.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    elsewhere = (own & ~near).sum(axis=(1, 2)) >= 0.5 * ghost.sum()
    alike = np.median(apart[:, ghost], axis=1) < AGREE * float(np.median(size[ghost]))
    if (elsewhere & alike).sum() < max(MIN_WITNESSES, 0.5 * elsewhere.sum()):
        return None
    rows, columns = np.nonzero(ghost)
    scale = background.shape[1] / small.shape[1]
    return BACKGROUND_PRESSED(
        u=columns.mean() * scale,
        v=rows.mean() * scale,
        count=int((elsewhere & alike).sum()),
        levels=float(np.median(size[ghost])),
    )


def _blanked(image: np.ndarray, mask: np.ndarray | None) -> np.ndarray:
    """Masked pixels take the mean of the others, so that the fit of the levels is hardly moved."""
    if mask is None:
        return image
    return np.where(mask[..., None], image, image[mask].mean(axis=0)).astype(image.dtype)


def _largest_part(found: np.ndarray) -> np.ndarray:
    """The largest connected area that is left by an opening, bool."""
    width = 2 * max(1, round(min(found.shape) * OPENING_SHARE)) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (width, width))
    opened = cv2.morphologyEx(found.astype(np.uint8), cv2.MORPH_OPEN, kernel)
    _, parts, stats, _ = cv2.connectedComponentsWithStats(opened)
    areas = stats[1:, cv2.CC_STAT_AREA]
    return parts == 1 + int(np.argmax(areas)) if len(areas) else np.zeros(found.shape, dtype=bool)
