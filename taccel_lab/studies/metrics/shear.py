# SPDX-License-Identifier: Apache-2.0
r"""What shear and twist do to gel and markers, and the work that a loop does not give back.

The gel itself is elastic and presses are quasi-static, so that friction between indenter and gel is
the only loss here: no figure of a viscoelastic gel. Work is the integral of the force over the
indenter's way, by trapezoids on steps that are the same there and back:

    loss = (work in - work out) / work in
"""

from __future__ import annotations

import math

import numpy as np

from taccel_lab.studies.metrics.base import metric
from taccel_lab.studies.metrics.design_point import NoFigure
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
    """Takes all nodes of the contact face, along the shear."""
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


def lost_part(travel: np.ndarray, force: np.ndarray) -> float:
    """Loss of a loop that goes from ``travel[0]`` to its farthest point and back, [step] each.

    Raises NoFigure when the loop takes no work or does not come back.
    """
    turn = int(np.argmax(np.abs(travel - travel[0])))
    if turn in (0, len(travel) - 1):
        raise NoFigure("the press does not go back, so that there is no loop")
    work_in = float(np.trapezoid(force[: turn + 1], travel[: turn + 1]))
    work_out = -float(np.trapezoid(force[turn:], travel[turn:]))
    if not work_in > 0:
        raise NoFigure("the loop takes no work")
    return (work_in - work_out) / work_in


@metric(
    "hysteresis_shear", "%",
    "share of the work of shear that does not come back on the way back (friction alone: the gel "
    "is elastic)", "lower", ("shear",),
)  # fmt: skip
def hysteresis_shear(evidence: Evidence) -> float:
    """Loop of the shear at full depth, before the twist."""
    record = evidence.one("shear")
    start = record.down.stop - 1
    flat = np.flatnonzero(record.twist_deg != 0)
    stop = int(flat[0]) if len(flat) else len(record.shear_mm)
    loop = slice(start, stop)
    return 100 * lost_part(record.shear_mm[loop], -record.force_n[loop, 0])


@metric(
    "hysteresis_press", "%",
    "share of the work of a press that does not come back on release (friction alone: the gel is "
    "elastic)", "lower", ("release",),
)  # fmt: skip
def hysteresis_press(evidence: Evidence) -> float:
    """Loop of the depth of the press with release."""
    record = evidence.one("release")
    depth, force = np.append(0.0, record.depth_mm), np.append(0.0, record.force_n[:, 2])
    # The force at first touch, where the way back ends, is that of the barrier's first layer.
    force[0] = force[-1]
    return 100 * lost_part(depth, force)
