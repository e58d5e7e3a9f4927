# SPDX-License-Identifier: Apache-2.0
"""What a step depends on stands in the state: whatever happens to a solver, no bit differs."""

from __future__ import annotations

import gc
import pickle
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.geometry.block import block_mesh
from taccel_lab.geometry.pixel_grid import PixelGrid
from taccel_lab.outputs import Outputs
from taccel_lab.scene import Material, Scene, SoftBody, TimeScheme
from taccel_lab.signals import SignalTactile
from taccel_lab.solvers import Control, EnvStatus, ReadySteps, SolverIPC
from taccel_lab.state import State, initial_state
from tests.solvers.test_ready_steps import DT_S, ENVS, RELAXING, asked, finger, make, poses
from tests.support.variants import variants

STEPS = 4
Made = tuple[SolverIPC, State]


def ask_finger(solver: SolverIPC, step: int) -> Control:
    return asked(solver, np.full(ENVS, step), DT_S[step])


def ask_press(solver: SolverIPC, step: int) -> np.ndarray:
    return poses([step] * ENVS)


CASES: dict[str, tuple[Callable[[], Made], Callable[[SolverIPC, int], Any]]] = {
    "press": (lambda: make(True), ask_press),
    "relaxing gel": (lambda: make(True, branches=RELAXING), ask_press),
    "impact by BDF2": (lambda: make(False, TimeScheme.BDF2), ask_press),
    "mechanism": (finger, ask_finger),
}


def everything(solver: SolverIPC, state: State) -> list[np.ndarray]:
    """All that a step leaves behind."""
    arrays = [*state.motion(), solver.contact_gradient, solver.friction_gradient]
    return [array.numpy().copy() for array in arrays]


def assert_same(found: list[np.ndarray], expected: list[np.ndarray]) -> None:
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.fixture(scope="module", params=CASES)
def case(request: pytest.FixtureRequest) -> Iterator[tuple[Any, Any, list[list[np.ndarray]]]]:
    """How to make it, what is asked of a step, and what each step leaves when nothing happens."""
    build, ask = CASES[request.param]
    solver, state = build()
    expected = [everything(solver, state)]
    for step in range(1, STEPS + 1):
        assert solver.step(state, ask(solver, step)).converged.all()
        expected.append(everything(solver, state))
    yield build, ask, expected


@contextmanager
def interrupted_at(count: int) -> Iterator[None]:
    """Ctrl-C at the launch or copy of that number."""
    launch, left = wp.launch, [count]

    def counted(*args: Any, **options: Any) -> Any:
        left[0] -= 1
        if left[0] == 0:
            signal.raise_signal(signal.SIGINT)
        return launch(*args, **options)

    # Processes of pytest-xdist ignore the signal.
    earlier = signal.signal(signal.SIGINT, signal.default_int_handler)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(wp, "launch", counted)
        try:
            yield
        except KeyboardInterrupt:
            pass
        finally:
            signal.signal(signal.SIGINT, earlier)


@pytest.mark.thorough(cases=("mechanism-0", "press-0", "relaxing gel-0"))
@pytest.mark.parametrize("seed", variants([0], range(6)))
def test_an_interrupted_step_leaves_no_trace(case: Any, seed: int) -> None:
    """Wherever: while kernels are loaded, the graph is recorded or replayed, states are copied."""
    build, ask, expected = case
    solver, state = build()
    draw = np.random.default_rng(seed)
    interrupted = 0
    for step in range(1, STEPS + 1):
        count = int(draw.integers(1, draw.choice([20, 100, 600]) if step > 1 else 100))
        before = [array.numpy().copy() for array in state.motion()]
        report = None
        with interrupted_at(count):
            report = solver.step(state, ask(solver, step))
        if report is None:
            interrupted += 1
            assert_same([array.numpy() for array in state.motion()], before)
            report = solver.step(state, ask(solver, step))
        assert report.converged.all()
        assert_same(everything(solver, state), expected[step])
    assert interrupted


@pytest.mark.thorough(cases=("mechanism",))
def test_an_interrupted_call_gives_up_all_steps_underway(case: Any) -> None:
    build, ask, expected = case
    solver, state = build()
    ready = ReadySteps(solver, state, 1)
    ready.step_ready(ask(solver, 1), np.arange(ENVS) == 0)
    with interrupted_at(40):
        ready.step_ready(ask(solver, 1), np.arange(ENVS) == 1)
    assert not ready.underway.any()
    assert_same([array.numpy() for array in state.motion()], expected[0][:-2])
    assert solver.step(state, ask(solver, 1)).converged.all()
    assert_same(everything(solver, state), expected[1])


