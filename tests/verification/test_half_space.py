# SPDX-License-Identifier: Apache-2.0
"""A frictionless rigid ball pressed into a half-space, against Hertz.

    a = sqrt(R d),  F = 4/3 E* sqrt(R) d^1.5,  E* = E / (1 - nu^2),  p(r) = p0 sqrt(1 - r^2 / a^2)

for a rigid sphere of radius R at depth d [Johnson 1985, Contact Mechanics, section 4.2]. Mesh and
dhat are varied one at a time.

A rigid circular flat punch on an elastic half-space, without friction.

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

from functools import lru_cache
from types import SimpleNamespace

import numpy as np
import pytest

from taccel_lab.bodies.primitives import cylinder_mesh
from taccel_lab.scene import Ball, Element
from tests.support.variants import variants
from tests.verification.half_space import DOMAIN_OVER_RADIUS, GROWTH, HalfSpace, half_space_mesh

BALL, DEPTH, YOUNG = 1e-2, 2.5e-5, 1e5
"""Radius, depth and modulus of Hertz's presses; a / R is 0.05, so that his parabola and his small
strains hold."""
HERTZ_RADIUS = float(np.sqrt(BALL * DEPTH))


@lru_cache
def pressed(
    cells: int, poisson: float = 0.3, dhat: float = 0.002, element: Element = Element.LINEAR
) -> SimpleNamespace:
    """The ball pressed in one step: ``cells`` to the contact radius, ``dhat`` over the depth."""
    force = 4 / 3 * YOUNG / (1 - poisson**2) * float(np.sqrt(BALL)) * DEPTH**1.5
    # Shells about as long as wide; quadratic tets follow the field far away in larger steps.
    growth = float(np.exp((1.2 if element is Element.QUADRATIC else 0.8) / cells))
    block = HalfSpace(
        half_space_mesh(HERTZ_RADIUS, cells, DOMAIN_OVER_RADIUS * HERTZ_RADIUS, growth),
        Ball(BALL),
        young_pa=YOUNG,
        poisson=poisson,
        start_m=BALL + 2 * dhat * DEPTH,
        element=element,
        dhat_m=dhat * DEPTH,
        absolute_tolerance_n=1e-12,
    )
    report = block.move(0.0, BALL - DEPTH)
    positions, normal = block.positions_m, block.normal_n
    size = np.linalg.norm(normal, axis=1)
    loaded = np.flatnonzero(size > 1e-3 * size.max())
    radii = np.hypot(positions[:, 0], positions[:, 1])
    first, last = block.model.bodies[0].faces
    top = block.model.surface.faces.numpy()[first:last]
    corners = positions[top[np.isin(top, loaded).any(axis=1)]]
    total = -float(normal[:, 2].sum())
    inside = loaded[radii[loaded] < 0.8 * HERTZ_RADIUS]
    peak = 1.5 * force / (np.pi * HERTZ_RADIUS**2)
    ellipse = peak * np.sqrt(1 - (radii[inside] / HERTZ_RADIUS) ** 2)
    return SimpleNamespace(
        force_n=total,
        force_error=total / force - 1,
        # From the second moment of the contact forces: sum f r^2 = 2/5 a^2 F.
        radius_m=float(np.sqrt(2.5 * (size * radii**2).sum() / size.sum())),
        # Distance of the outermost node that carries force from Hertz's radius [m].
        outermost_m=abs(float(radii[loaded].max()) - HERTZ_RADIUS),
        # Longest edge of a surface face in the contact [m].
        element_m=float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max()),
        node_count=len(positions),
        residual_n=float(report.residual_n[0]),
        # Pressure over Hertz's ellipse, less 1, of the loaded nodes within 0.8 a.
        peak_error=size[inside] / block.areas_m2[inside] / ellipse - 1,
    )


def check(found: SimpleNamespace, within: float) -> None:
    """The force, the outermost node and what the solver left."""
    assert abs(found.force_error) < within
    assert found.outermost_m < found.element_m
    assert found.residual_n < 1e-4 * found.force_n


def check_linear(cells: int) -> None:
    found = pressed(cells)
    assert found.element_m < 1.5 * HERTZ_RADIUS / cells
    assert found.outermost_m < found.element_m
    assert found.radius_m == pytest.approx(HERTZ_RADIUS, rel=0.01)
    if cells > 4:
        assert len(found.peak_error) > 40
        assert np.sqrt((found.peak_error**2).mean()) < 0.07


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("cells", "within"), [((2, 3, 4), 0.08), pytest.param((3, 4, 5), 0.05, marks=pytest.mark.slow)]
)
def test_linear_tets_converge_to_hertz(cells: tuple[int, int, int], within: float) -> None:
    coarse, middle, fine = (pressed(n).force_error for n in cells)
    assert coarse > middle > fine > 0, "linear tets are too stiff"
    limit = fine - (middle - fine) / ((cells[2] / cells[1]) ** 2 - 1)
    assert abs(limit) < 0.02, "the rest is the size of the block, dhat and a / R"
    order = np.log((coarse - limit) / (fine - limit)) / np.log(cells[2] / cells[0])
    assert order == pytest.approx(2.0, abs=0.3)
    assert fine < within, "below 0.042 with 6 cells, by the square of the element size"
    check_linear(cells[2])


@pytest.mark.slow
def test_finer_linear_tets_come_closer_and_lock_as_poisson_ratio_grows() -> None:
    check_linear(6)
    assert 0 < pressed(6).force_error < 0.042
    check(pressed(8), 0.03)
    assert abs(pressed(10).force_error) < 0.024
    assert 1.3 * pressed(6).force_error < pressed(6, poisson=0.45).force_error < 0.08


@pytest.mark.thorough
@pytest.mark.parametrize("cells", variants([(3, 4)], [(3, 4), (4, 6)]))
def test_dhat_acts_like_depth(cells: tuple[int, int]) -> None:
    """The force grows like that of a depth larger by dhat, in the limit of fine meshes."""

    def limit(dhat: float) -> float:
        # Those of the usual dhat are known from the tests above.
        more = {} if dhat == 0.002 else {"dhat": dhat}
        coarse, fine = (pressed(n, **more).force_n for n in cells)
        return fine - (coarse - fine) / ((cells[1] / cells[0]) ** 2 - 1)

    ratio = limit(0.05) / limit(0.002)
    assert ratio == pytest.approx(((1 + 0.05) / (1 + 0.002)) ** 1.5, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("cells", [2, 3])
def test_quadratic_tets_are_within_two_percent(cells: int) -> None:
    """With 4,600 nodes (linear tets: 94,000 for 2.1 %), and near nu = 0.5 too."""
    result = pressed(cells, element=Element.QUADRATIC)
    assert result.node_count < (5_000 if cells == 2 else 15_000)
    check(result, 0.02)
    if cells == 3:
        assert result.radius_m == pytest.approx(HERTZ_RADIUS, rel=0.015)
        almost = pressed(2, poisson=0.499, element=Element.QUADRATIC)
        assert abs(almost.force_error) < 0.035


PUNCH, PUNCH_DEPTH = 1e-3, 5e-6
SEGMENTS = 96


@lru_cache
def punched(cells: int, poisson: float, dhat_over_depth: float = 0.1) -> SimpleNamespace:
    """A press to half the depth and then to all of it, against Sneddon."""
    dhat = dhat_over_depth * PUNCH_DEPTH
    radius = PUNCH * 1.0001 / np.cos(np.pi / SEGMENTS)
    block = HalfSpace(
        half_space_mesh(PUNCH, cells, DOMAIN_OVER_RADIUS * PUNCH, GROWTH, 1.0, grading=1.5),
        cylinder_mesh(radius, PUNCH, SEGMENTS),
        young_pa=YOUNG,
        poisson=poisson,
        start_m=PUNCH / 2 + 2 * dhat,
        dhat_m=dhat,
        relative_tolerance=1e-5,
        absolute_tolerance_n=1e-12,
    )
    stiffness = 2 * PUNCH * YOUNG / (1 - poisson**2)
    forces, errors = [], []
    for depth in (0.5 * PUNCH_DEPTH, PUNCH_DEPTH):
        block.move(0.0, PUNCH / 2 - depth)
        normal = -block.normal_n[:, 2]
        under = (np.hypot(*block.rest_m[:, :2].T) < 0.9 * PUNCH) & (normal > 0)
        gap = float((-depth - block.positions_m[under, 2]).mean())
        forces.append(float(normal.sum()))
        errors.append(forces[-1] / (stiffness * (depth + gap)) - 1)
    radii = np.hypot(*block.positions_m[:, :2].T)
    gyration = np.sqrt((normal * radii**2).sum() / normal.sum())
    return SimpleNamespace(
        # Force over the formula's at the depth plus the gap, less 1.
        half_error=errors[0],
        error=errors[1],
        slope_error=(forces[1] - forces[0]) / (stiffness * PUNCH_DEPTH / 2) - 1,
        gap=gap / dhat,
        # Radius of gyration of the pressure over that of the formula.
        spread=float(gyration / (np.sqrt(2 / 3) * PUNCH)),
        leaning=float(np.linalg.norm(block.normal_n[:, :2].sum(axis=0)) / normal.sum()),
    )


def check_punch(punch: SimpleNamespace, tolerance: float) -> None:
    """Elements are too stiff, and nothing else is off by as much."""
    assert 0 < punch.slope_error < tolerance
    assert 0 < punch.error < tolerance
    assert punch.error == pytest.approx(punch.half_error, abs=1e-3), "F grows like d"
    assert 0.9 < punch.gap < 1, "a small pressure is carried at nearly dhat"
    assert punch.leaning < 1e-9
    # A uniform pressure would have a spread of 0.87, that of a ball 0.77.
    assert punch.spread == pytest.approx(1.0, abs=0.02)


@pytest.mark.thorough
def test_force_stiffness_and_pressure_are_the_formulas() -> None:
    check_punch(punched(3, 0.45), tolerance=0.025)


@pytest.mark.slow
def test_plane_strain_dhat_and_other_punches() -> None:
    assert punched(3, 0.45).slope_error < 0.6 * punched(2, 0.45).slope_error < 0.03
    check_punch(punched(3, 0.3), tolerance=0.025)
    near, far = punched(3, 0.45), punched(3, 0.45, dhat_over_depth=0.2)
    assert far.slope_error == pytest.approx(near.slope_error, abs=4e-3)
    assert far.error == pytest.approx(near.error, abs=3e-3)
    check_punch(punched(4, 0.3), tolerance=0.016)
