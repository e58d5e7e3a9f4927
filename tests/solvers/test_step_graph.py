# SPDX-License-Identifier: Apache-2.0
"""The same bits, or nearly: captured steps and launches one by one, whatever becomes of the arrays;
scratch memory that holds anything; blocks of contact in the matrix or in a list."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import product
from typing import Any

import numpy as np
import pytest
import warp as wp

from taccel_lab.benchmarks.learning import Learning, LearningLoop
from taccel_lab.benchmarks.scenes import SceneOptions, build_scene
from taccel_lab.ipc.device.ragged_lists import GrowingList
from taccel_lab.model.build import build_model
from taccel_lab.scene import Element, KinematicBody, Material, Plane, Scene, TimeStepping
from taccel_lab.solvers import SolverIPC, env_progress
from taccel_lab.state import State
from tests.solvers.driven_grasp import base_poses, driven_grasp
from tests.solvers.steps import Begun, begun, left, stepped
from tests.support.blocks import cube, pose, soft_block
from tests.support.variants import variants

STEPS = range(1, 6)
PEGS = 5
NEVER = 30
"""Step of a contact that comes too late."""
FALLING = TimeStepping(quasi_static=False, dt_s=2e-3, gravity_m_s2=(0.0, 0.0, -9.81))
HAND = KinematicBody(None, name="hand")
RUBS = {"friction_coefficient": 0.5}


def carried(step: int) -> np.ndarray:
    """The mount goes sideways and turns, each environment at its own pace."""
    paces = 1 + np.arange(2)
    turns = np.degrees(4e-3 * step * paces)
    return np.stack(
        [pose(1e-4 * step * p, 0, 0, deg=d)[None] for p, d in zip(paces, turns, strict=True)]
    )


def make(**options: object) -> Begun:
    gel = soft_block((4, 4, 2), (6e-3, 6e-3, 3e-3), mount="hand", **RUBS)
    box = cube(3e-3, pose(0.2e-3, 0, 1.58e-3), **RUBS)
    scene = Scene([gel], [HAND], 2, FALLING, affine_bodies=[box])
    return begun(scene, carried(0), dhat_m=1e-4, **options)


def bits(solver: SolverIPC, state: State) -> np.ndarray:
    return np.concatenate([array.ravel() for array in left(solver, state)])


@pytest.fixture(scope="module")
def eager() -> np.ndarray:
    solver, state = make(capture=False)
    for step in STEPS:
        stepped(solver, state, carried(step))
    assert solver.graph.launches == 0
    return bits(solver, state)


@pytest.mark.thorough
@pytest.mark.parametrize("lists", ["long enough", "too short", "short in place", "moved by others"])
def test_a_captured_run_is_bitwise_the_same(eager: np.ndarray, lists: str) -> None:
    """Also where lists grow and the step is taken again, and where old graphs know old lists."""
    solver, state = make()
    for step in STEPS:
        for part in solver.lists:
            if (lists, step) in (("too short", 1), ("short in place", 3)):
                part._allocate(2)
                solver.pairs.forget(wp.full(2, 1, dtype=wp.int32))
            elif lists == "moved by others" and step > 1:
                part._allocate(part.rooms + 1 + part.capacity // len(part.rooms))
        before = solver.graph.launches, [part.moves for part in solver.lists]
        stepped(solver, state, carried(step))
        if (lists, step) == ("short in place", 3):
            # The graph takes the step again, as its arrays are where they were.
            assert solver.graph.launches > before[0] + 1
            assert [part.moves for part in solver.lists] == before[1]
    np.testing.assert_array_equal(bits(solver, state), eager)
    assert all((part.rooms > 2).any() for part in solver.lists)
    # The first step comes as it is, and what has moved is captured at once.
    in_one_go = lists in ("long enough", "moved by others")
    assert not in_one_go or solver.graph.launches == len(STEPS) - 1


def interrupted_after(moves: int) -> Callable[..., wp.array]:
    """``GrowingList.moved``, until that many arrays have moved."""
    moved, left = GrowingList.moved, iter(range(moves))

    def interrupted(*arguments: Any) -> wp.array:
        if next(left, None) is None:
            raise KeyboardInterrupt
        return moved(*arguments)

    return interrupted


@pytest.mark.thorough
@pytest.mark.parametrize("moves", [0, 1, 5, 11])
def test_growth_that_is_interrupted_leaves_no_trace(
    eager: np.ndarray, moves: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Some entries have moved by then, and some have not."""
    solver, state = make()
    for step in STEPS:
        if step == 3:
            for part in solver.lists:
                part._allocate(2)
            solver.pairs.forget(wp.full(2, 1, dtype=wp.int32))
            with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
                patch.setattr(GrowingList, "moved", interrupted_after(moves))
                solver.step(state, carried(step))
        stepped(solver, state, carried(step))
    np.testing.assert_array_equal(bits(solver, state), eager)


