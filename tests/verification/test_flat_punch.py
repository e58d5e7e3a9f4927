# SPDX-License-Identifier: Apache-2.0
"""A rigid circular flat punch on an elastic half-space, without friction.

    F = 2 a E* d,  E* = E / (1 - nu^2),  p(r) = F / (2 pi a^2) / sqrt(1 - r^2 / a^2)

for radius a and depth d [Sneddon 1965; Johnson 1985, Contact Mechanics, section 3.4]. The pressure
is singular at the sharp rim, where elements therefore become small, down to 0.19 a (3 elements
along a) and 0.13 a (4). A circle of nodes lies on the rim; the punch is wider by 0.06 % than it.
Between these nodes the faces that rise beside the punch reach under it, and where they come nearer
to its corners than the guard's range, these press on them too: up to 1 % of the force, less with a
finer mesh or a larger dhat.

Contact acts at a gap, at most dhat. The slope dF/dd between two depths is free of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pytest

from taccel_lab.bodies.primitives import cylinder_mesh
from taccel_lab.solvers import SolverConfig
from tests.verification.half_space import DOMAIN_OVER_RADIUS, GROWTH, HalfSpace
from tests.verification.half_space_mesh import half_space_mesh

RADIUS, DEPTH, YOUNG = 1e-3, 5e-6, 1e5
SEGMENTS = 96


@dataclass(frozen=True)
class Punched:
    """A press to half the depth and then to all of it, against Sneddon."""

    half_error: float
    """Force at half the depth over the formula's at that depth plus the gap, less 1."""
    error: float
    """The same at the whole depth."""
    slope_error: float
    """Difference of the forces over the formula's, less 1."""
    gap: float
    """Mean gap under the punch over dhat."""
    spread: float
    """Radius of gyration of the pressure over that of the formula, sqrt(2 / 3) a."""
    leaning: float
    """Tangential over normal force."""


@lru_cache
def punched(cells: int, poisson: float, dhat_over_depth: float = 0.1) -> Punched:
    height, dhat = RADIUS, dhat_over_depth * DEPTH
    total = DOMAIN_OVER_RADIUS * RADIUS
    mesh = half_space_mesh(RADIUS, cells, total, GROWTH, roundness=1.0, grading=1.5)
    radius = RADIUS * 1.0001 / np.cos(np.pi / SEGMENTS)
    block = HalfSpace(
        mesh,
        cylinder_mesh(radius, height, SEGMENTS),
        young_pa=YOUNG,
        poisson=poisson,
        start_m=height / 2 + 2 * dhat,
        config=SolverConfig(dhat_m=dhat, relative_tolerance=1e-5, absolute_tolerance_n=1e-12),
    )
    stiffness = 2 * RADIUS * YOUNG / (1 - poisson**2)
    forces, errors = [], []
    for depth in (0.5 * DEPTH, DEPTH):
        block.move(0.0, height / 2 - depth)
        normal = -block.normal_n[:, 2]
        under = (np.hypot(*block.rest_m[:, :2].T) < 0.9 * RADIUS) & (normal > 0)
        gap = float((-depth - block.positions_m[under, 2]).mean())
        forces.append(float(normal.sum()))
        errors.append(forces[-1] / (stiffness * (depth + gap)) - 1)
    radii = np.hypot(*block.positions_m[:, :2].T)
    gyration = np.sqrt((normal * radii**2).sum() / normal.sum())
    return Punched(
        half_error=errors[0],
        error=errors[1],
        slope_error=(forces[1] - forces[0]) / (stiffness * DEPTH / 2) - 1,
        gap=gap / dhat,
        spread=float(gyration / (np.sqrt(2 / 3) * RADIUS)),
        leaning=float(np.linalg.norm(block.normal_n[:, :2].sum(axis=0)) / normal.sum()),
    )


def check(punch: Punched, tolerance: float) -> None:
    """Elements are too stiff, and nothing else is off by as much."""
    assert 0 < punch.slope_error < tolerance
    assert 0 < punch.error < tolerance
    assert punch.error == pytest.approx(punch.half_error, abs=1e-3), "F grows like d"
    assert 0.9 < punch.gap < 1, "a small pressure is carried at nearly dhat"
    assert punch.leaning < 1e-9
    # A uniform pressure would have a spread of 0.87, that of a ball 0.77.
    assert punch.spread == pytest.approx(1.0, abs=0.02)


def test_force_stiffness_and_pressure_are_the_formulas() -> None:
    fine, coarse = punched(3, 0.45), punched(2, 0.45)
    check(fine, tolerance=0.025)
    assert fine.slope_error < 0.6 * coarse.slope_error < 0.03


@pytest.mark.slow
def test_the_modulus_is_that_of_plane_strain() -> None:
    check(punched(3, 0.3), tolerance=0.025)


@pytest.mark.slow
def test_the_slope_does_not_depend_on_dhat() -> None:
    near, far = punched(3, 0.45), punched(3, 0.45, dhat_over_depth=0.2)
    assert far.slope_error == pytest.approx(near.slope_error, abs=4e-3)
    assert far.error == pytest.approx(near.error, abs=3e-3)


@pytest.mark.slow
def test_four_elements_along_the_radius_are_within_two_percent() -> None:
    check(punched(4, 0.3), tolerance=0.016)
