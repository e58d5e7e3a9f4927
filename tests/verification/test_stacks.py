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
    return Run(affine_scene(cubes, planes=Plane(friction_coefficient=0.5)))


@pytest.mark.parametrize(
    "densities",
    [[10.0, 10_000.0], [10_000.0, 10.0], [10.0, 100.0, 1000.0, 10_000.0]],
    ids=["heavy on light", "light on heavy", "ever heavier"],
)
def test_mass_ratio_of_a_thousand(densities: list[float]) -> None:
    run = cube_stack(densities)
    run.steps(25)
    assert run.crossings() == []
    assert run.strain < 1e-4
    # All within a few gaps of where they were put, none turned.
    np.testing.assert_allclose(run.maps, np.tile(np.eye(3), (len(densities), 1, 1)), atol=1e-4)
    np.testing.assert_allclose(run.y[:, 0, :2], 0, atol=1e-5)
    np.testing.assert_allclose(run.force(-1)[2], -run.weight, rtol=1e-3)


@pytest.mark.thorough
def test_stiffness_ratio_of_ten_thousand() -> None:
    soft, edge = 1e5, 0.1
    run = cube_stack([1000.0] * 3, [1e9, soft, 1e9])
    for _ in range(80):
        run.step()
        assert run.crossings() == []
    squeezed = 1 - np.linalg.norm(run.maps[1][:, 2])
    # Half of its own weight acts on the mean strain.
    expected = 1.5 * 1000 * edge * G / soft
    assert squeezed == pytest.approx(expected, rel=0.03)
    assert np.linalg.norm(run.maps[[0, 2]] - np.eye(3), axis=(1, 2)).max() < 1e-4
    np.testing.assert_allclose(run.force(-1)[2], -run.weight, rtol=1e-2)


HEIGHT, THICKNESS, WIDTH, LEAN = 0.1, 2e-3, 0.06, np.radians(20)
REACH = THICKNESS / 2 * np.cos(LEAN) + HEIGHT / 2 * np.sin(LEAN)
RISE = THICKNESS / 2 * np.sin(LEAN) + HEIGHT / 2 * np.cos(LEAN)


def leaning_pair(friction: float) -> list[AffineBody]:
    return [
        box(
            f"card {side}",
            (THICKNESS, WIDTH, HEIGHT),
            (side * (REACH + GAP / 2), 0, RISE + GAP),
            turned((0, 1, 0), -side * LEAN),
            density_kg_m3=500.0,
            friction_coefficient=friction,
        )
        for side in (-1, 1)
    ]


@pytest.mark.parametrize("stands", [True, False])
def test_two_cards_need_the_friction_that_statics_asks_for(stands: bool) -> None:
    """Moments about the foot: H (h cos) = W (h/2 sin - t/2 cos); 5 % more or less than H / W."""
    needed = np.tan(LEAN) / 2 - THICKNESS / (2 * HEIGHT)
    friction = float(needed * (1.05 if stands else 0.95))
    floor = Plane(friction_coefficient=friction)
    run = Run(affine_scene(leaning_pair(friction), planes=floor, dt=0.025))
    run.step()
    start = run.vertices
    for _ in range(8):
        run.step()
        assert run.crossings() == []
    moved = np.abs(run.vertices - start).max()
    assert moved < 1e-5 if stands else moved > 1e-3


def voussoir(inner: float, outer: float, low: float, high: float, depth: float) -> TriangleMesh:
    """A block between two radii and two angles from the x axis, its sides GAP / 2 off them."""
    corners = [
        (
            radius * np.cos(angle) - side * np.sin(angle),
            y,
            radius * np.sin(angle) + side * np.cos(angle),
        )
        for y in (-depth / 2, depth / 2)
        for radius in (inner, outer)
        for angle, side in ((low, GAP / 2), (high, -GAP / 2))
    ]
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return TriangleMesh(np.array(corners), np.array(faces))


def arch(thickness: float) -> Run:
    """A half circle of radius 1 of 27 voussoirs on the ground: 2300 kg/m^3, 20 GPa."""
    blocks = [
        AffineBody(
            voussoir(1 - thickness / 2, 1 + thickness / 2, low, high, 0.4),
            density_kg_m3=2300,
            young_modulus_pa=2e10,
            name=f"voussoir {i}",
            friction_coefficient=0.6,
            initial_pose=np.array([0, 0, GAP / 2, 0, 0, 0, 1]),
        )
        for i, (low, high) in enumerate(pairwise(np.linspace(0, np.pi, 28)))
    ]
    scene = affine_scene(blocks, planes=Plane(friction_coefficient=0.6))
    return Run(scene, SolverConfig(friction_speed_m_s=1e-5))


@pytest.mark.thorough
def test_a_masonry_arch_stands() -> None:
    """A half circle needs a thickness of 0.1075 [Heyman 1969, The safety of masonry arches]."""
    run = arch(0.2)
    start = run.vertices
    run.steps(10)
    settled = run.vertices
    # The 28 joints close by some micrometres each, and then no more.
    assert np.abs(settled - start).max() < 2e-4
    run.steps(5)
    assert np.abs(run.vertices - settled).max() < 5e-6
    assert run.crossings() == []
    assert run.strain < 1e-5
    np.testing.assert_allclose(run.force(-1)[2], -run.weight, rtol=1e-3)


@pytest.mark.thorough
def test_a_thin_masonry_arch_falls() -> None:
    run = arch(0.05)
    crown = run.y[13, 0, 2]
    drops = []
    for _ in range(16):
        run.step()
        drops.append(crown - run.y[13, 0, 2])
    assert run.crossings() == []
    assert drops[-1] > 3 * drops[-8] > 5e-3


@pytest.mark.slow
def test_a_masonry_arch_stands_for_twenty_seconds() -> None:
    run = arch(0.2)
    start = run.vertices
    for step in range(2000):
        run.step()
        if step % 50 == 0:
            assert run.crossings() == []
    assert run.crossings() == []
    assert np.abs(run.vertices - start).max() < 1e-3
