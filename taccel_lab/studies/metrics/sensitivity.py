# SPDX-License-Identifier: Apache-2.0
"""How much of a load is seen: depth of the dent, size of the contact, motion of the markers."""

from __future__ import annotations

import numpy as np

from taccel_lab.studies.metrics.base import metric
from taccel_lab.studies.metrics.evidence import (
    Evidence,
    at_load,
    contact_radius_mm,
    dent_mm,
)


@metric(
    "sensitivity_um", "um/N",
    "largest motion of the contact face along the press of {tool} at {load}, over the load",
    "higher", ("sphere",), smooth=True,
)  # fmt: skip
def sensitivity_um(evidence: Evidence) -> float:
    """Peak of the dent over the load."""
    record = evidence.one("sphere")
    return at_load(record, dent_mm(record), evidence.load_n) * 1e3 / evidence.load_n


@metric(
    "sensitivity_px", "px/N", "contact radius of {tool} at {load} in pixels, over the load",
    "higher", ("sphere",),
)  # fmt: skip
def sensitivity_px(evidence: Evidence) -> float:
    """Contact radius over the size of a pixel and the load."""
    record = evidence.one("sphere")
    radius = at_load(record, contact_radius_mm(record), evidence.load_n)
    return radius / evidence.mm_per_px / evidence.load_n


@metric(
    "sensitivity_marker_px", "px/N",
    "largest motion of a marker in the image under {tool} at {load}, over the load; points 1 mm "
    "apart stand for markers on a gel without", "higher", ("sphere",),
)  # fmt: skip
def sensitivity_marker_px(evidence: Evidence) -> float:
    """Largest |motion| in the image."""
    record = evidence.one("sphere")
    moved = evidence.marker_motion_px(record, range(record.down.stop))
    pixels = np.linalg.norm(moved, axis=-1).max(axis=1)
    return at_load(record, pixels, evidence.load_n) / evidence.load_n


@metric(
    "sensitivity_grey", "levels/N",
    "mean change of the camera's grey levels in the dent of {tool} at {load}, over the load",
    "higher", ("sphere",),
)  # fmt: skip
def sensitivity_grey(evidence: Evidence) -> float:
    """From the optical model, mean of the three channels."""
    record = evidence.one("sphere")
    change = evidence.picture_change(record, list(range(record.down.stop)))
    return at_load(record, change, evidence.load_n) / evidence.load_n
