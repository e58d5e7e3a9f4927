# SPDX-License-Identifier: Apache-2.0
"""The coefficient of friction that makes the ratio of forces which a sliding ball measures.

A ball that slides leans on the gel before it: the contact shifts forward, and the tangential over
the normal force exceeds the coefficient, by 2 % for 0.3 and by 13 % for 0.6 on a 4 mm gel. Presses
of the same ball at the same load, slid until the whole contact slips, give the ratio over the
coefficient.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy.optimize import brentq

from taccel_lab.calibration.material.gel import CurveTool, Gel
from taccel_lab.calibration.material.gel_presses import GelBench
from taccel_lab.presses.bonded_layer import layer_force_n
from taccel_lab.progress import Progress, silent

GRID = 1.25
"""Depths and coefficients are simulated at powers of this, so that similar records share presses.
"""
STEPS = 6
FULL_SLIP_DEPTHS = 2.6
"""Shift over mu, in depths, up to which is simulated: at about 2 the whole contact of a ball
slips."""
LARGEST_RATIO = 1.0
"""Ratios above this are not corrected: the gel folds up behind the ball and no press converges."""


@dataclass(frozen=True)
class BallSlide:
    """Ratio of the forces at full slip over the coefficient of friction, at one load."""

    depth_mm: float
    mus: np.ndarray
    ratios: np.ndarray
    """Tangential over normal force at full slip."""

    def friction(self, ratio: float) -> float:
        """The coefficient that makes a ratio."""
        gain = np.polyfit(self.mus, self.ratios / self.mus, len(self.mus) - 1)

        def miss(mu: float) -> float:
            return mu * float(np.polyval(gain, mu)) - ratio

        low, high = 0.5 * ratio, 1.2 * ratio
        if not miss(low) < 0 < miss(high):
            return ratio
        return cast(float, brentq(miss, low, high, xtol=1e-12))


def depth_of_load_mm(
    tool: CurveTool, load_n: float, young_pa: float, poisson_ratio: float, thickness_mm: float
) -> float:
    """Depth at which a layer carries a load, by the linear theory of bonded layers [mm]."""
    limit = min(0.5 * thickness_mm, 0.5 * tool.radius_mm)
    depths = np.geomspace(1e-3, 1.0, 60) * limit
    forces = layer_force_n(tool.kind, depths, tool.radius_mm, thickness_mm, poisson_ratio, young_pa)
    return float(np.exp(np.interp(math.log(load_n), np.log(forces), np.log(depths))))


def simulate_ball_slide(
    gel: Gel,
    tool: CurveTool,
    load_n: float,
    ratio: float,
    young_pa: float,
    progress: Progress = silent,
) -> BallSlide | None:
    """Simulate slides at coefficients about ``ratio``; None where they do not converge."""
    if tool.kind != "sphere" or ratio > LARGEST_RATIO:
        return None
    nu = gel.material.poisson_ratio
    depth = depth_of_load_mm(tool, load_n, young_pa, nu, gel.thickness_mm)
    # A coarse grid of depths: the ratio hardly depends on it, and presses are shared.
    depth = round(GRID ** round(math.log(depth, GRID)), 4)
    first, last = math.floor(math.log(0.8 * ratio, GRID)), math.ceil(math.log(ratio, GRID))
    mus, ratios = [GRID**k for k in range(first, last + 1)], []
    scaled = FULL_SLIP_DEPTHS * depth * np.linspace(0, 1, STEPS + 1)
    bench = GelBench(gel, tool, depth)
    for done, mu in enumerate(mus):
        progress(f"slides of {tool.description}", done, len(mus))
        value = bench.slid(scaled * mu, mu)
        if not math.isfinite(value):
            break
        ratios.append(value)
    progress(f"slides of {tool.description}", len(mus), len(mus))
    if len(ratios) < 2:
        return None
    return BallSlide(depth, np.array(mus[: len(ratios)]), np.array(ratios))
