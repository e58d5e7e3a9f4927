# SPDX-License-Identifier: Apache-2.0
"""What a step depends on stands in the state: whatever happens to a solver, no bit differs."""

from __future__ import annotations

import gc
import pickle
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.outputs import Outputs
from taccel_lab.scene import Scene, TimeScheme
from taccel_lab.signals import SignalTactile
from taccel_lab.solvers import EnvStatus, ReadySteps, SolverIPC
from taccel_lab.state import State, initial_state
from tests.solvers.steps import (
    DT_S,
    ENVS,
    EVERYONE,
    RELAXING,
    Begun,
    asked,
    assert_same,
    finger,
    poses,
    pressed,
    stepped,
)
from tests.support.blocks import soft_block
from tests.support.variants import variants

STEPS = range(1, 5)
GRID = PixelGrid(8, 8, 0.5, 0.5)
Leftover = list[np.ndarray]


def ask_finger(solver: SolverIPC, step: int) -> Any:
    return asked(solver, step, DT_S[step])


def ask_press(solver: SolverIPC, step: int) -> Any:
    return poses(step)


CASES: dict[str, tuple[Callable[[], Begun], Callable[[SolverIPC, int], Any]]] = {
    "press": (pressed, ask_press),
    "relaxing gel": (lambda: pressed(branches=RELAXING), ask_press),
    "impact by BDF2": (lambda: pressed(False, TimeScheme.BDF2), ask_press),
    "mechanism": (finger, ask_finger),
}


def motion(state: State) -> Leftover:
    return [array.numpy().copy() for array in state.motion()]


def everything(solver: SolverIPC, state: State) -> Leftover:
    forces = (solver.contact_gradient, solver.friction_gradient)
    return motion(state) + [array.numpy().copy() for array in forces]


@pytest.fixture(scope="module", params=CASES)
def case(request: pytest.FixtureRequest) -> tuple[Any, Any, list[Leftover]]:
    """How to make it, what is asked of a step, and what each step leaves when nothing happens."""
    build, ask = CASES[request.param]
    solver, state = build()
    expected = [everything(solver, state)]
    for step in STEPS:
        stepped(solver, state, ask(solver, step))
        expected.append(everything(solver, state))
    return build, ask, expected


@contextmanager
def interrupted_at(count: int) -> Iterator[None]:
    """Ctrl-C at the launch or copy of that number."""
    launch, launches = wp.launch, iter(range(1, 1_000_000))

    def counted(*args: Any, **options: Any) -> Any:
        if next(launches) == count:
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
    draw, interrupted = np.random.default_rng(seed), 0
    for step in STEPS:
        count = int(draw.integers(1, draw.choice([20, 100, 600]) if step > 1 else 100))
        before, report = motion(state), None
        with interrupted_at(count):
            report = solver.step(state, ask(solver, step))
        if report is None:
            interrupted += 1
            assert_same(motion(state), before)
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
    assert_same(motion(state), expected[0][:-2])
    stepped(solver, state, ask(solver, 1))
    assert_same(everything(solver, state), expected[1])


@pytest.mark.thorough(cases=("mechanism",))
def test_a_copy_is_a_checkpoint_for_any_solver_and_its_graph(case: Any) -> None:
    build, ask, expected = case
    (first, state), (second, _) = build(), build()
    states = [state, state.copy(), state.copy()]
    for step in STEPS:
        launches = first.graph.launches + second.graph.launches
        for solver, mine in zip((first, second, first), states, strict=True):
            stepped(solver, mine, ask(solver, step))
            assert_same(everything(solver, mine), expected[step])
        states = [states[1], states[2], states[0].copy()]
    assert first.graph.launches + second.graph.launches == launches + len(states)


def test_every_state_is_searched_for_overlaps() -> None:
    """By a solver that has stepped, of a state that is new or that was written to by hand."""
    solver, state = pressed()
    stepped(solver, state, poses(1))
    sunk, target = np.arange(ENVS) == 1, poses(1)
    target[sunk, 0, 2] = -1e-3
    other = initial_state(solver.model, target)
    report = solver.step(other, target)
    np.testing.assert_array_equal(report.status == EnvStatus.OVERLAP, sunk)
    assert report.converged[~sunk].all()
    state.restore(other, sunk)
    assert solver.step(state, poses(1)).status[1] == EnvStatus.OVERLAP
    state.positions.assign(other.positions)
    state.moved()
    assert solver.step(state, poses(1)).status[1] == EnvStatus.OVERLAP
    solver.reset(state, sunk, poses(0))
    stepped(solver, state, poses(1))


def test_states_of_other_models_are_refused() -> None:
    solver, state = pressed()
    gel = soft_block((2, 2, 2), (6e-3, 6e-3, 3e-3))
    other = initial_state(Scene(gel, env_count=ENVS).finalize())
    for use in (
        lambda: solver.step(other),
        lambda: solver.reset(other, EVERYONE),
        lambda: state.restore(other),
        lambda: Outputs(solver).update(other),
        lambda: SignalTactile.from_solver(solver, GRID).update(other),
    ):
        with pytest.raises(InputError, match=r"nodes|have shape"):
            use()
    with pytest.raises(InputError, match="cannot be pickled"):
        pickle.dumps(state)


