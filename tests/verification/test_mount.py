# SPDX-License-Identifier: Apache-2.0
"""Gels on moving mounts: bonded nodes follow exactly, and only relative motion matters."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.bodies.material import MaxwellBranch
from taccel_lab.model.embedding import rotate
from taccel_lab.scene import Ball, Element, KinematicBody, Material, Scene, SoftBody
from tests.support.blocks import block_mesh, pose
from tests.support.scene_steps import Stepped, in_time, linear
from tests.support.variants import variants

GEL = Material(1e5, 0.45, 1000.0)
MESH = block_mesh((5, 5, 2), (6e-3, 6e-3, 2e-3), jitter=0.15)
RADIUS = 2e-3
DHAT = 2e-5
HAND = KinematicBody(None, name="hand")


def carried(points: np.ndarray, at: np.ndarray) -> np.ndarray:
    return rotate(at[3:], points) + at[:3]


@pytest.mark.parametrize("element", variants([Element.QUADRATIC], Element))
def test_a_mount_carries_the_gel_without_strain(element: Element) -> None:
    start = pose(1e-2, -2e-2, 3e-2, (1, 2, 3), 30)
    gel = SoftBody(MESH, GEL, mount="hand", element=element)
    run = Stepped(Scene(gel, HAND), start, absolute_tolerance_n=1e-10)
    np.testing.assert_allclose(run.x(), carried(run.rest, start), atol=1e-16)
    for target in (pose(1e-2, 1e-2, 0, (0, 1, 1), 75), pose(0, 0, 0, (1, 0, 0), -20)):
        run.step(target)
        expected, bonded = carried(run.rest, target), run.model.frame_nodes.numpy()
        np.testing.assert_allclose(run.x()[bonded], expected[bonded], atol=1e-16)
        np.testing.assert_allclose(run.x(), expected, atol=1e-10)


@pytest.mark.thorough(cases=("quadratic-0.0",))
@pytest.mark.parametrize(
    ("element", "friction"),
    [(Element.LINEAR, 0.0), (Element.LINEAR, 0.6), (Element.QUADRATIC, 0.0)],
)
def test_moving_the_gel_or_the_ball_is_the_same_press(element: Element, friction: float) -> None:
    ball, gap = KinematicBody(Ball(RADIUS), friction), RADIUS + 3 * DHAT
    still, config = pose(0, 0, gap), {"dhat_m": DHAT, "relative_tolerance": 1e-7}
    fixed = Stepped(Scene(SoftBody(MESH, GEL, element=element), ball), still, **config)
    scene = Scene(SoftBody(MESH, GEL, mount="hand", element=element), [ball, HAND])
    moved = Stepped(scene, still, pose(0, 0, 0), **config)
    for side, depth in ((0.0, 0.2e-3), (0.0, 0.4e-3), (0.1e-3, 0.4e-3)):
        down = depth + 3 * DHAT
        fixed.step(pose(side, 0, gap - down))
        moved.step(still, pose(-side, 0, down))
        forces = [run.contact(0) + run.friction(0) for run in (fixed, moved)]
        scale = np.abs(forces[0]).max()
        np.testing.assert_allclose(forces[1], forces[0], atol=1e-4 * scale)
        np.testing.assert_allclose(moved.x(0) - [-side, 0, down], fixed.x(0), atol=2e-9)
    assert scale > 1e-2
    assert (np.abs(moved.friction()).max() > 1e-3) == (friction > 0)


def test_the_mount_feels_the_mass_of_the_gel() -> None:
    """Accelerated steadily, elastic forces at the bonded nodes carry the free mass: F = m a."""
    a, dt = 5.0, 2e-3
    damped = Material(3e5, 0.4, 1000.0, branches=(MaxwellBranch(2.0, 5e-3),))
    scene = Scene(linear(MESH, damped, mount="hand"), HAND, time=in_time(dt, 0.0))
    run = Stepped(scene, absolute_tolerance_n=1e-9)
    for step in range(1, 60):
        # The second difference of the positions is a dt^2 from the second step on.
        x = 0.5 * a * (step * dt) * ((step + 1) * dt)
        run.step(pose(x, 0, 0))
    solver, model = run.solver, run.model
    solver.gradient.zero_()
    solver.active.fill_(1)
    for part in [*solver.elastic, *solver.maxwell]:
        part.add_gradient(solver.active, run.state.positions, solver.gradient)
    pull = solver.gradient.numpy()[0, model.frame_nodes.numpy()].sum(axis=0)
    free = model.masses.numpy()[0, model.free_nodes.numpy()].sum()
    np.testing.assert_allclose(pull, [free * a, 0, 0], atol=2e-3 * free * a)
