# SPDX-License-Identifier: Apache-2.0
"""Structures of many affine bodies that stand by contact and friction alone, or must fall."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from taccel_lab.scene import AffineBody, Plane, TriangleMesh
from taccel_lab.solvers import SolverConfig
from tests.verification.affine_scenes import G, Run, affine_scene, box, turned

GAP = 1e-5


def plane_force(run: Run) -> np.ndarray:
    """Contact force on the plane [N]: what its origin node feels."""
    return -run.solver.contact_gradient.numpy()[0, run.model.bodies[-1].nodes[0]]


def weight(run: Run) -> float:
    return float(run.masses[:, 0].sum() * G)


def cube_stack(densities: list[float], moduli: list[float] | None = None, edge: float = 0.1) -> Run:
    cubes = [
        box(
            f"cube {i}",
            (edge, edge, edge),
            (0, 0, (i + 0.5) * edge + (i + 1) * GAP),
            density_kg_m3=density,
            young_modulus_pa=moduli[i] if moduli else 1e9,
            friction_coefficient=0.5,
        )
        for i, density in enumerate(densities)
    ]
    return Run(affine_scene(cubes, planes=[Plane(friction_coefficient=0.5)]))


@pytest.mark.parametrize(
    "densities",
    [[10.0, 10_000.0], [10_000.0, 10.0], [10.0, 100.0, 1000.0, 10_000.0]],
    ids=["heavy on light", "light on heavy", "ever heavier"],
)
def test_mass_ratio_of_a_thousand(densities: list[float]) -> None:
    run = cube_stack(densities)
    for _ in range(25):
        run.step()
    assert run.overlaps() == []
    assert run.strain < 1e-4
    # All within a few gaps of where they were put, none turned.
    np.testing.assert_allclose(run.maps, np.tile(np.eye(3), (len(densities), 1, 1)), atol=1e-4)
    np.testing.assert_allclose(run.y[:, 0, :2], 0, atol=1e-5)
    np.testing.assert_allclose(plane_force(run)[2], -weight(run), rtol=1e-3)


@pytest.mark.thorough
def test_stiffness_ratio_of_ten_thousand() -> None:
    """A soft cube between stiff ones is squeezed, by the weight on it over E A."""
    soft, edge = 1e5, 0.1
    run = cube_stack([1000.0] * 3, [1e9, soft, 1e9])
    for _ in range(80):
        run.step()
        assert run.overlaps() == []
    squeezed = 1 - np.linalg.norm(run.maps[1][:, 2])
    # Half of its own weight acts on the mean strain.
    expected = 1.5 * 1000 * edge * G / soft
    assert squeezed == pytest.approx(expected, rel=0.03)
    assert np.linalg.norm(run.maps[[0, 2]] - np.eye(3), axis=(1, 2)).max() < 1e-4
    np.testing.assert_allclose(plane_force(run)[2], -weight(run), rtol=1e-2)


# Card house ------------------------------------------------------------------------------------


HEIGHT, THICKNESS, WIDTH, LEAN = 0.1, 2e-3, 0.06, np.radians(20)
REACH = THICKNESS / 2 * np.cos(LEAN) + HEIGHT / 2 * np.sin(LEAN)
RISE = THICKNESS / 2 * np.sin(LEAN) + HEIGHT / 2 * np.cos(LEAN)


def card(
    name: str, size: tuple[float, float, float], friction: float, *place: object
) -> AffineBody:
    return box(name, size, *place, density_kg_m3=500.0, friction_coefficient=friction)  # type: ignore[arg-type]


def leaning_pair(x: float, z: float, name: str, friction: float) -> list[AffineBody]:
    """Two cards that lean on each other, 20 degrees from upright, their feet at height z."""
    return [
        card(
            f"{name} {side}",
            (THICKNESS, WIDTH, HEIGHT),
            friction,
            (x + side * (REACH + GAP / 2), 0, z + RISE + GAP),
            turned((0, 1, 0), -side * LEAN),
        )
        for side in (-1, 1)
    ]


@pytest.mark.parametrize("stands", [True, False])
def test_two_cards_need_the_friction_that_statics_asks_for(stands: bool) -> None:
    """Moments about the foot: H (h cos) = W (h/2 sin - t/2 cos); 5 % more or less than H / W."""
    needed = np.tan(LEAN) / 2 - THICKNESS / (2 * HEIGHT)
    friction = float(needed * (1.05 if stands else 0.95))
    cards = leaning_pair(0, 0, "card", friction)
    run = Run(affine_scene(cards, planes=[Plane(friction_coefficient=friction)], dt=0.025))
    run.step()
    start = run.vertices
    for _ in range(8):
        run.step()
        assert run.overlaps() == []
    moved = np.abs(run.vertices - start).max()
    assert moved < 1e-5 if stands else moved > 1e-3


# Masonry arch ----------------------------------------------------------------------------------


def voussoir(inner: float, outer: float, low: float, high: float, depth: float) -> TriangleMesh:
    """A block between two radii and two angles from the x axis, its sides GAP / 2 off them."""
    corners = []
    for y in (-depth / 2, depth / 2):
        for radius in (inner, outer):
            for angle, side in ((low, 1), (high, -1)):
                along = np.array([np.cos(angle), 0, np.sin(angle)])
                across = np.array([-np.sin(angle), 0, np.cos(angle)])
                corners.append(radius * along + side * GAP / 2 * across + [0, y, 0])
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return TriangleMesh(np.array(corners), np.array(faces))


def arch(thickness: float, radius: float = 1.0, count: int = 27, friction: float = 0.6) -> Run:
    """A half circle of voussoirs between two springings on the ground: 2300 kg/m^3, 20 GPa."""
    angles = np.linspace(0, np.pi, count + 1)
    blocks = [
        AffineBody(
            voussoir(radius - thickness / 2, radius + thickness / 2, low, high, 0.4),
            density_kg_m3=2300,
            young_modulus_pa=2e10,
            name=f"voussoir {i}",
            friction_coefficient=friction,
            initial_pose=np.array([0, 0, GAP / 2, 0, 0, 0, 1]),
        )
        for i, (low, high) in enumerate(pairwise(angles))
    ]
    scene = affine_scene(blocks, planes=[Plane(friction_coefficient=friction)])
    return Run(scene, SolverConfig(friction_speed_m_s=1e-5))


@pytest.mark.thorough
def test_a_masonry_arch_stands() -> None:
    """Thickness over radius 0.2; a half circle needs 0.1075 [Heyman 1969, The safety of masonry
    arches]."""
    run = arch(0.2)
    start = run.vertices
    for _ in range(10):
        run.step()
    settled = run.vertices
    # The 28 joints close by some micrometres each, and then no more.
    assert np.abs(settled - start).max() < 2e-4
    for _ in range(5):
        run.step()
    assert np.abs(run.vertices - settled).max() < 5e-6
    assert run.overlaps() == []
    assert run.strain < 1e-5
    np.testing.assert_allclose(plane_force(run)[2], -weight(run), rtol=1e-3)


@pytest.mark.thorough
def test_a_thin_masonry_arch_falls() -> None:
    """Thickness over radius 0.05: the crown drops between hinges."""
    run = arch(0.05)
    crown = run.y[13, 0, 2]
    drops = []
    for _ in range(16):
        run.step()
        drops.append(crown - run.y[13, 0, 2])
    assert run.overlaps() == []
    assert drops[-1] > 3 * drops[-8] > 5e-3


@pytest.mark.slow
def test_a_masonry_arch_stands_for_twenty_seconds() -> None:
    run = arch(0.2)
    start = run.vertices
    for step in range(2000):
        run.step()
        if step % 50 == 0:
            assert run.overlaps() == []
    assert run.overlaps() == []
    assert np.abs(run.vertices - start).max() < 1e-3