@pytest.mark.thorough
@pytest.mark.parametrize("first_contacts", [(1,), (5,), (2, 4, *[NEVER] * 16)])
def test_trees_of_soft_bodies_are_refitted_in_a_graph(first_contacts: tuple[int, ...]) -> None:
    """Also where the graph is recorded while they are out of reach, and searches no tree; and
    where environments get trees one after the other."""
    shape = ((3, 3, 2), (5e-3, 5e-3, 3e-3))
    gels = [
        soft_block(*shape, name="lower", **RUBS),
        soft_block(*shape, Material(5e4, 0.4), name="upper", mount="hand", **RUBS),
    ]
    ways = [
        np.concatenate([np.linspace(1e-3, 2e-4, first), -1e-4 * np.arange(1, 7)])
        for first in first_contacts
    ]
    # Who touches first waits for the last one.
    steps = 6 + max(first for first in first_contacts if first != NEVER)
    ways = [np.pad(way, (0, max(steps - len(way), 0)), "edge")[:steps] for way in ways]
    targets = [
        np.array([[[3e-4 + 1e-4 * k, 2e-4, z, 1.0, 0, 0, 0]] for z in heights])
        for k, heights in enumerate(np.transpose(ways))
    ]
    ends = []
    for capture in (False, True):
        scene = Scene(gels, [HAND], len(ways))
        solver, state = begun(scene, targets[0], dhat_m=5e-5, capture=capture)
        forces = np.array([stepped(solver, state, t).contact_force_n for t in targets[1:]])
        for first, own in zip(first_contacts, forces.T, strict=True):
            assert (own[: first - 1] == 0).all() and (own[first - 1 :] > 0).all()
        rooms = solver.candidates.lists[2].rooms
        assert rooms.tolist() == [int(first != NEVER) for first in first_contacts]
        assert (solver.graph.launches >= len(targets) - 2) == capture
        ends.append(state.positions.numpy())
    np.testing.assert_array_equal(*ends)


def test_the_plan_says_why_steps_are_not_captured() -> None:
    assert make()[0].plan.is_on("captured graph")
    plan = make(capture=False)[0].plan
    assert not plan.is_on("captured graph") and "SolverConfig.capture" in plan.describe()


# Scratch memory -----------------------------------------------------------------------------------


def scratch(solver: SolverIPC) -> Iterator[wp.array]:
    for name in ("trial", "path", "displacements", "reduced", "gradient", "pivots"):
        yield getattr(solver, name)
    linear, p = solver.linear, solver.progress
    yield from (linear.values, linear.rhs, linear.solution)
    yield from (part._blocks for part in solver.elastic)
    yield from (term.energies for term in solver.potentials.values())
    yield from (p.clearance.limit, p.clearance.bend, p.clearance.flight_turn_sq, p.clearance.reach)
    search = p.search
    yield from (search.derivative, search.before, search.after, search.base, search.base_after)


NEEDS_GPU = [
    pytest.mark.gpu,
    pytest.mark.skipif(not wp.is_cuda_available(), reason="needs a CUDA device"),
]
KINDS = [(Element.LINEAR, True), (Element.QUADRATIC, False)]


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("element", "deterministic", "device"),
    [
        *variants([(*kind, "cpu") for kind in KINDS], Element, [False, True], ["cpu"]),
        # On a GPU, where two runs give the same bits.
        *(pytest.param(element, True, "cuda:0", marks=NEEDS_GPU) for element in Element),
    ],
)
def test_what_scratch_memory_held_before_does_not_matter(
    element: Element, deterministic: bool, device: str
) -> None:
    """A gel on a hand lowers itself on a box that lies on the floor, and rubs."""
    options = {"element": element, "mount": "hand", "friction_coefficient": 0.4}
    gel = soft_block((2, 2, 2), (4e-3, 4e-3, 3e-3), **options)
    box = cube(2e-3, friction_coefficient=0.4, name="box")
    floor = Plane((0, 0, -1.05e-3), friction_coefficient=0.4)
    time = TimeStepping(quasi_static=False, dt_s=5e-3)
    scene = Scene([gel], [HAND], 3, time, affine_bodies=[box], planes=[floor])

    def poses(step: int) -> np.ndarray:
        heights = [1.05e-3 - (4e-5 + 1e-5 * env) * step for env in range(3)]
        return np.array([[[1e-5 * e * step, 0, z, 1, 0, 0, 0]] for e, z in enumerate(heights)])

    clean, poisoned = (
        begun(scene.finalize(device), poses(0), dhat_m=1e-4, deterministic=deterministic)
        for _ in range(2)
    )
    for step in STEPS:
        for array in scratch(poisoned[0]):
            array.fill_(np.nan)
        for made in (clean, poisoned):
            stepped(*made, poses(step))
    assert clean[0].contact_gradient.numpy().any(), "they touch"
    for found, expected in zip(left(*poisoned)[:2], left(*clean)[:2], strict=True):
        np.testing.assert_array_equal(found, expected)


