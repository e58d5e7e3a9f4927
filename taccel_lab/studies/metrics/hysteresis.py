# SPDX-License-Identifier: Apache-2.0
r"""Work that a loop of the indenter does not give back, as a part of the work put in.

The gel itself is elastic and presses are quasi-static, so that friction between indenter and gel is
the only loss here: no figure of a viscoelastic gel. Work is the integral of the force over the
indenter's way, by trapezoids on steps that are the same there and back:

    loss = (work in - work out) / work in
"""

from __future__ import annotations

import numpy as np

from taccel_lab.studies.metrics.base import NoFigure, metric
from taccel_lab.studies.metrics.evidence import Evidence


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