@pytest.mark.thorough(cases=("mechanism",))
def test_a_copy_is_a_checkpoint_for_any_solver(case: Any) -> None:
    """Two solvers take the steps of two states in turn."""
    build, ask, expected = case
    (first, state), (second, _) = build(), build()
    copied = state.copy()
    for step in range(1, STEPS + 1):
        for solver, mine in ((first, state), (second, copied)):
            assert solver.step(mine, ask(solver, step)).converged.all()
            assert_same(everything(solver, mine), expected[step])
        first, second = second, first
        if step == 2:
            copied = state.copy()


@pytest.mark.thorough(cases=("mechanism",))
def test_states_in_turn_keep_the_graph_of_a_solver(case: Any) -> None:
    build, ask, expected = case
    solver, state = build()
    states = [state, state.copy(), state.copy()]
    for step in range(1, STEPS + 1):
        launches = solver.graph.launches
        for one in states:
            assert solver.step(one, ask(solver, step)).converged.all()
            assert_same(everything(solver, one), expected[step])
    assert solver.graph.launches == launches + len(states)


def test_every_state_is_searched_for_overlaps() -> None:
    """By a solver that has stepped, of a state that is new or that was written to by hand."""
    solver, state = make(True)
    assert solver.step(state, poses([1] * ENVS)).converged.all()
    sunk = np.arange(ENVS) == 1
    target = poses([1] * ENVS)
    target[sunk, 0, 2] = -1e-3
    other = initial_state(solver.model, target)
    report = solver.step(other, target)
    np.testing.assert_array_equal(report.status == EnvStatus.OVERLAP, sunk)
    assert report.converged[~sunk].all()
    state.restore(other, sunk)
    assert (solver.step(state, poses([1] * ENVS)).status == EnvStatus.OVERLAP)[1]
    state.positions.assign(other.positions)
    state.moved()
    assert (solver.step(state, poses([1] * ENVS)).status == EnvStatus.OVERLAP)[1]
    solver.reset(state, sunk, poses([0] * ENVS))
    assert solver.step(state, poses([1] * ENVS)).converged.all()


def test_states_of_other_models_are_refused() -> None:
    solver, state = make(True)
    gel = SoftBody(block_mesh((2, 2, 2), (6e-3, 6e-3, 3e-3)), Material(1e5, 0.4))
    other = initial_state(Scene(gel, env_count=ENVS).finalize())
    grid = PixelGrid(8, 8, 0.5, 0.5)
    uses: list[Callable[[], Any]] = [
        lambda: solver.step(other),
        lambda: solver.reset(other, np.ones(ENVS, dtype=bool)),
        lambda: state.restore(other),
        lambda: Outputs(solver).update(other),
        lambda: SignalTactile.from_solver(solver, grid).update(other),
    ]
    for use in uses:
        with pytest.raises(InputError, match=r"nodes|have shape"):
            use()


def test_a_state_is_not_pickled() -> None:
    with pytest.raises(InputError, match="cannot be pickled"):
        pickle.dumps(make(True)[1])


def test_forces_of_another_state_are_refused() -> None:
    solver, state = make(True)
    other = state.copy()
    outputs = Outputs(solver).update(other)
    assert solver.step(state, poses([1] * ENVS)).converged.all()
    assert outputs.momentum().kinetic_energy.shape[0] == ENVS
    for read in (
        lambda: outputs.normal_forces,
        lambda: outputs.sliding,
        lambda: outputs.soft_wrenches(),
        lambda: outputs.contact_wrenches(),
        lambda: outputs.energies,
    ):
        with pytest.raises(InputError, match="was of another state"):
            read()
    with interrupted_at(40):
        solver.step(state, poses([2] * ENVS))
    with pytest.raises(InputError, match="or was interrupted"):
        _ = Outputs(solver).update(state).normal_forces
    with pytest.raises(InputError, match="only the latest step of a solver"):
        solver.step(other, poses([1] * ENVS), again=True)


# Threads -----------------------------------------------------------------------------------------


