# SPDX-License-Identifier: Apache-2.0
"""What the guard against inside-out tets has of a force: nothing of most, and said where some."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import warp as wp

from taccel_lab.ipc.elasticity import volume_bounds
from taccel_lab.ipc.potentials.elements import quadratic_shape
from taccel_lab.ipc.potentials.elements.inversion import smallest_ratios
from taccel_lab.ipc.potentials.elements.quadratic_kernels import create_quadratic_kernels
from taccel_lab.ipc.potentials.elements.quadratic_points import elastic_point_law
from taccel_lab.presses import PHYSICS, Accuracy, PressEnv, PressPath, PressPhysics, parse_indenter
from taccel_lab.scene import Material, MaxwellBranch
from taccel_lab.sensors.press_mesh import press_mesh

GEL = Material(0.15e6, 0.48)
DEFAULT, FAST = PHYSICS[Accuracy.DEFAULT], PHYSICS[Accuracy.FAST]


def at_rest(
    indenter: str = "edge:30x6", depth_mm: float = 0.6, envs: int = 1, gel: Material = GEL,
    physics: PressPhysics = DEFAULT, **options: Any,
) -> PressEnv:  # fmt: skip
    tool = parse_indenter(indenter)
    mesh = press_mesh("flat_pad", {}, (0.0, 0.0), tool.contact(depth_mm), physics.mesh)
    return PressEnv(mesh, gel, tool, np.zeros((envs, 2)), physics=physics, **options)


@cache
def deep_edge(friction: float = 0.0, gel: Material = GEL) -> PressEnv:
    """A sharp edge in a gel that is nearly incompressible."""
    env = at_rest(gel=gel, friction_coefficient=friction)
    env.follow(PressPath(0.6))
    return env


def test_a_gentle_press_has_nothing_of_it():
    env = at_rest("sphere:4", 0.2)
    assert env.guard_share()[0] == 0.0
    env.follow(PressPath(0.2))
    assert smallest_ratios(env.solver.elastic, env.state.positions)[0] > 0.5
    assert env.guard_share()[0] == 0.0


@pytest.mark.thorough
@pytest.mark.parametrize("friction", [0.0, pytest.param(0.5, marks=pytest.mark.slow)])
def test_it_is_what_the_force_loses_without_a_guard(friction, monkeypatch):
    """A threshold of 0.01 in place of 0.1 leaves next to nothing of the guard: the force of seven
    pins and edges changes by 0.8 to 1.3 times the share."""
    env = deep_edge(friction)
    before, share = env.press_force[0, 2], env.guard_share()[0]
    # Forces inside the gel would say 54 per cent.
    assert 1e-3 < share < 0.01
    for module in (volume_bounds, quadratic_shape):
        monkeypatch.setattr(module, "GUARDED_RATIO", wp.constant(wp.float64(0.01)))
    (part,) = env.solver.elastic
    law = replace(elastic_point_law(part.group.law), name="late_guard")
    own, kept, whole = part.kernels, env.state.copy(), np.ones(1, dtype=bool)
    try:
        part.kernels = create_quadratic_kernels(law)
        env.solver.graph.clear()
        assert env.solver.step(env.state, env.poses, again=True).converged.all()
        after = env.press_force[0, 2]
        squeezed = smallest_ratios(env.solver.elastic, env.state.positions)[0]
    finally:
        part.kernels = own
        env.solver.graph.clear()
        env.state.restore(kept, whole)
        env.solver.refresh_forces(env.state, whole)
    assert 0 < squeezed < 0.01
    assert share == pytest.approx(abs(after / before - 1), rel=0.4)


@pytest.mark.thorough
def test_a_batch_says_what_each_press_does_alone():
    alone, env = (at_rest(envs=envs, physics=FAST) for envs in (1, 2))
    alone.follow(PressPath(0.6))
    for step in range(1, 4):
        env.move_to(np.array([0.05, 0.2 * step]))
    gentle, hard = env.guard_share()
    assert gentle == 0.0 < hard
    assert hard == pytest.approx(alone.guard_share()[0], rel=1e-3)


@pytest.mark.slow
def test_a_gel_that_relaxes_has_it_too():
    """Of branches that are gone in a moment, what the gel without any has; the tangent counts the
    past of the last step."""
    gone = replace(GEL, branches=(MaxwellBranch(0.5, 1e-3),))
    alone = deep_edge().guard_share()[0]
    assert deep_edge(gel=gone).guard_share()[0] == pytest.approx(alone, rel=0.1)
