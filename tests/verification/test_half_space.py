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

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pytest

from taccel_lab.bodies.primitives import cylinder_mesh
from taccel_lab.scene import Ball, Element
from taccel_lab.solvers import SolverConfig
from tests.verification.half_space import DOMAIN_OVER_RADIUS, GROWTH, HalfSpace
from tests.verification.half_space_mesh import half_space_mesh


@dataclass(frozen=True)
class HertzCase:
    """One press; a / R is 0.05, so that Hertz's parabola and his small strains hold."""

    cells: int = 6
    """Elements side by side from the axis to the contact radius."""
    element: Element = Element.LINEAR
    dhat_over_depth: float = 0.002
    poisson_ratio: float = 0.3
    ball_radius_m: float = 1e-2
    depth_m: float = 2.5e-5
    young_pa: float = 1e5

    @property
    def contact_radius_m(self) -> float:
        """Hertz's contact radius [m]."""
        return float(np.sqrt(self.ball_radius_m * self.depth_m))

    @property
    def force_n(self) -> float:
        """Hertz's force [N]."""
        plane_modulus = self.young_pa / (1 - self.poisson_ratio**2)
        return 4 / 3 * plane_modulus * float(np.sqrt(self.ball_radius_m)) * self.depth_m**1.5

    @property
    def growth(self) -> float:
        """Ratio of neighbouring shells: about as long as wide, and finer with ``cells``.

        Quadratic tets follow the field far away in larger steps.
        """
        step = 1.2 if self.element is Element.QUADRATIC else 0.8
        return float(np.exp(step / self.cells))


@dataclass(frozen=True)
class HertzResult:
    """What a press gave, against Hertz."""

    force_n: float
    force_error: float
    """Force over Hertz's, less 1."""
    radius_m: float
    """Contact radius [m] from the second moment of the contact forces: sum f r^2 = 2/5 a^2 F."""
    outermost_m: float
    """Distance of the outermost node that carries force from the axis [m]."""
    element_m: float
    """Longest edge of a surface face in the contact [m]."""
    node_count: int
    residual_n: float
    radii_m: np.ndarray
    """Distance of the loaded nodes from the axis [m]."""
    pressures_pa: np.ndarray
    """Contact force over area of the loaded nodes [Pa]."""


def press(case: HertzCase) -> HertzResult:
    """Press the ball to its depth in one step."""
    dhat = case.dhat_over_depth * case.depth_m
    block = HalfSpace(
        half_space_mesh(
            case.contact_radius_m,
            case.cells,
            DOMAIN_OVER_RADIUS * case.contact_radius_m,
            case.growth,
        ),
        Ball(case.ball_radius_m),
        young_pa=case.young_pa,
        poisson=case.poisson_ratio,
        config=SolverConfig(dhat_m=dhat, absolute_tolerance_n=1e-12),
        start_m=case.ball_radius_m + 2 * dhat,
        element=case.element,
    )
    report = block.move(0.0, case.ball_radius_m - case.depth_m)
    positions, force = block.positions_m, block.normal_n
    size = np.linalg.norm(force, axis=1)
    loaded = np.flatnonzero(size > 1e-3 * size.max())
    radii = np.hypot(positions[:, 0], positions[:, 1])
    first, last = block.model.bodies[0].faces
    top = block.model.surface.faces.numpy()[first:last]
    corners = positions[top[np.isin(top, loaded).any(axis=1)]]
    total = -float(force[:, 2].sum())
    return HertzResult(
        force_n=total,
        force_error=total / case.force_n - 1,
        radius_m=float(np.sqrt(2.5 * (size * radii**2).sum() / size.sum())),
        outermost_m=float(radii[loaded].max()),
        element_m=float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max()),
        node_count=len(positions),
        residual_n=float(report.residual_n[0]),
        radii_m=radii[loaded],
        pressures_pa=size[loaded] / block.areas_m2[loaded],
    )


HERTZ_RADIUS = HertzCase().contact_radius_m


@lru_cache
def pressed(cells: int, poisson: float = 0.3, dhat: float = 0.002) -> HertzResult:
    return press(HertzCase(cells=cells, poisson_ratio=poisson, dhat_over_depth=dhat))


def test_force_converges_to_hertz_with_the_square_of_the_element_size() -> None:
    coarse, middle, fine = (pressed(n).force_error for n in (3, 4, 5))
    assert coarse > middle > fine > 0, "linear tets are too stiff"
    limit = fine - (middle - fine) / ((5 / 4) ** 2 - 1)
    assert abs(limit) < 0.02, "the rest is the size of the block, dhat and a / R"
    order = np.log((coarse - limit) / (fine - limit)) / np.log(5 / 3)
    assert order == pytest.approx(2.0, abs=0.3)
    assert fine < 0.05, "below 0.042 with 6 cells, by the square of the element size"


@pytest.mark.slow
def test_force_is_below_four_percent() -> None:
    assert 0 < pressed(6).force_error < 0.042


@pytest.mark.parametrize("cells", [4, 5, pytest.param(6, marks=pytest.mark.slow)])
def test_contact_radius_is_within_one_element(cells: int) -> None:
    result = pressed(cells)
    assert result.element_m < 1.5 * HERTZ_RADIUS / cells
    assert abs(result.outermost_m - HERTZ_RADIUS) < result.element_m
    # The second moment of the pressure is finer than the mesh.
    assert result.radius_m == pytest.approx(HERTZ_RADIUS, rel=0.01)


