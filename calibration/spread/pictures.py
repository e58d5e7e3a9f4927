# SPDX-License-Identifier: Apache-2.0
"""Pictures of the spread."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.calibration.light.light import LightDrift
from taccel_lab.report.style import CHANNELS, in_report_style, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@in_report_style
def draw_lights(lights: Sequence[LightDrift], pivot: np.ndarray) -> Figure:
    """Gain, and offset at the mean level, of each light in order."""
    order = np.arange(len(lights))
    figure, (left, right) = new_figure(9.0, 3.4, 1, 2)
    for c, (name, color) in enumerate(CHANNELS):
        gain = np.array([light.gain[c] for light in lights])
        offset = np.array([light.offset[c] for light in lights]) + (gain - 1) * pivot[c]
        left.plot(order, gain, "o-", color=color, markersize=4, linewidth=1, label=name)
        right.plot(order, offset, "o-", color=color, markersize=4, linewidth=1)
    left.set_ylabel("gain")
    right.set_ylabel("change of the mean level [levels]")
    for axes in (left, right):
        axes.grid(True)
        axes.set_xlabel("frame or unit, in order")
        axes.xaxis.get_major_locator().set_params(integer=True)
    left.legend()
    return figure