def in_threads(work: list[Callable[[], Any]]) -> list[Any]:
    """What each returns or raises, run side by side."""
    found: list[Any] = [None] * len(work)
    start = threading.Barrier(len(work))

    def run(i: int) -> None:
        start.wait()
        try:
            found[i] = work[i]()
        except Exception as error:
            found[i] = error

    threads = [threading.Thread(target=run, args=(i,)) for i in range(len(work))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(300)
        assert not thread.is_alive(), "threads wait for each other"
    return found


def press(build: Callable[[], Made], ask: Any) -> list[list[np.ndarray]]:
    """A model, solver, state and signals of one's own; what each step leaves."""
    solver, state = build()
    signal = SignalTactile.from_solver(solver, PixelGrid(8, 8, 0.5, 0.5))
    found = []
    for step in range(1, STEPS + 1):
        assert solver.step(state, ask(solver, step)).converged.all()
        forces = Outputs(solver).update(state).soft_wrenches().numpy()
        signal.update(state)
        found.append([*everything(solver, state), forces, signal.height_m.numpy()])
    solver.reset(state, np.ones(ENVS, dtype=bool))
    return [*found, everything(solver, state)[:1]]


@pytest.mark.thorough
def test_threads_with_solvers_of_their_own_do_not_disturb_one_another(case: Any) -> None:
    build, ask, _ = case
    expected = press(build, ask)
    for found in in_threads([lambda: press(build, ask)] * 2):
        assert not isinstance(found, Exception), found
        for one, other in zip(found, expected, strict=True):
            assert_same(one, other)


def test_a_state_has_one_writer_at_a_time() -> None:
    """Steps underway belong to one solver: another one neither steps nor resets their state."""
    solver, state = make(True)
    other = SolverIPC(solver.model, solver.config)
    before = [array.numpy().copy() for array in state.motion()]
    ready = ReadySteps(solver, state, 1)
    ready.step_ready(poses([1] * ENVS))
    assert ready.underway.any()
    everyone = np.ones(ENVS, dtype=bool)
    for write in (
        lambda: other.step(state, poses([1] * ENVS)),
        lambda: ReadySteps(other, state).step_ready(poses([1] * ENVS)),
        lambda: other.reset(state, everyone),
        lambda: other.refresh_forces(state, everyone),
    ):
        with pytest.raises(InputError, match="another solver is stepping this state"):
            write()
    with pytest.raises(InputError, match="steps of another state underway"):
        ReadySteps(solver, state.copy()).step_ready(poses([1] * ENVS))
    assert_same([array.numpy() for array in state.motion()], before)
    ready.drop(everyone)
    assert other.step(state, poses([1] * ENVS)).converged.all()
    assert solver.step(state, poses([2] * ENVS)).converged.all()


def test_a_solver_that_is_gone_or_was_interrupted_holds_no_state() -> None:
    solver, state = make(True)
    model, config = solver.model, solver.config
    ready = ReadySteps(solver, state, 1)
    ready.step_ready(poses([1] * ENVS))
    del solver, ready
    gc.collect()
    solver = SolverIPC(model, config)
    ready = ReadySteps(solver, state, 1)
    ready.step_ready(poses([1] * ENVS))
    with interrupted_at(20):
        ready.step_ready(poses([1] * ENVS), np.zeros(ENVS, dtype=bool))
    assert SolverIPC(model, config).step(state, poses([1] * ENVS)).converged.all()


def test_two_solvers_in_two_threads_are_refused_one_state() -> None:
    """Whichever is second is refused, and loses nothing of the first one's step."""
    solver, state = make(True)
    other = SolverIPC(solver.model, solver.config)
    begun, over, said = threading.Event(), threading.Event(), []

    def waits(*_: Any, **__: Any) -> Any:
        begun.set()
        assert over.wait(60)
        return attempt(*_, **__)

    def intrude() -> None:
        begun.wait(60)
        try:
            other.step(state, poses([2] * ENVS))
        except InputError as error:
            said.append(str(error))
        over.set()

    attempt = solver._attempt
    thread = threading.Thread(target=intrude)
    thread.start()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(solver, "_attempt", waits)
        assert solver.step(state, poses([1] * ENVS)).converged.all()
    thread.join()
    assert said and "another solver is stepping this state" in said[0]


def test_a_solver_in_two_threads_is_refused() -> None:
    """And nothing of what the first one does is disturbed."""
    solver, state = make(False)
    expected = make(False)
    for step in range(1, STEPS + 1):
        expected[0].step(expected[1], poses([step] * ENVS))

    ended = threading.Event()

    def steps() -> int:
        try:
            return sum(
                solver.step(state, poses([step] * ENVS)).converged.all()
                for step in range(1, STEPS + 1)
            )
        finally:
            ended.set()

    def intrude() -> str:
        other = initial_state(solver.model, poses([0] * ENVS))
        while not ended.is_set():
            try:
                solver.step(other, poses([0] * ENVS))
            except InputError as error:
                return str(error)
        return "never refused"

    taken, said = in_threads([steps, intrude])
    assert taken == STEPS or "another thread" in str(taken), taken
    if taken == STEPS:
        assert "another thread is stepping this solver" in said
        np.testing.assert_array_equal(state.positions.numpy(), expected[1].positions.numpy())