@pytest.mark.parametrize("cells", [5, pytest.param(6, marks=pytest.mark.slow)])
def test_pressure_is_an_ellipse(cells: int) -> None:
    result, case = pressed(cells), HertzCase(cells=cells)
    peak = 1.5 * case.force_n / (np.pi * HERTZ_RADIUS**2)
    inside = result.radii_m < 0.8 * HERTZ_RADIUS
    expected = peak * np.sqrt(1 - (result.radii_m[inside] / HERTZ_RADIUS) ** 2)
    error = result.pressures_pa[inside] / expected - 1
    assert inside.sum() > 40
    assert np.sqrt((error**2).mean()) < 0.07


@pytest.mark.parametrize("cells", [(3, 4), pytest.param((4, 6), marks=pytest.mark.slow)])
def test_dhat_acts_like_depth(cells: tuple[int, int]) -> None:
    """Contact begins at a gap of dhat: the force grows like that of a depth larger by dhat.

    In the limit of fine meshes: at the small dhat the chords of coarse faces hold the ball up, at
    the large one they do not reach it.
    """

    def limit(dhat: float) -> float:
        coarse, fine = (pressed(n, dhat=dhat).force_n for n in cells)
        return fine - (coarse - fine) / ((cells[1] / cells[0]) ** 2 - 1)

    ratio = limit(0.05) / limit(0.002)
    assert ratio == pytest.approx(((1 + 0.05) / (1 + 0.002)) ** 1.5, rel=0.01)


@pytest.mark.slow
def test_force_is_within_three_percent() -> None:
    result = pressed(8)
    assert abs(result.force_error) < 0.03
    assert abs(result.outermost_m - HERTZ_RADIUS) < result.element_m
    assert result.residual_n < 1e-4 * result.force_n


def test_quadratic_tets_are_within_two_percent() -> None:
    """With 4,600 nodes (linear tets: 94,000 for 2.1 %), and near nu = 0.5 too."""
    result = press(HertzCase(2, Element.QUADRATIC))
    assert result.node_count < 5_000
    assert abs(result.force_error) < 0.02
    assert abs(result.outermost_m - HERTZ_RADIUS) < result.element_m
    assert result.residual_n < 1e-4 * result.force_n
    almost = press(HertzCase(2, Element.QUADRATIC, poisson_ratio=0.499))
    assert abs(almost.force_error) < 0.035


@pytest.mark.slow
def test_quadratic_tets_give_the_contact_radius() -> None:
    result = press(HertzCase(3, Element.QUADRATIC))
    assert result.node_count < 15_000
    assert abs(result.force_error) < 0.02
    assert abs(result.outermost_m - HERTZ_RADIUS) < result.element_m
    assert result.radius_m == pytest.approx(HERTZ_RADIUS, rel=0.015)


@pytest.mark.slow
def test_a_finer_mesh_is_closer() -> None:
    assert abs(pressed(10).force_error) < 0.024


@pytest.mark.slow
def test_linear_tets_lock_more_as_poisson_ratio_grows() -> None:
    soft, stiff = pressed(6), pressed(6, poisson=0.45)
    assert 1.3 * soft.force_error < stiff.force_error < 0.08


PUNCH, PUNCH_DEPTH, PUNCH_YOUNG = 1e-3, 5e-6, 1e5
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
    height, dhat = PUNCH, dhat_over_depth * PUNCH_DEPTH
    total = DOMAIN_OVER_RADIUS * PUNCH
    mesh = half_space_mesh(PUNCH, cells, total, GROWTH, roundness=1.0, grading=1.5)
    radius = PUNCH * 1.0001 / np.cos(np.pi / SEGMENTS)
    block = HalfSpace(
        mesh,
        cylinder_mesh(radius, height, SEGMENTS),
        young_pa=PUNCH_YOUNG,
        poisson=poisson,
        start_m=height / 2 + 2 * dhat,
        config=SolverConfig(dhat_m=dhat, relative_tolerance=1e-5, absolute_tolerance_n=1e-12),
    )
    stiffness = 2 * PUNCH * PUNCH_YOUNG / (1 - poisson**2)
    forces, errors = [], []
    for depth in (0.5 * PUNCH_DEPTH, PUNCH_DEPTH):
        block.move(0.0, height / 2 - depth)
        normal = -block.normal_n[:, 2]
        under = (np.hypot(*block.rest_m[:, :2].T) < 0.9 * PUNCH) & (normal > 0)
        gap = float((-depth - block.positions_m[under, 2]).mean())
        forces.append(float(normal.sum()))
        errors.append(forces[-1] / (stiffness * (depth + gap)) - 1)
    radii = np.hypot(*block.positions_m[:, :2].T)
    gyration = np.sqrt((normal * radii**2).sum() / normal.sum())
    return Punched(
        half_error=errors[0],
        error=errors[1],
        slope_error=(forces[1] - forces[0]) / (stiffness * PUNCH_DEPTH / 2) - 1,
        gap=gap / dhat,
        spread=float(gyration / (np.sqrt(2 / 3) * PUNCH)),
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
