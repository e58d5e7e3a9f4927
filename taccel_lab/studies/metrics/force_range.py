# SPDX-License-Identifier: Apache-2.0
"""How hard a gel may be pressed before it bottoms out."""

from __future__ import annotations

import math

import numpy as np

from taccel_lab.studies.metrics.base import NoFigure, metric
from taccel_lab.studies.metrics.evidence import Evidence

BOTTOM_STRAIN = 0.4
"""Depth over thickness at which a gel counts as bottomed out. How much stiffer it has become than a
half-space says nothing of that: thin gels are three times as stiff from the first contact on."""
MOST_AHEAD = 1.5
"""How far beyond its deepest step a press may be continued."""


@metric(
    "force_range", "N",
    "force of {tool} before bottoming, at a depth of 40 % of the gel's thickness",
    "higher", ("sphere",), smooth=True,
)  # fmt: skip
def force_range(evidence: Evidence) -> float:
    """By power laws between the steps.

    Where a thick gel was not pressed quite as deep, that of the last two steps goes on.
    """
    record = evidence.one("sphere")
    depth, force = record.depth_mm[record.down], record.normal_n
    if len(force) < 2:
        raise NoFigure("press sphere has one step alone; two are needed")
    limit = BOTTOM_STRAIN * record.thickness_mm
    if limit > MOST_AHEAD * depth[-1]:
        raise NoFigure(f"the gel bottoms at {limit:.3g} mm, and press sphere ends at "
                          f"{depth[-1]:.3g} mm")  # fmt: skip
    if limit > depth[-1]:
        power = math.log(force[-1] / force[-2]) / math.log(depth[-1] / depth[-2])
        return float(force[-1] * (limit / depth[-1]) ** power)
    return float(np.exp(np.interp(math.log(limit), np.log(depth), np.log(force))))
