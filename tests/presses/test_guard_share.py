# SPDX-License-Identifier: Apache-2.0
"""What the guard against inside-out tets has of a force: nothing of most, and said where some."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

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

TOOL, DEPTH_MM = "edge:30x6", 0.6
GEL = Material(0.15e6, 0.48)


def at_rest(
    tool_text: str,
    depth_mm: float,
    envs: int = 1,
    friction: float = 0.0,
    gel: Material = GEL,
    physics: PressPhysics = PHYSICS[Accuracy.DEFAULT],
) -> PressEnv:
    tool = parse_indenter(tool_text)
    mesh = press_mesh("flat_pad", {}, (0.0, 0.0), tool.contact(depth_mm), physics.mesh)
    places = np.zeros((envs, 2))
    return PressEnv(mesh, gel, tool, places, friction_coefficient=friction, physics=physics)


@cache
def deep_edge(friction: float = 0.0, gel: Material = GEL) -> PressEnv:
    """A sharp edge in a gel that is nearly incompressible."""
    env = at_rest(TOOL, DEPTH_MM, friction=friction, gel=gel)
    env.follow(PressPath(DEPTH_MM))
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
    before, told = env.press_force[0, 2], env.guard_share()[0]
    assert 1e-3 < told < 0.01
    # Forces inside the gel would say 54 per cent.
    for module in (volume_bounds, quadratic_shape):
        monkeypatch.setattr(module, "GUARDED_RATIO", wp.constant(wp.float64(0.01)))
    (part,) = env.solver.elastic
    law = replace(elastic_point_law(part.group.law), name="late_guard")
    own, kept = part.kernels, env.state.copy()
    try:
        part.kernels = create_quadratic_kernels(law)
        env.solver.graph.clear()
        assert env.solver.step(env.state, env.poses, again=True).converged.all()
        after = env.press_force[0, 2]
        squeezed = smallest_ratios(env.solver.elastic, env.state.positions)[0]
    finally:
        part.kernels = own
        env.solver.graph.clear()
        env.state.restore(kept, np.ones(1, dtype=bool))
        env.solver.refresh_forces(env.state, np.ones(1, dtype=bool))
    assert 0 < squeezed < 0.01
    assert told == pytest.approx(abs(after / before - 1), rel=0.4)


@pytest.mark.thorough
def test_a_batch_tells_what_each_press_does_alone():
    fast = PHYSICS[Accuracy.FAST]
    alone = at_rest(TOOL, DEPTH_MM, physics=fast)
    alone.follow(PressPath(DEPTH_MM))
    env = at_rest(TOOL, DEPTH_MM, 2, physics=fast)
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
