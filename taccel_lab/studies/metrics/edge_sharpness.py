# SPDX-License-Identifier: Apache-2.0
"""How sharply the gel's surface shows an edge."""

from __future__ import annotations

import numpy as np

from taccel_lab.studies.metrics.base import NoFigure, metric
from taccel_lab.studies.metrics.evidence import Evidence, profile_mm

_HALF_MM = 8.0


def rise_width(x: np.ndarray, dent: np.ndarray) -> float:
    """Mean distance on both sides over which a dent falls from 90 % to 10 % of its peak.

    ``x`` ascending, ``dent`` positive in the dent, NaN beside the face; [n] each. Raises
    NoFigure when a side does not fall that far.
    """
    seen = np.isfinite(dent)
    x, dent = x[seen], dent[seen]
    peak = int(np.argmax(dent))
    widths = []
    for side in (slice(peak, None), slice(peak, None, -1)):
        place, share = np.abs(x[side] - x[peak]), dent[side] / dent[peak]
        crossed = []
        for level in (0.9, 0.1):
            below = np.flatnonzero(share <= level)
            if len(below) == 0:
                raise NoFigure(
                    f"the dent of the edge does not fall below {level:.0%} of its depth on the pad"
                )
            k = int(below[0])
            crossed.append(np.interp(-level, -share[k - 1 : k + 1], place[k - 1 : k + 1]))
        widths.append(crossed[1] - crossed[0])
    return float(np.mean(widths))


@metric(
    "edge_sharpness", "mm",
    "distance over which the dent of {tool} falls from 90 % to 10 % of its depth",
    "lower", ("edge",),
)  # fmt: skip
def edge_sharpness(evidence: Evidence) -> float:
    """10-90 % width of the profile across the edge, the mean of both sides."""
    record = evidence.one("edge")
    x, change = profile_mm(record, _HALF_MM)
    return rise_width(x, -change)
