# SPDX-License-Identifier: Apache-2.0
"""Area of a ball's contact at the load."""

from __future__ import annotations

import math

from taccel_lab.studies.metrics.base import metric
from taccel_lab.studies.metrics.evidence import Evidence, at_load, contact_radius_mm


@metric(
    "contact_area", "mm2", "area of the contact of {tool} at {load}", "none",
    ("sphere",),
)  # fmt: skip
def contact_area(evidence: Evidence) -> float:
    """pi a^2 with the radius of the disc of equal area."""
    record = evidence.one("sphere")
    return math.pi * at_load(record, contact_radius_mm(record), evidence.load_n) ** 2
