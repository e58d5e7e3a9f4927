# SPDX-License-Identifier: Apache-2.0
"""Stiffness of the gel under a ball and under a flat punch."""

from __future__ import annotations

import numpy as np

from taccel_lab.studies.metrics.base import NoFigure, metric
from taccel_lab.studies.metrics.evidence import Evidence, at_load


@metric(
    "stiffness_punch", "N/mm",
    "initial slope of force over depth under {tool}", "none", ("punch",),
)  # fmt: skip
def stiffness_punch(evidence: Evidence) -> float:
    """F / d at zero depth, of a line through the steps' F / d.

    A free parabola of F takes five times as much from the noise of a mesh: of forces 3 % off it
    makes a slope 23 % off. Depths count from the touch, so that it has no offset to find.
    """
    record = evidence.one("punch")
    depth, force = record.depth_mm[record.down], record.normal_n
    if len(depth) < 3:
        raise NoFigure(f"press punch has {len(depth)} steps; three are needed for a slope")
    return float(np.polynomial.Polynomial.fit(depth, force / depth, 1).convert().coef[0])


@metric(
    "stiffness_secant", "N/mm", "load over depth of {tool} at {load}", "none",
    ("sphere",), smooth=True,
)  # fmt: skip
def stiffness_secant(evidence: Evidence) -> float:
    """F / d at the load."""
    record = evidence.one("sphere")
    depth = at_load(record, record.depth_mm[record.down], evidence.load_n)
    return evidence.load_n / depth


@metric(
    "stiffness_tangent", "N/mm", "slope of force over depth of {tool} at {load}",
    "none", ("sphere",),
)  # fmt: skip
def stiffness_tangent(evidence: Evidence) -> float:
    """dF/dd = (F / d) p with F ~ d^p around the load."""
    record = evidence.one("sphere")
    depth = record.depth_mm[record.down]
    a, b = (at_load(record, depth, load * evidence.load_n) for load in (0.99, 1.0))
    return 0.01 * evidence.load_n / (b - a)


@metric(
    "stiffness_roller", "N/mm",
    "load over depth of {tool} at {load}", "none", ("cylinder",),
)  # fmt: skip
def stiffness_roller(evidence: Evidence) -> float:
    """F / d of a line contact at the load."""
    record = evidence.one("cylinder")
    depth = at_load(record, record.depth_mm[record.down], evidence.load_n)
    return evidence.load_n / depth
