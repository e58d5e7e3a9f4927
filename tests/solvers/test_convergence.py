# SPDX-License-Identifier: Apache-2.0
"""When a step counts as converged, in how many iterations, and when iterations lead nowhere.

Each body by its own forces, residual and force in one norm. Newton's matrix is exact near the
solution and projected where that is not positive definite; steps start along the last velocities,
and friction is frozen anew.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import pytest
import warp as wp

from taccel_lab.benchmarks.scenes import SceneOptions, build_scene
from taccel_lab.geometry.block import block_mesh, free_block
from taccel_lab.scene import (
    AffineBody,
    Ball,
    Element,
    KinematicBody,
    Material,
    MaterialModel,
    Scene,
    SoftBody,
    TimeStepping,
    box_mesh,
)
from taccel_lab.solvers import EnvStatus, SolverConfig, SolverIPC, start_step
from taccel_lab.solvers.env_phase import STALL_AFTER, STEPPING, forget_gain, go_on
from taccel_lab.solvers.env_progress import Progress
from taccel_lab.solvers.solver_ipc import HALVING_HELPS
from taccel_lab.state import State, initial_state
from tests.solvers.steps import begun, stepped
from tests.support.blocks import everywhere, pose, soft_block
from tests.support.grasps import gel_above_a_table, hand_poses
from tests.support.scene_steps import Stepped
from tests.support.variants import variants

MESH = block_mesh((4, 4, 2), (6e-3, 6e-3, 2e-3), jitter=0.1)
ASIDE = 0.05
DYNAMIC = TimeStepping(quasi_static=False, dt_s=5e-3)


@lru_cache
def pressed(*youngs_pa: float) -> tuple[SolverIPC, np.ndarray]:
    """Gels beside one another, each under a ball: the solver, and the force on each ball [N]."""
    shift = ASIDE * np.arange(len(youngs_pa))
    options = {"element": Element.QUADRATIC}
    gels = [
        SoftBody(MESH, Material(young, 0.4), name=f"gel {i}", initial_pose=pose(x, 0, 0), **options)
        for i, (young, x) in enumerate(zip(youngs_pa, shift, strict=True))
    ]
    balls = [KinematicBody(Ball(2e-3), name=f"ball {i}") for i in range(len(gels))]

    def at(z: float) -> np.ndarray:
        return everywhere(1, *(pose(x + 1e-4, 0, 2e-3 + z) for x in shift))

    solver, state = begun(Scene(gels, balls), at(5e-5), absolute_tolerance_n=1e-10)
    assert stepped(solver, state, at(-3e-4)).residual_ratio[0] <= 1
    nodes = [body.nodes[0] for body in solver.model.bodies[len(gels) :]]
    return solver, solver.contact_gradient.numpy()[0, nodes, 2]


def test_a_soft_body_is_solved_beside_a_stiff_one() -> None:
    """A gel of 100 Pa beside one of 100 MPa: its force is that of the gel alone."""
    (alone,) = pressed(1e2)[1]
    solver, forces = pressed(1e8, 1e2)
    assert abs(forces[0]) > 1e4 * abs(alone) and forces[1] == pytest.approx(alone, rel=2e-4)
    p = solver.progress.balance
    residuals, contact = p.body_residuals.numpy()[0], p.body_forces.numpy()[0]
    assert (residuals[:2] <= 1.0001e-4 * contact[:2]).all()
    # Prescribed bodies have no residual, but feel the contact.
    assert (residuals[2:] == 0).all() and (contact[2:] > 0).all()


def test_residual_and_contact_force_are_sums_of_magnitudes() -> None:
    solver, _ = pressed(1e5)
    model, p = solver.model, solver.progress.balance
    residual = np.linalg.norm(solver.reduced.numpy()[0], axis=1).sum()
    contact = np.linalg.norm(solver.contact_gradient.numpy()[0], axis=1)
    both = [contact[body.node_slice].sum() for body in model.bodies]
    np.testing.assert_allclose(p.body_residuals.numpy()[0, 0], residual, rtol=1e-12)
    np.testing.assert_allclose(p.residual.numpy(), residual, rtol=1e-12)
    np.testing.assert_allclose(p.body_forces.numpy()[0], both, rtol=1e-12)
    np.testing.assert_allclose(p.contact_force.numpy(), 0.5 * sum(both), rtol=1e-12)


@pytest.mark.parametrize("bad", [0, 1], ids=["first", "last"])
def test_a_body_that_is_not_a_number_is_not_lost_among_others(bad: int) -> None:
    model = pressed(1e5, 1e4)[0].model
    apart = everywhere(1, pose(0, 0, 9e-3), pose(ASIDE, 0, 9e-3))
    solver, state = begun(model, apart, absolute_tolerance_n=1e-10)
    loads = np.zeros((1, model.node_count, 3))
    loads[0, model.bodies[bad].node_slice] = 1e200
    state.load(model, loads)
    assert not solver.step(state).converged[0]


def moving(soft: SoftBody, *bodies: AffineBody) -> tuple[SolverIPC, float]:
    """The solver of a step, without halves, in which a soft body begins to shear; residual [N]."""
    made = Scene(soft, affine_bodies=bodies, time=TimeStepping(quasi_static=False, dt_s=1e-3))
    solver, state = begun(made, max_substep_halvings=0, max_newton_iterations=12)
    x, v = state.positions.numpy(), state.velocities.numpy()
    v[0, :, 0] = 0.1 * (x[0, :, 2] - x[0, :, 2].mean())
    state.velocities.assign(v)
    return solver, float(stepped(solver, state).residual_n[0])


STIFF = Material(7e10, 0.3, 2700.0)
STIFF_BLOCKS = {
    "linear": ((8, 8, 8), Element.LINEAR, 0.0),
    "quadratic": ((4, 4, 4), Element.QUADRATIC, 0.0),
    "far away": ((2, 2, 2), Element.QUADRATIC, 1.0),
}


def test_a_scene_of_any_size_is_solved_alike() -> None:
    """Forces grow with the square of the size; what is left of them is no larger a part. At 60 um
    1.6 % of the contact force was left."""

    def press(size_m: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Newton iterations, contact force [N] and what is left of it, of two steps."""
        gel = SoftBody(block_mesh((4, 4, 2), (size_m, size_m, size_m / 3)), Material(1e5, 0.4))
        top_m = gel.mesh.nodes_m[:, 2].max() + size_m / 3
        start, *ways = (pose(0, 0, top_m + share * size_m) for share in (1e-3, -2e-2, -4e-2))
        scene = Scene(gel, KinematicBody(Ball(size_m / 3), name="ball"))
        run = Stepped(scene, start, dhat_m=2e-3 * size_m)
        reports = [run.step(way) for way in ways]
        forces = np.array([report.contact_force_n[0] for report in reports])
        left = np.array([report.residual_n[0] for report in reports]) / forces
        return np.array([report.newton_iterations[0] for report in reports]), forces, left

    iterations, forces, left = press(1e-3)
    assert (left < 3e-4).all()
    again, small, part = press(6e-5)
    assert (again == iterations).all() and part == pytest.approx(left, rel=1e-3)
    assert small == pytest.approx(forces * 0.06**2, rel=1e-6)
    # A large one stops at 1e-7 N all the same, which takes an iteration more where that decides.
    again, large, part = press(1.0)
    assert (again <= iterations + 1).all() and (part < 1.01 * left).all()
    assert large == pytest.approx(forces * 1e6, rel=2e-4)


