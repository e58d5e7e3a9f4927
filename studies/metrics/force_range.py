# SPDX-License-Identifier: Apache-2.0
"""How hard a gel may be pressed before it bottoms out."""

from __future__ import annotations

import math

import numpy as np

from studies.evidence import Evidence
from studies.metrics.base import Unavailable, metric
from taccel_lab.envs import parse_indenter
from taccel_lab.scene import Ball

BOTTOM_STRAIN = 0.4
"""Depth over thickness at which a gel counts as bottomed out."""
MOST_AHEAD = 1.5
"""How far beyond its deepest step a press may be continued."""
BOTTOM_STIFFENING = 3.0
"""Or earlier: slope of the force over Hertz's, for the same ball on a half-space."""


@metric(
    "force_range", "N",
    "force of a ball of 3 mm radius before bottoming: its depth is 40 % of the gel's thickness, or "
    "the slope of the force three times Hertz's", "higher", ("sphere",),
)  # fmt: skip
def force_range(evidence: Evidence) -> float:
    """Force at the lesser of both depths.

    Hertz's slope 2 E* sqrt(R d) takes the modulus of the gel proper, E* = E / (1 - nu^2). Where a
    thick gel was not pressed quite as deep, the power law of the last two steps goes on.
    """
    record = evidence.one("sphere")
    depth, force = record.depth_mm[record.down], record.normal_n
    gel = evidence.parameters.layer_materials()[0]
    ball = parse_indenter(record.indenter).shape
    assert isinstance(ball, Ball)
    contact_mpa = gel.young_modulus_pa * 1e-6 / (1 - gel.poisson_ratio**2)
    middle = 0.5 * (depth[1:] + depth[:-1])
    slope = np.diff(force) / np.diff(depth)
    stiffening = slope / (2 * contact_mpa * np.sqrt(ball.radius_m * 1e3 * middle))
    limit = BOTTOM_STRAIN * record.thickness_mm
    stiff = np.flatnonzero(stiffening >= BOTTOM_STIFFENING)
    if len(stiff):
        k = int(stiff[0])
        at = middle[0] if k == 0 else float(
            np.interp(BOTTOM_STIFFENING, stiffening[k - 1 : k + 1], middle[k - 1 : k + 1])
        )  # fmt: skip
        limit = min(limit, at)
    power = math.log(force[-1] / force[-2]) / math.log(depth[-1] / depth[-2])
    if limit > MOST_AHEAD * depth[-1]:
        raise Unavailable(
            f"the gel bottoms at {limit:.3g} mm at the earliest, and press sphere ends at "
            f"{depth[-1]:.3g} mm"
        )
    if limit > depth[-1]:
        return float(force[-1] * (limit / depth[-1]) ** power)
    return float(np.exp(np.interp(math.log(limit), np.log(depth), np.log(force))))
