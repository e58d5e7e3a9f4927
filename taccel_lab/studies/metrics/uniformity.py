# SPDX-License-Identifier: Apache-2.0
"""Whether the pad answers alike wherever it is touched."""

from __future__ import annotations

import numpy as np

from taccel_lab.studies.metrics.base import NoFigure, metric
from taccel_lab.studies.metrics.evidence import Evidence, at_load, contact_radius_mm


def variation(values: list[float]) -> float:
    """Standard deviation of the sample over its mean."""
    return float(np.std(values, ddof=1) / np.mean(values))


@metric(
    "uniformity_force", "%",
    "coefficient of variation of the force of {tool} at one depth in five places", "lower",
    ("places",),
)  # fmt: skip
def uniformity_force(evidence: Evidence) -> float:
    """At the greatest depth that all places reach."""
    records = evidence.all("places")
    if len(records) < 3:
        raise NoFigure(f"press places has {len(records)} places; three are needed")
    depth = min(float(record.depth_mm[record.down][-1]) for record in records)
    forces = [
        float(np.exp(np.interp(np.log(depth), np.log(r.depth_mm[r.down]), np.log(r.normal_n))))
        for r in records
    ]
    return 100 * variation(forces)


@metric(
    "uniformity_contact", "%",
    "coefficient of variation of the contact radius of {tool} at one load in five places",
    "lower", ("places",),
)  # fmt: skip
def uniformity_contact(evidence: Evidence) -> float:
    """At half of the least force that the places end with."""
    records = evidence.all("places")
    if len(records) < 3:
        raise NoFigure(f"press places has {len(records)} places; three are needed")
    load = 0.5 * min(float(record.normal_n[-1]) for record in records)
    return 100 * variation([at_load(r, contact_radius_mm(r), load) for r in records])


@metric(
    "uniformity_image", "%",
    "coefficient of variation of the change of the picture over the force, of {tool} in five "
    "places", "lower", ("places",),
)  # fmt: skip
def uniformity_image(evidence: Evidence) -> float:
    """At the greatest depth of each place: grey levels in the dent over the force."""
    records = evidence.all("places")
    if len(records) < 3:
        raise NoFigure(f"press places has {len(records)} places; three are needed")
    response = [
        float(evidence.picture_change(r, [r.down.stop - 1])[0] / r.normal_n[-1]) for r in records
    ]
    return 100 * variation(response)