@pytest.mark.parametrize("name", STIFF_BLOCKS)
def test_a_stiff_body_stops_at_what_rounding_leaves(name: str) -> None:
    """What is allowed is near the force of the last digit of the positions alone."""
    cells, element, away = STIFF_BLOCKS[name]
    block, nothing = free_block(cells, 0.02, 0.2), np.zeros(0, dtype=np.int64)
    place = pose(away, away, away)
    solver, residual = moving(SoftBody(block, STIFF, nothing, initial_pose=place, element=element))
    allowed = residual / float(solver.progress.balance.excess.numpy()[0])
    assert allowed > SolverConfig.absolute_tolerance_n
    # Elastic forces of the resting body with the last digit of its positions drawn.
    x = initial_state(solver.model).positions.numpy()
    x *= 1 + np.finfo(float).eps * np.random.default_rng(1).integers(-1, 2, x.shape) / 2
    gradient = wp.zeros(x.shape[:2], dtype=wp.vec3d)
    everyone = wp.ones(1, dtype=wp.int32)
    solver.elastic[0].add_gradient(everyone, wp.array(x, dtype=wp.vec3d), gradient)
    least = np.linalg.norm(gradient.numpy()[0], axis=1).sum()
    assert least < allowed < 5 * least


def test_a_stiff_gel_on_a_body_converges_with_it() -> None:
    """What rounding leaves in a gel acts on the body that carries it, too."""
    base = AffineBody(box_mesh((0.03, 0.03, 0.01)), 1000.0, name="base")
    mesh = block_mesh((4, 4, 4), (0.02, 0.02, 0.02), jitter=0.1)
    moving(SoftBody(mesh, STIFF, mount="base", element=Element.QUADRATIC), base)


