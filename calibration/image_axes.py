# SPDX-License-Identifier: Apache-2.0
"""Axes over a picture of the sensor, and by how much arrows on it are enlarged."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def frame_image(axes: Axes, size_px: tuple[int, int]) -> None:
    """Show exactly the pixels of an image of this width and height, rows downwards."""
    axes.set_xlim(-0.5, size_px[0] - 0.5)
    axes.set_ylim(size_px[1] - 0.5, -0.5)
    axes.set_aspect("equal")
    axes.set_xlabel("u [px]")
    axes.set_ylabel("v [px]")


def round_enlargement(wanted: float) -> float:
    """The largest of 1, 2 or 5 times a power of ten that is not above ``wanted``."""
    wanted = max(wanted, 1e-9)
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(power * max(step for step in (1, 2, 5) if step * power <= wanted * (1 + 1e-9)))
