# SPDX-License-Identifier: Apache-2.0
"""Gradients of whole motions against central differences of the same motions, run anew."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from taccel_lab.geometry.block import block_mesh
from taccel_lab.gradients import Gradients, pull_back
from taccel_lab.scene import (
    Ball,
    Element,
    Material,
    MaterialModel,
    box_mesh,
    cylinder_mesh,
    sphere_mesh,
)
from taccel_lab.state import State
from tests.gradients.gel_scenes import TIGHT, Case, difference, losses, moved, press_and_shear
from tests.support.variants import variants

Array = np.ndarray
BALL = Ball(3e-3)
BOX = box_mesh((3e-3, 2e-3, 2e-3))
MOUNT = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (4, 1))


def one(*tools: Array) -> Array:
    return np.stack(tools, axis=1)[:, None]


def several() -> Array:
    return np.stack([press_and_shear(3.0, depth)[:, None] for depth in (0.1, 0.25, 0.4)], axis=1)


CASES = {
    "ball": Case(BALL, one(press_and_shear(3.0, 0.3))),
    "ball, rubbing": Case(BALL, one(press_and_shear(3.0, 0.3)), friction=0.4),
    "quadratic": Case(BALL, one(press_and_shear(3.0, 0.3)), 0.3, element=Element.QUADRATIC),
    "box on its edge": Case(BOX, one(press_and_shear(1.2, 0.25, 4.0)), friction=0.5),
    "facets": Case(sphere_mesh(3e-3, 1e-3), one(press_and_shear(3.0, 0.3)), friction=0.4),
    "quadratic under an edge": Case(
        cylinder_mesh(1e-3, 2e-3), one(press_and_shear(1.1, 0.2, 3.0)), 0.4,
        element=Element.QUADRATIC,
    ),
    "three environments": Case(BALL, several(), friction=0.4),
    "three environments without friction": Case(BOX, several() - [0, 0, 1.9e-3, 0, 0, 0, 0]),
    "a stiffness of its own": Case(
        BALL, one(press_and_shear(3.0, 0.3)), 0.3, config=replace(TIGHT, kappa_pa=4e5)
    ),
    "on a mount that moves": Case(
        BALL,
        one(
            press_and_shear(3.0, 0.3),
            moved(MOUNT, np.arange(24.0).reshape(4, 6) * [1e-6, 2e-6, 1e-6, 1e-4, 3e-4, 2e-4], 1.0),
        ),
        friction=0.4,
        mounted=True,
    ),
}  # fmt: skip
LAWS = {
    law: Case(
        BALL,
        one(press_and_shear(3.0, 0.3)),
        0.3,
        Material(2e5, 0.42, model=law, mooney_ratio=0.3 if "mooney" in law else 0.0),
    )
    for law in MaterialModel
    if law is not MaterialModel.NEO_HOOKEAN
}


def compare(
    case: Case, find: Callable[[Gradients], Array], changed: Callable[[float], Case], step: float
) -> Array:
    motion, record = case.run()
    weights = losses(record)
    found = find(pull_back(motion, record, *weights))
    expected = difference(changed, step, weights)
    assert (np.abs(expected) > 0).all()
    return np.abs(found - expected) / np.abs(expected)


MODULI = ("young_modulus_pa", "poisson_ratio")
FAST = ("quadratic under an edge", "three environments", "on a mount that moves")
"""Between them all that a slope goes through but the laws. What the first, the dearest, has of its
own comes in with a modulus and the ways of the tools."""


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("which", "name"),
    variants(
        [*((case, MODULI[1]) for case in (*FAST, *LAWS)), (FAST[1], MODULI[0])],
        [*CASES, *LAWS],
        MODULI,
    ),
)
def test_moduli(which: str, name: str) -> None:
    case = (CASES | LAWS)[which]
    size = {"young_modulus_pa": 50.0, "poisson_ratio": 2e-5}[name]

    def changed(by: float) -> Case:
        value = getattr(case.material, name) + by
        return replace(case, material=replace(case.material, **{name: value}))

    def found(gradients: Gradients) -> Array:
        young = name == "young_modulus_pa"
        return (gradients.young_modulus if young else gradients.poisson_ratio)[:, 0]

    assert (compare(case, found, changed, size) < 1e-5).all()


RUBBING = {name: case for name, case in CASES.items() if case.friction > 0}


@pytest.mark.thorough
@pytest.mark.parametrize("which", variants([*FAST[1:], "facets"], RUBBING))
def test_friction(which: str) -> None:
    case = RUBBING[which]
    errors = compare(
        case,
        lambda gradients: gradients.friction[:, 0, 1],
        lambda by: replace(case, friction=case.friction + by),
        1e-5,
    )
    assert (errors < 1e-5).all()


SIZED = (*FAST[1:], "a stiffness of its own")
FLAT = "three environments without friction"
"""Under a flat face nodes of the gel touch, whose areas grow with it."""


@pytest.mark.thorough(cases=SIZED)
@pytest.mark.parametrize("which", variants([*SIZED, FLAT], CASES))
def test_size(which: str) -> None:
    case = CASES[which]
    errors = compare(case, lambda g: g.scale[:, 0], lambda by: replace(case, scale=1 + by), 2e-6)
    assert (errors < 1e-5).all()


@pytest.mark.thorough
@pytest.mark.parametrize("which", variants([*FAST, "box on its edge"], CASES))
def test_ways_of_the_tools(which: str) -> None:
    case = CASES[which]
    way = np.random.default_rng(1).normal(size=(*case.poses.shape[:-1], 6))
    way[..., 3:] *= 100
    small = (moved(case.poses, way, 1e-6) - moved(case.poses, way, -1e-6)) / 2e-6
    errors = compare(
        case,
        lambda gradients: np.einsum("ketp,ketp->e", gradients.poses, small),
        lambda by: replace(case, poses=moved(case.poses, way, by)),
        1e-8,
    )
    assert (errors < 1e-5).all()


FACE_DOWN = press_and_shear(0.0, 0.2) + [0.013e-3, 0.017e-3, 0, 0, 0, 0, 0]
FACE_DOWN[:, 3:] = (
    Rotation.from_quat(FACE_DOWN[:, 3:]) * Rotation.from_rotvec([np.pi, 0, 0])
).as_quat()
BLOCK = block_mesh((7, 7, 2), (7e-3, 7e-3, 3e-3))
GELS = Case(None, one(FACE_DOWN), 0.4, mesh=BLOCK, carried=Material(4e5, 0.4))


@pytest.mark.thorough
def test_a_gel_pressed_onto_another() -> None:
    motion, record = GELS.run()
    weights = losses(record)
    found = pull_back(motion, record, *weights)
    assert np.abs(record.wrenches).max() == 0.0  # The tool is a frame: it touches nothing.
    gel, other = GELS.material, GELS.carried
    assert other is not None

    def stiffer(own: float = 0.0, others: float = 0.0) -> Case:
        mine = replace(gel, young_modulus_pa=gel.young_modulus_pa + own)
        theirs = replace(other, young_modulus_pa=other.young_modulus_pa + others)
        return replace(GELS, material=mine, carried=theirs)

    slopes = {
        "own modulus": (found.young_modulus[0, 0], stiffer, 50.0),
        "the other's": (found.young_modulus[0, 1], lambda by: stiffer(others=by), 50.0),
        "friction": (found.friction[0, 0, 1], lambda by: replace(GELS, friction=0.4 + by), 1e-5),
        "size": (found.scale[0, 0], lambda by: replace(GELS, scale=1 + by), 2e-6),
    }
    for name, (slope, changed, step) in slopes.items():
        expected = difference(changed, step, weights)[0]
        assert slope == pytest.approx(expected, rel=1e-5), name


@pytest.mark.thorough(cases=("quadratic",))
@pytest.mark.parametrize("name", ["ball, rubbing", "quadratic", "facets"])
def test_these_presses_stick_and_slip(name: str) -> None:
    """Contacts in both regimes, or the comparisons above would say little."""
    case = CASES[name]
    motion, record = case.run()
    solver = motion.solver
    positions = wp.array(record.positions[-1], dtype=wp.vec3d)
    end = State(
        positions, wp.zeros_like(positions), wp.array(record.poses[-1], dtype=wp.transformd)
    )
    slopes = motion.derivatives(0, end, solver.origin, solver.origin_poses, False)
    rubbing = slopes.per_friction[:, 0]
    pressing = slopes.forces[:, 0] - case.friction * rubbing
    share = np.linalg.norm(rubbing, axis=1) / np.linalg.norm(pressing, axis=1)
    assert share.min() < 0.9 and share.max() == pytest.approx(1.0, abs=1e-9)