def test_soft_gels_are_not_asked_for_their_rounding() -> None:
    model = Scene(SoftBody(MESH, Material(1e6, 0.49), element=Element.QUADRATIC)).finalize()
    assert not any(part.rounds_above(1e-7) for part in SolverIPC(model).elastic)
    model.set_body(model.bodies[0].name, young_modulus_pa=1e11)
    assert all(part.rounds_above(1e-7) for part in SolverIPC(model).elastic)


# Newton's matrix ----------------------------------------------------------------------------------

LAWS = (MaterialModel.NEO_HOOKEAN, MaterialModel.STABLE_NEO_HOOKEAN)


@pytest.mark.parametrize(
    ("model", "element"),
    variants([(LAWS[0], Element.QUADRATIC), (LAWS[1], Element.LINEAR)], LAWS, Element),
)
def test_it_converges_quadratically_under_prestress(model: MaterialModel, element: Element) -> None:
    """Six more digits in two or three iterations; projected matrices alone took six and more."""

    def iterations(tolerance: float) -> int:
        """Of the second of two steps of a ball into a nearly incompressible gel."""
        cells = (6, 6, 3) if element is Element.LINEAR else (4, 4, 2)
        gel = soft_block(cells, (6e-3, 6e-3, 2.5e-3), Material(1e5, 0.46, model=model), element)
        made = Scene(gel, KinematicBody(Ball(3e-3)))
        options = {"relative_tolerance": tolerance, "absolute_tolerance_n": 1e-12}
        solver, state = begun(made, everywhere(1, pose(0, 0, 3.05e-3)), **options)
        for depth in (6e-4, 6.5e-4):
            report = stepped(solver, state, everywhere(1, pose(0, 0, 3e-3 - depth)))
        return int(report.newton_iterations[0])

    assert iterations(1e-9) <= iterations(1e-3) + 3


@pytest.mark.thorough
def test_it_gets_away_from_a_saddle_along_negative_curvature() -> None:
    """A peg slips on the rim: 22, 16 and 20 iterations by steps of the length of Newton's."""
    bench = build_scene("peg", SceneOptions(1, "generated", {}))
    solver = SolverIPC(bench.scene.finalize(), bench.config)
    state, taken = initial_state(solver.model, bench.targets(0)), []
    for k in range(1, 90):
        taken.append(int(stepped(solver, state, bench.targets(k)).newton_iterations[0]))
    assert sum(sorted(taken[60:])[-3:]) < 54