# Blocks of contact of gels with affine bodies: in the matrix (GPUs) or in a list (the CPU) --------

METHODS = ["ssor", "arrow", "cg"]


def cube_on_a_gel() -> Scene:
    gel = soft_block((3, 3, 2), (6e-3, 6e-3, 3e-3), **RUBS)
    box = cube(3e-3, pose(0.2e-3, 0, 1.6e-3), initial_velocity_m_s=(0.05, 0.0, -0.1), **RUBS)
    return Scene([gel], [], 1, FALLING, affine_bodies=[box])


def fingers() -> Scene:
    return driven_grasp(1, (Element.LINEAR, Element.LINEAR))


@pytest.mark.thorough(cases=("fingers-ssor",))
@pytest.mark.parametrize(
    ("make", "method"),
    variants(
        [*product([cube_on_a_gel], METHODS), (fingers, "ssor")], [cube_on_a_gel, fingers], METHODS
    ),
)
def test_contact_in_the_pattern_changes_no_result(make: Callable[[], Scene], method: str) -> None:
    ends, extras, counts = [], [], []
    for in_pattern in (False, True):
        model = build_model(make(), "cpu", contact_in_pattern=in_pattern)
        poses = base_poses(1) if len(model.kinematic) else None
        options = {"relative_tolerance": 1e-8, "linear_method": method}
        solver, state = begun(model, poses, dhat_m=1e-4, **options)
        most = 0
        for _ in range(6):
            stepped(solver, state, poses)
            most = max(most, int(solver.linear.extra.counts.numpy()[0]))
        ends.append(state.positions.numpy())
        extras.append(most)
        counts.append(model.pattern.block_count)
    np.testing.assert_allclose(*ends, atol=1e-10 if make is cube_on_a_gel else 1e-9)
    assert extras[0] > 0 == extras[1] and counts[1] > counts[0]


# Lists of those that are left -------------------------------------------------------------------


def pegs(own_pace: bool, few: int, some: int, monkeypatch: pytest.MonkeyPatch) -> list[np.ndarray]:
    """Pegs between gels, each in its own phase, and what their steps took."""
    monkeypatch.setattr(env_progress, "FEW", few)
    monkeypatch.setattr(env_progress, "SOME", some)
    options = Learning(device="cpu", envs=(PEGS,), source="generated", offset_mm=0.3)
    bench = build_scene("peg", SceneOptions(PEGS, "generated", {}))
    loop = LearningLoop(bench, options, "own" if own_pace else "together")
    loop.phases.now[:] = 20 * np.arange(PEGS)
    places = (loop.solver.few_places, loop.solver.some_places)
    assert [one is not None for one in places] == [2 * few <= PEGS, 2 * some <= PEGS]
    motion = loop.run(2)
    found = [loop.solver.work.positions.numpy(), loop.solver.contact_gradient.numpy()]
    return [*found, motion.of("newton_iterations"), motion.of("ccd_passes")]


@pytest.mark.parametrize("own_pace", [False, True])
def test_lists_of_those_left_change_no_bit(own_pace: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = pegs(own_pace, 64, 512, monkeypatch)
    newton, checks = expected[2:]
    assert newton.max() > 2 * newton.min(), "all take as long"
    assert checks.sum() < 1.6 * newton.sum(), "trials are checked again"
    for found, known in zip(pegs(own_pace, 1, 2, monkeypatch), expected, strict=True):
        np.testing.assert_array_equal(found, known)
