# SPDX-License-Identifier: Apache-2.0
"""What shear and twist do to the markers, and how stiff the gel is against them."""

from __future__ import annotations

import math

import numpy as np

from taccel_lab.studies.metrics.base import NoFigure, metric
from taccel_lab.studies.metrics.evidence import Evidence
from taccel_lab.studies.presses.press_record import PressRecord


def _stuck_shear(record: PressRecord) -> tuple[int, int, float]:
    """Last step down, the step of most shear, and the tangential force gained between them [N]."""
    start, end = record.down.stop - 1, int(np.argmax(np.abs(record.shear_mm)))
    if end <= start:
        raise NoFigure(f"press {record.press} has no shear")
    gained = record.force_n[end, :2] - record.force_n[start, :2]
    # The gel pulls back against the motion.
    force = -float(gained[0]) * math.copysign(1.0, record.shear_mm[end])
    if not force > 0:
        raise NoFigure(f"press {record.press}: shear of {record.shear_mm[end]:.3g} mm met no "
                          "resistance (no friction)")  # fmt: skip
    return start, end, force


@metric(
    "shear_stiffness", "N/mm", "tangential force over the shear of {tool}", "none",
    ("shear",),
)  # fmt: skip
def shear_stiffness(evidence: Evidence) -> float:
    """Force gained over the indenter's way; less than the gel's own where the ball slips."""
    record = evidence.one("shear")
    _, end, force = _stuck_shear(record)
    return force / abs(float(record.shear_mm[end]))


@metric(
    "shear_response_mm", "mm/N",
    "largest motion of a point of the contact face with {tool} sheared, over the tangential force",
    "higher", ("shear",),
)  # fmt: skip
def shear_response_mm(evidence: Evidence) -> float:
    """Over all nodes of the contact face, along the shear."""
    record = evidence.one("shear")
    start, end, force = _stuck_shear(record)
    idx = record.surface.node_idx
    moved = record.in_press(record.positions_m(end)[idx])
    moved = moved - record.in_press(record.positions_m(start)[idx])
    return float(np.abs(moved[:, 0]).max()) * 1e3 / force


@metric(
    "shear_response_px", "px/N",
    "largest motion of a marker in the image with {tool} sheared, over the tangential force; "
    "points 1 mm apart stand for markers on a gel without", "higher", ("shear",),
)  # fmt: skip
def shear_response_px(evidence: Evidence) -> float:
    """Motion in the image between the last step down and the most shear."""
    record = evidence.one("shear")
    start, end, force = _stuck_shear(record)
    before, after = evidence.marker_motion_px(record, [start, end])
    pixels = after - before
    return float(np.linalg.norm(pixels, axis=-1).max()) / force


@metric(
    "twist_stiffness", "N mm/deg", "torque over the turn of {tool}", "none",
    ("shear",),
)  # fmt: skip
def twist_stiffness(evidence: Evidence) -> float:
    """Torque gained over the turn."""
    record = evidence.one("shear")
    turned = np.flatnonzero(record.twist_deg != 0)
    if len(turned) == 0:
        raise NoFigure(f"press {record.press} has no twist")
    gained = record.torque_nm[turned[-1]] - record.torque_nm[turned[0] - 1]
    return -float(gained / record.twist_deg[turned[-1]]) * 1e3