@pytest.mark.thorough
def test_a_bar_that_is_pressed_too_hard_bends() -> None:
    """Straight is a saddle, which projected matrices alone do not leave in 1,800 iterations."""
    width_m, length_m, young_pa = 1e-3, 1e-2, 1e5
    # The load under which a bar that is held at one end buckles.
    euler_n = np.pi**2 * young_pa * width_m**4 / 12 / (2 * length_m) ** 2
    size = (width_m, width_m, length_m)
    bar = soft_block((2, 2, 10), size, Material(young_pa, 0.3), Element.QUADRATIC)
    solver, state = begun(Scene(bar), absolute_tolerance_n=1e-9)
    top = np.flatnonzero(solver.model.rest_positions.numpy()[0, :, 2] > -1e-9)
    leans = []
    for load in (0.8, 1.2):
        forces = np.zeros((1, solver.model.node_count, 3))
        forces[0, top] = np.array([1e-4, 0, -load]) * euler_n / len(top)
        state.load(solver.model, forces)
        report = stepped(solver, state)
        leans.append(abs(state.positions.numpy()[0, top, 0].mean()))
    assert leans[0] < 0.01 * length_m and leans[1] > 0.3 * length_m
    assert report.newton_iterations[0] < 300


# Starts along the last velocities -----------------------------------------------------------------


def test_a_steady_drag_takes_fewer_iterations(monkeypatch: pytest.MonkeyPatch) -> None:
    path = [(0.0, 5e-5 - 5e-5 * k) for k in range(8)]
    path += [(2e-4 * k, path[-1][1]) for k in range(1, 25)]
    options = {"dhat_m": 1e-4, "relative_tolerance": 1e-6}

    def drag() -> tuple[np.ndarray, int]:
        solver, state = begun(gel_above_a_table(DYNAMIC), hand_poses(path[:1]), **options)
        taken = [stepped(solver, state, hand_poses([at])).newton_iterations[0] for at in path[1:]]
        assert np.abs(solver.friction_gradient.numpy()[0, :, 0]).sum() > 0.1, "it rubs"
        return state.positions.numpy(), sum(taken[-10:])

    found, few = drag()
    monkeypatch.setattr(start_step, "plan_start", lambda run: None)
    expected, many = drag()
    np.testing.assert_allclose(found, expected, atol=2e-8)
    assert few <= 0.8 * many


def test_a_start_that_turns_an_element_inside_out_is_not_taken() -> None:
    """The last velocities lead the free face through the bonded one: energy is infinite there."""
    solver, state = begun(gel_above_a_table(DYNAMIC), hand_poses([(0.0, 0.02)]), dhat_m=1e-4)
    velocities, gel = state.velocities.numpy(), slice(0, solver.model.soft_count)
    height = state.positions.numpy()[0, gel, 2]
    # Towards the mount, of twice the way within the step; the mount itself rises a little.
    velocities[0, gel, 2] = 2 * (height.max() - height) / 5e-3 + 1e-2
    state.velocities.assign(velocities)
    report = stepped(solver, state, hand_poses([(0.0, 0.02 + 5e-5)]))
    assert (report.starts_tried, report.starts_taken, report.substeps) == (1, 0, 1)


# Friction is frozen anew --------------------------------------------------------------------------


def rub(
    cells: int, side_m: float, turned_deg: float, pace: tuple[float, ...] = (1.0,), **options: Any
) -> tuple[State, np.ndarray]:
    """A box pressed into a gel in three steps: the last state, and iterations [step, env]."""
    material = Material(1e5, 0.46)
    size = (6e-3, 6e-3, 2.5e-3)
    gel = soft_block((cells, cells, 3), size, material, Element.QUADRATIC, friction_coefficient=1.0)
    box = KinematicBody(box_mesh((side_m,) * 3), 1.0)
    place = pose(0.13e-3, 0.07e-3, side_m / 2, (0, 0, 1), turned_deg)

    def at(step: float, pace: Any) -> np.ndarray:
        depths = 2e-4 * step * np.array(pace)[:, None, None]
        return everywhere(len(pace), place) - depths * np.array([0, 0, 1, 0, 0, 0, 0])

    made = Scene(gel, box, len(pace))
    solver, state = begun(made, at(-0.1, np.ones(len(pace))), dhat_m=1e-5, **options)
    taken = []
    for step in (1, 2, 3):
        report = stepped(solver, state, at(step, pace))
        assert (report.residual_ratio <= 1).all() and (report.substeps == 1).all()
        taken.append(report.newton_iterations)
    return state, np.array(taken)


