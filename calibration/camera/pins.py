# SPDX-License-Identifier: Apache-2.0
"""Boards of pins or holes that are pressed into the gel and seen by what they change."""

from __future__ import annotations

import numpy as np

from taccel_lab.calibration.camera.board import BoardView
from taccel_lab.calibration.camera.dots import detect_dots
from taccel_lab.errors import InputError

MIN_CHANGE_LEVELS = 1.0
"""Least 99th percentile of the change that counts as a press [levels of 255]."""


def detect_pins(
    image: np.ndarray,
    columns: int,
    rows: int,
    *,
    reference: np.ndarray | None,
    name: str = "image",
) -> BoardView:
    """Find a pressed board of ``columns`` x ``rows`` pins or holes; as ``detect_dots``.

    Raises:
        InputError: No ``reference`` of the untouched gel, no press, or too few dents on a lattice.
    """
    if reference is None:
        raise InputError(
            f"{name}: a pressed board shows only against an image of the untouched gel; give "
            'reference = "..." for this board, or background = "..." for the folder'
        )
    if reference.shape == image.shape:
        change = np.abs(np.asarray(image, dtype=np.float32) - reference)
        change = np.abs(change - np.median(change, axis=(0, 1))).max(axis=2)
        strongest = float(np.percentile(change, 99))
        if strongest < MIN_CHANGE_LEVELS:
            raise InputError(
                f"{name}: nothing is pressed into the gel; the strongest change against the "
                f"reference is {strongest:.2f} levels of 255, at least {MIN_CHANGE_LEVELS:g}"
            )
    return detect_dots(image, columns, rows, reference=reference, name=name)
