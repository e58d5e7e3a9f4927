# SPDX-License-Identifier: Apache-2.0
"""One frame of a recording, whatever file it comes from."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from taccel_lab.errors import InputError


class RecordedFrame(NamedTuple):
    """A frame, when it was taken, or why it cannot be read."""

    name: str
    """Name by which the file tells it from others."""
    image: np.ndarray | InputError
    """RGB uint8, shape [height_px, width_px, 3], or why there is none."""
    time_s: float | None = None
    """When it was taken, on the file's own clock [s]; None where the file does not say."""
    episode: int = 0
    """Which take it belongs to: clocks of two have nothing to do with one another."""
