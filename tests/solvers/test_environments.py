# SPDX-License-Identifier: Apache-2.0
"""Environments do not see each other: results, order, failures, roll-back, overlaps, resets."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import product

import numpy as np
import pytest
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.geometry.block import block_mesh
from taccel_lab.ipc.contact.overlap_search import require_separated
from taccel_lab.model import Model
from taccel_lab.scene import (
    Ball,
    Element,
    KinematicBody,
    Material,
    MaterialModel,
    Plane,
    Scene,
    SoftBody,
    Surface,
    TimeScheme,
    TimeStepping,
    box_mesh,
    sphere_mesh,
)
from taccel_lab.solvers import EnvStatus, SolverConfig, SolverIPC
from taccel_lab.state import State
from tests.solvers.steps import assert_same, begun, left, stepped
from tests.support.blocks import cube, everywhere, pose, scene, soft_block
from tests.support.intersection import find_intersections
from tests.support.variants import variants

SECOND = np.array([False, True, False])


@pytest.mark.parametrize("quasi_static", [True, False])
def test_a_failing_environment_is_rolled_back_and_the_others_go_on(quasi_static: bool) -> None:
    """Environment 1 has too far to go for the iterations it is given."""
    time = TimeStepping(quasi_static=quasi_static, dt_s=0.01)
    mesh = block_mesh((6, 6, 2), (5e-3, 5e-3, 2e-3))
    made = scene(mesh, KinematicBody(Ball(1.5e-3)), env_count=3, time=time)
    solver, state = begun(made, everywhere(3, pose(0, 0, 1.55e-3)))
    first = everywhere(3, pose(0, 0, 1.45e-3))
    stepped(solver, state, first)
    arrays = (state.positions, state.velocities, state.poses)
    before = [array.numpy().copy() for array in arrays]
    assert quasi_static or np.abs(before[1]).max() > 0

    few = SolverConfig(max_newton_iterations=4, relative_tolerance=1e-3, max_substep_halvings=0)
    hasty, target = SolverIPC(solver.model, few), first.copy()
    target[:2, 0, 2] -= [1e-6, 4e-4]
    good = EnvStatus.CONVERGED
    assert hasty.step(state, target).status.tolist() == [good, EnvStatus.NO_CONVERGENCE, good]
    assert_same((array.numpy()[1] for array in arrays), (array[1] for array in before))
    assert np.abs(arrays[0].numpy()[0] - before[0][0]).max() > 1e-7
    np.testing.assert_allclose(state.poses.numpy().reshape(3, 7)[0], target[0, 0], atol=1e-15)
    assert find_intersections(solver.model, state) == [[], [], []]
    # The forces that are read out belong to the state that is left, also where it was rolled back.
    again, copy = SolverIPC(solver.model, SolverConfig()), State(*map(wp.clone, arrays))
    again.step(copy)
    old, new = hasty.contact_gradient.numpy()[1], again.contact_gradient.numpy()[1]
    assert np.abs(old).max() > 1e-4
    if quasi_static:
        np.testing.assert_allclose(old, new, atol=1e-3 * np.abs(new).max())
    # It is not lost: with enough iterations it arrives.
    stepped(solver, state, target)


@pytest.mark.parametrize(
    ("law", "ends"),
    [("stable_neo_hookean", EnvStatus.BLOCKED), ("st_venant_kirchhoff", EnvStatus.INVERSION)],
)
def test_a_body_does_not_leave_through_the_glued_back(law: str, ends: EnvStatus) -> None:
    """These energies bear inversion; one pushes back until the box is at the glued face."""
    gel = soft_block((3, 3, 1), (4e-3, 4e-3, 1e-3), Material(1e5, 0.4, model=MaterialModel(law)))
    made = Scene(gel, KinematicBody(box_mesh((1e-3, 1e-3, 1e-3)), name="box"))
    solver, state = begun(made, everywhere(1, pose(0, 0, 5.5e-4)), max_substep_halvings=1)
    statuses = []
    for z in np.linspace(5e-4, -2.2e-3, 10):
        before = state.positions.numpy().copy()
        report = solver.step(state, everywhere(1, pose(0, 0, z)))
        statuses.append(report.status[0])
        assert find_intersections(solver.model, state)[0] == []
        if not report.converged[0]:
            np.testing.assert_array_equal(state.positions.numpy(), before)
            break
    assert statuses[0] == EnvStatus.CONVERGED and statuses[-1] == ends


# What goes wrong in one environment stays there, is named, and can be reset -----------------------

ROUGH = block_mesh((3, 3, 2), (3e-3, 3e-3, 2e-3), jitter=0.15)
SIDE = 1.2e-3
STEPS = 3


def falling(envs: list[int], scheme: TimeScheme = TimeScheme.EULER) -> Model:
    """A cube falls on a gel beside a floor while a ball comes down; each environment differs."""
    at = [pose(1e-4 * e, 0, SIDE / 2 + 2e-5 + 3e-6 * e, (0, 0, 1), 10.0 * e) for e in envs]
    options = {"density_kg_m3": 8000, "friction_coefficient": 0.4}
    body = cube(SIDE, np.stack(at), initial_velocity_m_s=(0.0, 0.0, -0.05), **options)
    return Scene(
        SoftBody(ROUGH, Material(1e5, 0.4), friction_coefficient=0.4, element=Element.LINEAR),
        KinematicBody(Ball(1e-3), 0.4, name="ball"),
        len(envs),
        TimeStepping(False, 2e-3, (0, 0, -9.81), scheme),
        affine_bodies=body,
        planes=Plane((0, 0, -2.5e-3), name="floor"),
    ).finalize()


def ball_at(envs: list[int], step: int) -> np.ndarray:
    z = SIDE + 1e-3 + 1.5e-4 - 6e-5 * step
    return np.stack([pose(1e-4 * e, 1e-5 * e * step, z)[None] for e in envs])


Spoil = Callable[[Model, State], None]


def run(
    envs: list[int], spoil: Spoil | None = None, scheme: TimeScheme = TimeScheme.EULER
) -> tuple[SolverIPC, State, list[np.ndarray]]:
    """Some steps of the given environments; ``spoil`` gets the state after the first."""
    solver, state = begun(falling(envs, scheme), ball_at(envs, 0), relative_tolerance=1e-6)
    statuses = [stepped(solver, state, ball_at(envs, 1)).status]
    if spoil is not None:
        spoil(solver.model, state)
    for k in range(2, STEPS + 1):
        statuses.append(solver.step(state, ball_at(envs, k)).status)
    return solver, state, statuses


def move(array: wp.array, node: int, by: tuple[float, float, float]) -> None:
    value = array.numpy().copy()
    value[1, node] += by
    array.assign(value)


def nan_velocity(model: Model, state: State) -> None:
    move(state.velocities, model.affine.first_control, (np.nan, 0, 0))


def nan_position(model: Model, state: State) -> None:
    move(state.positions, 20, (np.nan, 0, 0))


def inverted(model: Model, state: State) -> None:
    move(state.positions, int(ROUGH.nodes_m[:, 2].argmax()), (0, 0, -1.9e-3))


SPOILS = {
    nan_velocity: EnvStatus.NOT_A_NUMBER,
    nan_position: EnvStatus.NOT_A_NUMBER,
    inverted: EnvStatus.INVERSION,
}


@cache
def run_alone(env: int, scheme: TimeScheme) -> list[np.ndarray]:
    solver, state, _ = run([env], scheme=scheme)
    return left(solver, state, 0)


def test_results_do_not_depend_on_number_and_order() -> None:
    """Bitwise on the CPU, where lists are filled and summed in a fixed order."""
    order = [2, 0, 1]
    together, shuffled = (left(*run(envs)[:2]) for envs in ([0, 1, 2], order))
    assert_same(shuffled, [array[order] for array in together])
    assert_same([array[1] for array in together], run_alone(1, TimeScheme.EULER))
    forces = together[2][:, : ROUGH.node_count, 2].sum(axis=1)
    assert len(np.unique(forces)) == 3, "the environments were meant to differ"


@pytest.mark.thorough(cases=("bdf2-nan_velocity", "euler-nan_position", "euler-nan_velocity"))
@pytest.mark.parametrize(
    ("scheme", "spoil"),
    variants(
        [*product([TimeScheme.EULER], SPOILS), (TimeScheme.BDF2, nan_velocity)], TimeScheme, SPOILS
    ),
)
def test_others_are_bitwise_as_if_alone_and_a_reset_starts_anew(
    spoil: Spoil, scheme: TimeScheme
) -> None:
    before: list[np.ndarray] = []

    def spoil_and_look(model: Model, state: State) -> None:
        spoil(model, state)
        before.extend(a.numpy()[1].copy() for a in (state.positions, state.velocities, state.poses))

    envs = [0, 1, 2]
    solver, state, statuses = run(envs, spoil_and_look, scheme)
    assert statuses[1].tolist() == [EnvStatus.CONVERGED, SPOILS[spoil], EnvStatus.CONVERGED]
    assert statuses[2][1] != EnvStatus.CONVERGED
    # It keeps the start of the step.
    assert_same((a.numpy()[1] for a in (state.positions, state.velocities, state.poses)), before)
    together = {env: left(solver, state, env) for env in (0, 2)}
    for env, found in together.items():
        assert_same(found, run_alone(env, scheme))
        assert all(np.abs(force).max() > 1e-6 for force in found[2:])
    solver.reset(state, SECOND, ball_at(envs, 0))
    for env, found in together.items():
        assert_same(left(solver, state, env)[:2], found[:2])
    # From here on it does what an environment that never failed does, bit by bit.
    alone = begun(falling([1], scheme), ball_at([1], 0), relative_tolerance=1e-6)
    assert_same(left(solver, state, 1)[:2], left(*alone, 0)[:2])
    for k in (1, 2):
        targets = ball_at(envs, STEPS)
        targets[1] = ball_at([1], k)[0]
        stepped(solver, state, targets)
        stepped(*alone, ball_at([1], k))
        found, expected = left(solver, state, 1), left(*alone, 0)
        assert_same((found[0], found[3]), (expected[0], expected[3]))


def test_bodies_that_start_inside_each_other_are_flagged_and_refused() -> None:
    envs = [0, 1, 2]
    solver, state = begun(falling(envs), ball_at(envs, 0), relative_tolerance=1e-6)
    model = solver.model
    require_separated(model, state)
    for node in (model.affine.first_control, *range(*model.bodies[1].nodes)):
        move(state.positions, node, (0, 0, -0.3e-3))
    with pytest.raises(InputError, match=r"'cube'.*in environment 1.*\(edge \d+, \d+ of"):
        require_separated(model, state)
    before = state.positions.numpy()[1].copy()
    report = solver.step(state, ball_at(envs, 1))
    expected = [EnvStatus.CONVERGED, EnvStatus.OVERLAP, EnvStatus.CONVERGED]
    assert report.status.tolist() == expected and report.failures() == {"OVERLAP": [1]}
    np.testing.assert_array_equal(state.positions.numpy()[1], before)
    # Not once and then forgotten; and a reset puts it right.
    assert solver.step(state, ball_at(envs, 2)).status.tolist() == expected
    solver.reset(state, SECOND, ball_at(envs, 0))
    targets = ball_at(envs, 3)
    targets[1] = ball_at([1], 1)[0]
    stepped(solver, state, targets)


# Every environment has its own object, gel, friction and motion -----------------------------------

PAD = block_mesh((4, 4, 2), (6e-3, 6e-3, 3e-3), jitter=0.1)
OBJECTS = {
    "ball": (Ball(2e-3), 2e-3),
    "box": (box_mesh((2e-3, 2e-3, 1e-3)), 0.5e-3),
    "pebble": (sphere_mesh(1.5e-3, 0.8e-3), 1.5e-3),
}
"""Each with its height over its origin [m]."""
NAMES = tuple(OBJECTS)
DRAWN = np.random.default_rng(7).random((1000, 6))
"""What differs: row e is of environment e, whatever the number of them."""
KINDS = np.arange(1000) % len(NAMES)
YOUNG_PA, POISSON = 4e4 * 5 ** DRAWN[:, 0], 0.3 + 0.17 * DRAWN[:, 1]
FRICTION = np.where(DRAWN[:, 2] < 0.2, 0.0, DRAWN[:, 2])


def object_at(env: int, step: int) -> np.ndarray:
    depth_m, shear_m = 1e-4 + 2e-4 * DRAWN[env, 3], 2e-4 * (DRAWN[env, 4:] - 0.5)
    z = OBJECTS[NAMES[KINDS[env]]][1] + 1e-4 - (1e-4 + depth_m) * step / 5
    return pose(*shear_m * max(step - 2, 0) / 5, z)


def run_objects(model: Model, envs: range, tools: int = 1) -> tuple[np.ndarray, np.ndarray]:
    def poses(step: int) -> np.ndarray:
        return np.stack([[object_at(env, step)] * tools for env in envs])

    solver, state = begun(model, poses(0), dhat_m=5e-5, relative_tolerance=1e-6)
    for step in range(1, 6):
        report = stepped(solver, state, poses(step))
    return state.positions.numpy()[:, : model.soft_count], report.contact_force_n


ON_A_GPU = [
    pytest.mark.gpu,
    pytest.mark.skipif(not wp.is_cuda_available(), reason="needs a CUDA device"),
]


@pytest.mark.thorough(cases=("20-cpu",))
@pytest.mark.parametrize(
    ("env_count", "device"),
    [
        (20, "cpu"),
        # More than a block of 64 threads has.
        pytest.param(256, "cpu", marks=pytest.mark.slow),
        pytest.param(256, "cuda:0", marks=ON_A_GPU),
    ],
)
def test_each_with_its_own_parameters_is_as_if_alone(env_count: int, device: str) -> None:
    bodies = []
    for kind, name in enumerate(NAMES):
        where = Surface(environments=tuple(np.flatnonzero(KINDS[:env_count] == kind).tolist()))
        bodies.append(KinematicBody(OBJECTS[name][0], 0.5, name, where))
    pad = SoftBody(PAD, Material(1e5, 0.4), name="pad", element=Element.LINEAR)
    model = Scene(pad, bodies, env_count).finalize(device)
    young, poisson = YOUNG_PA[:env_count], POISSON[:env_count]
    model.set_body("pad", young_modulus_pa=young, poisson_ratio=poisson)
    for name in NAMES:
        model.set_friction("pad", name, FRICTION[:env_count])
    positions, forces = run_objects(model, range(env_count), len(NAMES))
    assert (forces > 0).all()
    assert len(np.unique(forces)) == len(forces), "no two do the same"
    for env in range(0, len(forces), 17):
        pad = SoftBody(PAD, Material(YOUNG_PA[env], POISSON[env]), element=Element.LINEAR)
        tool = KinematicBody(OBJECTS[NAMES[KINDS[env]]][0], float(FRICTION[env]))
        (alone,), (force,) = run_objects(Scene(pad, tool).finalize(), range(env, env + 1))
        assert forces[env] == pytest.approx(force, rel=1e-5)
        np.testing.assert_allclose(positions[env], alone, atol=1e-9)
