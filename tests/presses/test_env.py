# SPDX-License-Identifier: Apache-2.0
"""``PressEnv``: converged presses, signs of wrenches, halved steps, limits, batches, and what the
guard against inside-out tets has of a force."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import warp as wp

from taccel_lab.errors import InputError, SimulationError
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.geometry.block import block_mesh
from taccel_lab.ipc.elasticity import volume_bounds
from taccel_lab.ipc.potentials.elements import quadratic_shape
from taccel_lab.ipc.potentials.elements.inversion import smallest_ratios
from taccel_lab.ipc.potentials.elements.quadratic_kernels import create_quadratic_kernels
from taccel_lab.ipc.potentials.elements.quadratic_points import elastic_point_law
from taccel_lab.outputs import Outputs
from taccel_lab.presses import (
    PHYSICS,
    Accuracy,
    PressEnv,
    PressPath,
    PressPhysics,
    PressSetup,
    parse_indenter,
)
from taccel_lab.presses.mesh import press_mesh
from taccel_lab.scene import Material, MaxwellBranch
from taccel_lab.solvers import EnvStatus, SolverConfig
from tests.support.coarse_pads import GEL, LINEAR, pad
from tests.support.intersection import find_intersections

DEFAULT, FAST = PHYSICS[Accuracy.DEFAULT], PHYSICS[Accuracy.FAST]
BALL = parse_indenter("sphere:2.0")


def press_env(
    indenter: str = "sphere:2.0", at_mm: tuple[float, float] = (0.0, 0.0),
    config: SolverConfig | None = None, **options: Any,
) -> PressEnv:  # fmt: skip
    options = {"physics": LINEAR, **options}
    setup = PressSetup(pad(at_mm), GEL, parse_indenter(indenter), **options)
    return PressEnv(setup, np.array([at_mm]), config=config)


@pytest.mark.thorough(cases=("cylinder:1.0", "sphere:2.0"))
@pytest.mark.parametrize("indenter", ["sphere:2.0", "cylinder:1.0", "box:2x1.5"])
def test_force_grows_with_depth(indenter):
    env = press_env(indenter, physics=DEFAULT if indenter == "sphere:2.0" else LINEAR)
    assert env.wrench == pytest.approx(np.zeros((1, 6)), abs=0)
    forces = [0.0]
    for depth in (0.1, 0.2, 0.4, 0.6):
        report = env.move_to(depth)
        assert report.converged.all()
        assert report.residual_n[0] <= 1e-4 * report.contact_force_n[0]
        assert 0 < report.min_distance_m[0] < 2e-5
        assert not find_intersections(env.model, env.state)[0]
        assert env.depth_m[0] == depth * 1e-3
        held_back = env.poses[0, 0, 2] - (env.touch_m[0] - env.depth_m[0])
        assert held_back == pytest.approx(env.setback_m[0], abs=1e-15)
        assert 0.3 * DEFAULT.dhat_m < held_back < DEFAULT.dhat_m
        forces.append(env.wrench[0, 2])
    assert (np.diff(forces) > 0).all()
    if indenter == "sphere:2.0":
        # The floor 5 mm below and the coarse mesh stiffen: Hertz's half-space is the least.
        hertz = 4 / 3 * 1.5e5 / (1 - 0.46**2) * math.sqrt(2e-3) * (0.6e-3) ** 1.5
        assert hertz < forces[-1] < 3 * hertz


def test_no_force_before_first_touch():
    env = press_env()
    # The barrier begins at dhat above touch, and the ball is held back by as much.
    report = env.move_to(-1e-6)
    assert report.contact_force_n[0] == 0.0 and report.min_distance_m[0] == math.inf
    assert env.positions[0] == pytest.approx(env.mesh.nodes_m, abs=1e-15)
    env.move_to(0.005)
    assert env.wrench[0, 2] > 0


@pytest.mark.parametrize("at_mm", [(-3.0, 0.0), (0.0, 2.5), (2.0, -2.0)])
def test_moment_of_an_off_centre_press(at_mm):
    env = press_env(at_mm=at_mm)
    env.move_to(0.3)
    force, moment = env.wrench[0, :3], env.wrench[0, 3:]
    # Frictionless on a dome: the force leans outwards, away from the apex, along the ball's axis.
    place = np.array(at_mm) * 1e-3
    assert force[2] > 0 and force[:2] @ place > 0
    lean = np.linalg.norm(force[:2]) / force[2]
    assert lean == pytest.approx(np.linalg.norm(place) / 52e-3, rel=0.35)
    # All forces pass through the ball's centre.
    assert moment == pytest.approx(np.cross(env.poses[0, 0, :3], force), abs=1e-7)
    assert moment[0] * place[1] >= 0 and moment[1] * place[0] <= 0
    # The normal force outweighs: it turns about y by -x Fz and about x by y Fz.
    turns = [place[1] * force[2], -place[0] * force[2]]
    assert moment[:2] == pytest.approx(turns, abs=0.35 * np.linalg.norm(place) * force[2])


@pytest.mark.thorough
@pytest.mark.parametrize("direction", [(1, 0), (0, -1)])
def test_shear_is_resisted(direction):
    env, (x, y) = press_env(friction_coefficient=0.5, physics=DEFAULT), direction
    env.move_to(0.4)
    normal = env.wrench[0, 2]
    env.move_to(0.4, np.array(direction) * 0.05)
    along, across = env.wrench[0, :2] @ [[x, -y], [y, x]]
    # Gel on indenter: against the motion, within the friction cone.
    assert -0.5 * normal * 1.1 < along < -0.05 * normal
    assert abs(across) < 0.2 * abs(along)
    assert env.poses[0, 0, :2] == pytest.approx(np.array(direction) * 5e-5)


@pytest.mark.parametrize("twist", [4.0, -4.0])
def test_twist_is_resisted(twist):
    setup = PressSetup(pad((0.0, 0.0), 1.41), GEL, parse_indenter("box:2x2"), 0.5, LINEAR)
    env = PressEnv(setup, np.zeros((1, 2)))
    env.move_to(0.3)
    before = env.wrench[0, 5]
    env.move_to(0.3, twist_deg=twist)
    assert np.sign(env.wrench[0, 5] - before) == -np.sign(twist)
    assert abs(env.wrench[0, 5]) > 5e-5
    half = math.radians(twist) / 2
    assert env.poses[0, 0, 3:] == pytest.approx([0, 0, math.sin(half), math.cos(half)])


def test_sliding_keeps_to_coulombs_law():
    env = press_env(friction_coefficient=0.1)
    env.follow(PressPath(0.3, (0.8, 0.0), step_mm=0.2))
    normal = -env.solver.contact_gradient.numpy()[0, : env.model.soft_count]
    tangential = np.linalg.norm(env.contact_forces[0] - normal, axis=1)
    pushed = np.linalg.norm(normal, axis=1)
    assert tangential.sum() == pytest.approx(0.1 * pushed.sum(), rel=0.02)


@pytest.mark.thorough
def test_only_what_failed_is_halved():
    """The deep press of two, where it may take fewer iterations than it needs in one piece."""
    at, depths = np.zeros((2, 2)), np.array([0.05, 0.8])
    # Of a ball a search begins where it nearly ends (``ahead``), and no half step is easier.
    exact, box = replace(LINEAR, relative_tolerance=1e-6), parse_indenter("box:2x2")
    setup = PressSetup(pad((0.0, 0.0), 1.41), GEL, box, physics=exact)
    whole = PressEnv(setup, at)
    taken = whole.move_to(depths)
    config = replace(whole.solver.config, max_newton_iterations=3 * taken.newton_iterations[1] // 4)
    env = PressEnv(setup, at, config=config)
    report = env.move_to(depths)
    assert report.converged.all()
    # Once it has arrived, either may be corrected for the gap that it had.
    assert report.substeps[0] == taken.substeps[0] and report.substeps[1] > taken.substeps[1]
    # The report owns up to the work of the failed attempt too.
    assert report.newton_iterations[1] > config.max_newton_iterations
    assert env.wrench == pytest.approx(whole.wrench, abs=3e-4 * whole.wrench[1, 2])
    assert env.depth_m * 1e3 == pytest.approx(depths)


@pytest.mark.parametrize(("most", "words"), [({}, ""), ({"max_step_iterations": 4}, " and 4 iter")])
def test_a_press_that_never_converges_says_so_and_stays_where_it_was(most, words):
    env = press_env(config=SolverConfig(max_newton_iterations=1, **most))
    with pytest.raises(SimulationError) as caught:
        env.move_to(0.5)
    halvings = f"{env.solver.config.max_substep_halvings} halvings{words}"
    for said in ("(0, 0) mm", "depth 0.5 mm", "NO_CONVERGENCE", "residual", halvings):
        assert said in str(caught.value)
    assert not find_intersections(env.model, env.state)[0]
    if most:
        # The attempt that spends the last of them is the last one.
        before = env.positions.copy()
        report = env.try_to(0.5)
        assert report.status[0] == EnvStatus.NO_CONVERGENCE and report.newton_iterations[0] == 4
        np.testing.assert_array_equal(env.positions, before)


def test_reset():
    env = press_env(friction_coefficient=0.5)
    path = PressPath(0.3, (0.1, 0.0), step_mm=0.3)
    env.follow(path)
    first = env.wrench.copy()
    env.reset()
    assert np.array_equal(env.positions[0], env.mesh.nodes_m)
    assert env.poses[0, 0, 2] > env.touch_m[0]
    env.follow(path)
    assert np.array_equal(env.wrench, first)


@pytest.mark.thorough
def test_batch_equals_single_presses():
    places, depths = [(0.0, 0.0), (2.0, -1.0), (-3.0, 1.5)], np.array([0.2, 0.35, 0.1])
    options = {"friction_coefficient": 0.5, "physics": LINEAR}
    rests = np.stack([pad(place).nodes_m for place in places])
    setup = PressSetup(pad(places[0]), GEL, BALL, **options)
    batch = PressEnv(setup, np.array(places), rest_positions_m=rests)
    batch.move_to(depths)
    for i, place in enumerate(places):
        single = press_env(at_mm=place, **options)
        single.move_to(depths[i])
        assert batch.touch_m[i] == single.touch_m[0]
        assert batch.wrench[i] == pytest.approx(single.wrench[0], abs=1e-3 * single.wrench[0, 2])
        assert batch.positions[i] == pytest.approx(single.positions[0], abs=1e-7)


@pytest.mark.parametrize(("at_mm", "thick_mm"), [((0.0, 0.0), 5.0), ((6.0, 0.0), 4.639)])
def test_depth_is_limited_by_the_gel_below(at_mm, thick_mm):
    env = press_env(at_mm=at_mm)
    with pytest.raises(InputError, match=r"goes past the gel, which is .*90%") as caught:
        env.move_to(0.9 * thick_mm + 0.02)
    thickness = float(str(caught.value).split("which is ")[1].split(" mm")[0])
    assert thickness == pytest.approx(thick_mm, abs=0.03)
    # Refused before anything moved.
    assert np.array_equal(env.positions[0], env.mesh.nodes_m)
    assert env.poses[0, 0, 2] > env.touch_m[0]


@pytest.mark.parametrize(
    ("at_mm", "message"),
    [
        ((15.0, 0.0), r"\(15, 0\) mm .* misses the gel; x must lie in \[-12, 12\] mm"),
        ((0.0, -13.0), r"misses the gel; .* y in \[-10, 10\] mm"),
        ((0.0, math.nan), "place of a press must be finite"),
    ],
)
def test_a_press_beside_the_gel_is_refused(at_mm, message):
    with pytest.raises(InputError, match=message):
        PressEnv(PressSetup(pad(), GEL, BALL), np.array([at_mm]))


@pytest.mark.parametrize(
    ("depth_mm", "motion", "message"),
    [
        (math.nan, {}, "depth of a press must be finite"),
        (np.array([0.1, math.inf]), {}, "depth of a press must be finite"),
        (np.array([0.1, 7.0]), {}, "depth 7 mm goes past the gel"),
        (0.1, {"shear_mm": (math.nan, 0.0)}, "NaN or infinite"),
        (0.1, {"twist_deg": math.nan}, "NaN or infinite"),
    ],
)
def test_motions_that_no_press_makes_are_refused(depth_mm, motion, message):
    env = PressEnv(PressSetup(pad(), GEL, BALL), np.zeros((2, 2)))
    with pytest.raises(InputError, match=message):
        env.move_to(depth_mm, **motion)


def test_a_shear_into_a_bonded_wall_is_refused_before_the_press():
    """Went down first, and then took all iterations of a step and its parts."""
    block = block_mesh((6, 6, 3), (8e-3, 8e-3, 4e-3))
    wall = (block.nodes_m[block.faces][..., 0] > 4e-3 - 1e-9).all(axis=1)
    region = np.where(wall, int(Region.BOND), block.face_regions)
    mesh = TetMesh(block.nodes_m, block.tets, block.faces, region)
    env = PressEnv(PressSetup(mesh, GEL, BALL, physics=LINEAR), np.zeros((1, 2)))
    start = env.poses
    words = r"shear \(3, 0\) mm and twist 0 deg cannot be done: 'sphere:2.0' would pass"
    with pytest.raises(InputError, match=words):
        env.follow(PressPath(0.5, shear_mm=(6.0, 0.0), step_mm=1.0))
    assert np.array_equal(env.poses, start)
    report = env.try_to(0.5, (6.0, 0.0))
    assert report.status[0] == EnvStatus.BLOCKED and report.substeps[0] <= 1
    assert "the way leads through what holds the gel" in env.failure(0, report, 0.5)
    for free in (-6.0, 1.0):
        env._require_free(PressPath(0.5, shear_mm=(free, 0.0), step_mm=1.0))


def test_an_indenter_that_starts_inside_the_gel_is_refused(monkeypatch):
    """Wherever first touch comes from, an overlap at the start is never simulated."""
    monkeypatch.setattr("taccel_lab.presses.env.first_touch_m", lambda *_: 1e-3)
    with pytest.raises(InputError, match=r"'sphere:2\.0' starts inside 'gel'"):
        press_env()


FIRM = Material(0.15e6, 0.48)


def at_rest(
    indenter: str = "edge:30x6", depth_mm: float = 0.6, envs: int = 1, gel: Material = FIRM,
    physics: PressPhysics = DEFAULT, **options: Any,
) -> PressEnv:  # fmt: skip
    tool = parse_indenter(indenter)
    mesh = press_mesh("flat_pad", {}, (0.0, 0.0), tool.contact(depth_mm), physics.mesh)
    setup = PressSetup(mesh, gel, tool, physics=physics, **options)
    return PressEnv(setup, np.zeros((envs, 2)))


@cache
def deep_edge(friction: float = 0.0, gel: Material = FIRM) -> PressEnv:
    """A sharp edge in a gel that is nearly incompressible."""
    env = at_rest(gel=gel, friction_coefficient=friction)
    env.follow(PressPath(0.6))
    return env


@pytest.mark.thorough
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
    told = Outputs(env.solver).update(env.state).guard_shares()[:, -1]
    assert told == pytest.approx(env.guard_share(), rel=0.01)
    assert hard == pytest.approx(alone.guard_share()[0], rel=1e-3)


@pytest.mark.slow
def test_a_gel_that_relaxes_has_it_too():
    """Of branches that are gone in a moment, what the gel without any has; the tangent counts the
    past of the last step."""
    gone = replace(FIRM, branches=(MaxwellBranch(0.5, 1e-3),))
    alone = deep_edge().guard_share()[0]
    assert deep_edge(gel=gone).guard_share()[0] == pytest.approx(alone, rel=0.1)