@pytest.mark.thorough
def test_edges_take_few_iterations() -> None:
    """91 and 67; 120 and 70 where friction's last change grows with a slip."""
    for most, case in ((105, (8, 2e-3, 0.0)), (75, (10, 1.5e-3, 30.0))):
        taken = rub(*case)[1]
        assert taken.sum() <= most, taken


@pytest.mark.thorough
def test_environments_freeze_friction_each_for_itself() -> None:
    together, taken = rub(4, 2e-3, 0.0, (1.0, 0.6))
    uncaptured, _ = rub(4, 2e-3, 0.0, (1.0, 0.6), capture=False)
    alone, taken_alone = rub(4, 2e-3, 0.0, (0.6,))
    np.testing.assert_array_equal(taken[:, 1], taken_alone[:, 0])
    x = together.positions.numpy()
    np.testing.assert_array_equal(x, uncaptured.positions.numpy())
    np.testing.assert_array_equal(x[1], alone.positions.numpy()[0])


# Iterations that lead nowhere end a step; plateaus on which the energy falls do not ---------------


@wp.kernel(enable_backward=False)
def _begin_kernel(p: Progress):
    forget_gain(wp.tid(), p)


@wp.kernel(enable_backward=False)
def _go_on_kernel(p: Progress):
    go_on(wp.tid(), p)


K = np.arange(400)
COURSES = {
    # Residual over what is allowed, energy [J], progress of the frames, where it stalls.
    "nothing falls": (0 * K + 5e3, 0 * K + 1.0, 0 * K + 1.0, STALL_AFTER + 1),
    "rise and fall about a level": (3e3 + 2e3 * np.sin(K), 1 + 1e-3 * np.sin(K), 0 * K + 1.0, ...),
    "residual falls by 2 % in 50": (5e3 * 0.98 ** (K // 50), 0 * K + 1.0, 0 * K + 1.0, None),
    "energy falls on a plateau": (5e3 + 4e3 * np.sin(K), 1 - 1e-5 * K, 0 * K + 1.0, None),
    "energy falls below zero": (5e3 + 0.0 * K, -1 - 1e-5 * K, 0 * K + 1.0, None),
    "frames creep on": (0 * K + 5e3, 0 * K + 1.0, 2e-3 * K / 50, None),
    "frames are stuck": (5e3 * 0.9**K, 1 - 1e-2 * K, np.minimum(0.9, 0.1 * K), STALL_AFTER + 10),
    "stalled after 200": (5e3 * 0.9 ** np.minimum(K, 200), 0 * K + 1.0, 0 * K + 1.0, 301),
    "energy is not known": (5e3 * 0.9**K, 0 * K + np.inf, 0 * K + 1.0, None),
}


def test_a_step_ends_after_so_many_iterations_without_a_gain() -> None:
    count = len(COURSES)
    made = Scene(soft_block((1, 1, 1), (1e-2,) * 3), KinematicBody(Ball(1e-3)), count)
    p = begun(made)[0].progress
    p.phases.active.fill_(1)
    p.phases.phase.fill_(STEPPING)
    wp.launch(_begin_kernel, count, inputs=[p.struct])
    ended: list[int | None] = [None] * count
    for k in K:
        for i, array in enumerate((p.balance.excess, p.search.after, p.prescribed.progress)):
            array.assign(np.array([course[i][k] for course in COURSES.values()], dtype=float))
        wp.launch(_go_on_kernel, count, inputs=[p.struct])
        for env in np.flatnonzero(p.phases.status.numpy() == EnvStatus.STALLED):
            ended[env] = int(k) if ended[env] is None else ended[env]
    for (name, (*_, expected)), found in zip(COURSES.items(), ended, strict=True):
        if expected is ...:
            assert found is not None and found < STALL_AFTER + 50, name
        else:
            assert found == expected, name
    assert (p.phases.active.numpy() == np.array([k is None for k in ended])).all()
    assert EnvStatus.STALLED in HALVING_HELPS, "shorter steps may help"
