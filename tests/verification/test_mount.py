# SPDX-License-Identifier: Apache-2.0
"""Gels on moving mounts: bonded nodes follow exactly, and only relative motion matters."""

from __future__ import annotations

import numpy as np
import pytest

from taccel_lab.bodies.material import MaxwellBranch
from taccel_lab.model.embedding import rotate
from taccel_lab.scene import Ball, Element, KinematicBody, Material, Scene, SoftBody, TimeStepping
from taccel_lab.solvers import SolverConfig, SolverIPC
from taccel_lab.state import initial_state
from tests.support.blocks import block_mesh, everywhere, pose
from tests.support.variants import variants

GEL = Material(1e5, 0.45, 1000.0)
MESH = block_mesh((5, 5, 2), (6e-3, 6e-3, 2e-3), jitter=0.15)
RADIUS = 2e-3
DHAT = 2e-5


def carried(points: np.ndarray, at: np.ndarray) -> np.ndarray:
    return rotate(at[3:], points) + at[:3]


@pytest.mark.parametrize("element", variants([Element.QUADRATIC], Element))
def test_a_mount_carries_the_gel_without_strain(element: Element) -> None:
    """Large turns and shifts in one step: the gel is where its frame puts it."""
    soft = SoftBody(MESH, GEL, mount="hand", element=element)
    model = Scene(soft, KinematicBody(None, name="hand")).finalize()
    solver = SolverIPC(model, SolverConfig(absolute_tolerance_n=1e-10))
    start = pose(1e-2, -2e-2, 3e-2, (1, 2, 3), 30)
    state = initial_state(model, everywhere(1, start))
    rest = model.rest_positions.numpy()[0]
    np.testing.assert_allclose(state.positions.numpy()[0], carried(rest, start), atol=1e-16)
    for target in (pose(1e-2, 1e-2, 0, (0, 1, 1), 75), pose(0, 0, 0, (1, 0, 0), -20)):
        report = solver.step(state, everywhere(1, target))
        assert report.converged.all(), report.summary()
        x = state.positions.numpy()[0]
        bonded = model.frame_nodes.numpy()
        np.testing.assert_allclose(x[bonded], carried(rest, target)[bonded], atol=1e-16)
        np.testing.assert_allclose(x, carried(rest, target), atol=1e-10)


@pytest.mark.thorough(cases=("quadratic-0.0",))
@pytest.mark.parametrize(
    ("element", "friction"),
    [(Element.LINEAR, 0.0), (Element.LINEAR, 0.6), (Element.QUADRATIC, 0.0)],
)
def test_moving_the_gel_or_the_ball_is_the_same_press(element: Element, friction: float) -> None:
    """Press, then shear by the same relative motion; compared in the frame of the gel."""
    config = SolverConfig(dhat_m=DHAT, relative_tolerance=1e-7)
    path = [(0.0, 0.2e-3), (0.0, 0.4e-3), (0.1e-3, 0.4e-3)]
    ball = KinematicBody(Ball(RADIUS), friction)
    fixed = Scene(SoftBody(MESH, GEL, element=element), ball).finalize()
    moved = Scene(
        SoftBody(MESH, GEL, mount="hand", element=element), [ball, KinematicBody(None, name="hand")]
    ).finalize()
    soft = slice(0, fixed.soft_count)
    solvers = [SolverIPC(model, config) for model in (fixed, moved)]
    gap = RADIUS + 3 * DHAT
    still = pose(0, 0, gap)
    states = [
        initial_state(fixed, everywhere(1, pose(0, 0, gap))),
        initial_state(moved, everywhere(1, still, pose(0, 0, 0))),
    ]
    for side, depth in path:
        down = depth + 3 * DHAT
        targets = [
            everywhere(1, pose(side, 0, gap - down)),
            everywhere(1, still, pose(-side, 0, down)),
        ]
        forces = []
        for solver, state, target in zip(solvers, states, targets, strict=True):
            report = solver.step(state, target)
            assert report.converged.all(), report.summary()
            total = solver.contact_gradient.numpy() + solver.friction_gradient.numpy()
            forces.append(total[0, soft])
        shift = np.array([-side, 0, down])
        held, gel = (state.positions.numpy()[0, soft] for state in states)
        scale = np.abs(forces[0]).max()
        np.testing.assert_allclose(forces[1], forces[0], atol=1e-4 * scale)
        np.testing.assert_allclose(gel - shift, held, atol=2e-9)
    assert scale > 1e-2
    assert (np.abs(solvers[1].friction_gradient.numpy()).max() > 1e-3) == (friction > 0)


def test_the_mount_feels_the_mass_of_the_gel() -> None:
    """Accelerated steadily, elastic forces at the bonded nodes carry the free mass: F = m a."""
    a, dt = 5.0, 2e-3
    damped = Material(3e5, 0.4, 1000.0, branches=(MaxwellBranch(2.0, 5e-3),))
    soft = SoftBody(MESH, damped, mount="hand", element=Element.LINEAR)
    time = TimeStepping(quasi_static=False, dt_s=dt)
    model = Scene(soft, KinematicBody(None, name="hand"), time=time).finalize()
    solver = SolverIPC(model, SolverConfig(absolute_tolerance_n=1e-9))
    state = initial_state(model, everywhere(1, pose(0, 0, 0)))
    for step in range(1, 60):
        # The second difference of the positions is a dt^2 from the second step on.
        x = 0.5 * a * (step * dt) * ((step + 1) * dt)
        assert solver.step(state, everywhere(1, pose(x, 0, 0))).converged.all()
    solver.gradient.zero_()
    solver.active.fill_(1)
    for part in [*solver.elastic, *solver.maxwell]:
        part.add_gradient(solver.active, state.positions, solver.gradient)
    pull = solver.gradient.numpy()[0, model.frame_nodes.numpy()].sum(axis=0)
    free = model.masses.numpy()[0, model.free_nodes.numpy()].sum()
    np.testing.assert_allclose(pull, [free * a, 0, 0], atol=2e-3 * free * a)