def test_forces_of_another_state_are_refused() -> None:
    solver, state = pressed()
    other = state.copy()
    outputs = Outputs(solver).update(other)
    stepped(solver, state, poses(1))
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
        solver.step(state, poses(2))
    with pytest.raises(InputError, match="or was interrupted"):
        _ = Outputs(solver).update(state).normal_forces
    with pytest.raises(InputError, match="only the latest step of a solver"):
        solver.step(other, poses(1), again=True)


# Threads -----------------------------------------------------------------------------------------


def press(build: Callable[[], Begun], ask: Any) -> list[Leftover]:
    """A model, solver, state and signals of one's own; what each step leaves."""
    solver, state = build()
    tactile = SignalTactile.from_solver(solver, GRID)
    found = []
    for step in STEPS:
        stepped(solver, state, ask(solver, step))
        forces = Outputs(solver).update(state).soft_wrenches().numpy()
        tactile.update(state)
        found.append([*everything(solver, state), forces, tactile.height_m.numpy()])
    solver.reset(state, EVERYONE)
    return [*found, everything(solver, state)[:1]]


@pytest.mark.thorough
def test_threads_with_solvers_of_their_own_do_not_disturb_one_another(case: Any) -> None:
    build, ask, _ = case
    expected = press(build, ask)
    with ThreadPoolExecutor(2) as threads:
        runs = [threads.submit(press, build, ask) for _ in range(2)]
        for run in runs:
            for one, other in zip(run.result(300), expected, strict=True):
                assert_same(one, other)


def test_a_state_has_one_writer_at_a_time() -> None:
    """Steps underway belong to one solver: another one neither steps nor resets their state."""
    solver, state = pressed()
    other = SolverIPC(solver.model, solver.config)
    before = motion(state)
    ready = ReadySteps(solver, state, 1)
    ready.step_ready(poses(1))
    assert ready.underway.any()
    for write in (
        lambda: other.step(state, poses(1)),
        lambda: ReadySteps(other, state).step_ready(poses(1)),
        lambda: other.reset(state, EVERYONE),
        lambda: other.refresh_forces(state, EVERYONE),
    ):
        with pytest.raises(InputError, match="another solver is stepping this state"):
            write()
    with pytest.raises(InputError, match="steps of another state underway"):
        ReadySteps(solver, state.copy()).step_ready(poses(1))
    assert_same(motion(state), before)
    ready.drop(EVERYONE)
    stepped(other, state, poses(1))
    stepped(solver, state, poses(2))


def test_a_solver_that_is_gone_or_was_interrupted_holds_no_state() -> None:
    solver, state = pressed()
    model, config = solver.model, solver.config
    ready = ReadySteps(solver, state, 1)
    ready.step_ready(poses(1))
    del solver, ready
    gc.collect()
    solver = SolverIPC(model, config)
    ready = ReadySteps(solver, state, 1)
    ready.step_ready(poses(1))
    with interrupted_at(20):
        ready.step_ready(poses(1), ~EVERYONE)
    stepped(SolverIPC(model, config), state, poses(1))


def test_two_solvers_in_two_threads_are_refused_one_state() -> None:
    """Whichever is second is refused, and loses nothing of the first one's step."""
    solver, state = pressed()
    other = SolverIPC(solver.model, solver.config)
    begun, over, attempt = threading.Event(), threading.Event(), solver._attempt

    def waits(*_: Any, **__: Any) -> Any:
        begun.set()
        assert over.wait(60)
        return attempt(*_, **__)

    def intrude() -> None:
        begun.wait(60)
        try:
            other.step(state, poses(2))
        finally:
            over.set()

    with ThreadPoolExecutor(1) as threads, pytest.MonkeyPatch.context() as patch:
        said = threads.submit(intrude)
        patch.setattr(solver, "_attempt", waits)
        stepped(solver, state, poses(1))
        with pytest.raises(InputError, match="another solver is stepping this state"):
            said.result(60)


def test_a_solver_in_two_threads_is_refused() -> None:
    (solver, state), expected = pressed(False), pressed(False)
    for step in STEPS:
        expected[0].step(expected[1], poses(step))
    start, ended = threading.Barrier(2), threading.Event()

    def steps() -> str:
        start.wait()
        try:
            for step in STEPS:
                stepped(solver, state, poses(step))
            return ""
        except InputError as error:
            return str(error)
        finally:
            ended.set()

    def intrude() -> str:
        other = initial_state(solver.model, poses(0))
        start.wait()
        while not ended.is_set():
            try:
                solver.step(other, poses(0))
            except InputError as error:
                return str(error)
        return "never refused"

    with ThreadPoolExecutor(2) as threads:
        runs = [threads.submit(work) for work in (steps, intrude)]
        failed, said = (run.result(300) for run in runs)
    if failed:
        assert "another thread" in failed
    else:
        assert "another thread is stepping this solver" in said
        np.testing.assert_array_equal(state.positions.numpy(), expected[1].positions.numpy())
