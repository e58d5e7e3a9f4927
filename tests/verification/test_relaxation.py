# SPDX-License-Identifier: Apache-2.0
"""Materials with Maxwell branches against closed forms: held strain, held force, harmonic strain,
cycles; and what a step leaves in the state."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.ipc.potentials.elements.elastic import ElasticPotential
from taccel_lab.model import Model
from taccel_lab.scene import (
    Ball,
    Element,
    KinematicBody,
    Material,
    MaxwellBranch,
    Scene,
    SoftBody,
    TimeStepping,
    box_mesh,
)
from taccel_lab.solvers import Control, EnvStatus
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.solvers.tangent import Tangent
from taccel_lab.state import State, initial_state
from tests.support.blocks import block_mesh, everywhere, pose

YOUNG, NU = 1e5, 0.45
MU, LAM = YOUNG / (2 * (1 + NU)), YOUNG * NU / ((1 + NU) * (1 - 2 * NU))
BRANCHES = (MaxwellBranch(0.5, 0.2), MaxwellBranch(0.3, 2.0), MaxwellBranch(0.2, 20.0))
ONE = (MaxwellBranch(0.5, 1.0),)
SIDE = 2e-3
AT_ONCE_S = 1e-6
KINDS = list(Element)
NO_BODIES = np.zeros((1, 0, 7))
EXACT = SolverConfig(absolute_tolerance_n=1e-13)
TIGHT = SolverConfig(relative_tolerance=1e-8)


class HeldCube:
    """A cube whose surface is moved by hand: its deformation is the same everywhere."""

    def __init__(
        self, branches: tuple[MaxwellBranch, ...], element: Element = Element.LINEAR
    ) -> None:
        mesh = block_mesh((2, 2, 2), (SIDE, SIDE, SIDE))
        surface = np.unique(mesh.faces)
        body = SoftBody(
            mesh, Material(YOUNG, NU, branches=branches), bonded_nodes=surface, element=element
        )
        self.model = Scene(body).finalize()
        self.solver = SolverIPC(self.model, EXACT)
        self.state = initial_state(self.model, NO_BODIES)
        self.rest = self.model.rest_positions.numpy()[0]
        self.top = self.rest[:, 2] > self.rest[:, 2].max() - 1e-9
        self.stretch = 1.0

    def step(self, stretch: float, dt_s: float) -> float:
        """Hold for that time, if any, then stretch along z within ``AT_ONCE_S``. Returns the pull
        on the top face over its area [Pa]."""
        if dt_s:
            self._solve(dt_s)
        if stretch != self.stretch:
            x = self.rest * [1, 1, stretch]
            self.state.positions = wp.array(x[None], dtype=wp.vec3d)
            self.stretch = stretch
        self._solve(AT_ONCE_S)
        return float(self.solver.gradient.numpy()[0, self.top, 2].sum()) / SIDE**2

    def _solve(self, dt_s: float) -> None:
        report = self.solver.step(self.state, Control(dt_s=dt_s))
        assert report.converged.all(), report.summary()


def stress(stretch: float) -> float:
    """Neo-Hookean nominal stress [Pa] of a cube that is stretched along one axis alone."""
    return MU * (stretch - 1 / stretch) + LAM * np.log(stretch) / stretch


@pytest.mark.parametrize("element", KINDS)
@pytest.mark.parametrize("stretch", [0.999, 0.7, 1.3])
def test_held_strain_relaxes_as_the_closed_form(element: Element, stretch: float) -> None:
    """F_e = F^(exp(-t / tau)) in each branch, whatever the steps; of small strains the pull is a
    sum of exponentials."""
    cube = HeldCube(BRANCHES, element)
    time = 0.0
    for dt in (0.0, 0.1, 0.1, 1.0, 5.0, 10.0):
        found = cube.step(stretch, dt)
        time += dt + AT_ONCE_S
        expected = stress(stretch)
        for branch in BRANCHES:
            elastic = stretch ** np.exp(-time / branch.time_s)
            # P = g P(F_e) F_v^-T.
            expected += branch.relative_modulus * stress(elastic) * elastic / stretch
        # The step that reads it is 5e-6 of the shortest time long.
        assert found == pytest.approx(expected, rel=5e-6)
        if stretch == 0.999:
            series = 1 + sum(b.relative_modulus * np.exp(-time / b.time_s) for b in BRANCHES)
            assert found == pytest.approx(series * stress(stretch), rel=1e-3)


class Punched:
    """A glued block under a plate that covers it, without friction."""

    def __init__(self, branches: tuple[MaxwellBranch, ...]) -> None:
        mesh = block_mesh((2, 2, 2), (SIDE, SIDE, SIDE))
        body = SoftBody(mesh, Material(YOUNG, NU, branches=branches), element=Element.LINEAR)
        plate = KinematicBody(box_mesh((4e-3, 4e-3, 1e-3)))
        self.model = Scene(body, plate).finalize()
        config = SolverConfig(dhat_m=2e-6, relative_tolerance=1e-9)
        self.solver = SolverIPC(self.model, config)
        self.state = initial_state(self.model, self._plate(-5e-6))

    def _plate(self, depth_m: float) -> np.ndarray:
        return everywhere(1, pose(0, 0, 0.5e-3 - depth_m))

    def press(self, depth_m: float, dt_s: float | None) -> float:
        """Force [N] at the end of a step to that depth."""
        report = self.solver.step(self.state, Control(self._plate(depth_m), dt_s=dt_s))
        assert report.converged.all(), report.summary()
        return float(force(self.solver)[0])


MEAN_M, SWING_M = 3e-5, 2e-6


def harmonic(steps: int, omega: float, branches: tuple[MaxwellBranch, ...] = ONE) -> complex:
    """Force over depth [N/m] of the third cycle about a depth at which the gel has relaxed."""
    block = Punched(branches)
    dt = 2 * np.pi / omega / steps if branches else None
    for hold in (1e-3, 10.0, 10.0):
        block.press(MEAN_M, hold if branches else None)
    phase = 2 * np.pi * np.arange(1, 3 * steps + 1) / steps
    forces = [block.press(MEAN_M + SWING_M * np.sin(p), dt) for p in phase]
    turn = np.exp(-1j * phase[-steps:])
    return complex(np.dot(forces[-steps:], turn) / (SWING_M * (np.sin(phase[-steps:]) @ turn)))


@pytest.mark.thorough
@pytest.mark.parametrize("omega", [0.5, 4.0])
def test_a_harmonic_strain_has_the_loss_angle(omega: float) -> None:
    """E* = E (1 + g i w tau / (1 + i w tau)); a step half as long has a quarter of the error."""
    branch = ONE[0]
    turn = 1j * omega * branch.time_s
    expected = 1 + branch.relative_modulus * turn / (1 + turn)
    relaxed = harmonic(8, omega, ())
    coarse, finer, fine = (harmonic(steps, omega) / relaxed for steps in (8, 16, 64))
    assert abs(fine) == pytest.approx(abs(expected), rel=5e-3)
    assert np.angle(fine) == pytest.approx(np.angle(expected), rel=0.01)
    assert abs(coarse - fine) < 0.03
    assert abs(coarse - fine) / abs(finer - fine) == pytest.approx(4.2, rel=0.15)


@pytest.mark.parametrize("amplitude", [1e-3, 0.3])
def test_no_closed_cycle_gains_energy(amplitude: float) -> None:
    """The work of the pull is at least what is stored, step by step, and positive in a cycle."""
    cube = HeldCube(BRANCHES)
    volume = SIDE**3
    active = wp.full(1, 1, dtype=wp.int32)

    def stored() -> float:
        """Of the solid and of the branches at the end of the step [J]."""
        parts = cube.solver.elements
        return float(sum(part.energy(active, cube.state.positions)[0] for part in parts))

    before, stretch, works = 0.0, 1.0, []
    for phase in np.linspace(0, 4 * np.pi, 49)[1:]:
        new = float(np.exp(amplitude * np.sin(phase)))
        work = cube.step(new, 0.3) * (new - stretch) * volume
        after = stored()
        assert after - before <= work * (1 + 1e-9) + 1e-14
        works.append(work)
        before, stretch = after, new
    assert sum(works[24:]) > 0.02 * np.abs(works[24:]).sum()


class Column:
    """A block glued at its bottom, pulled by forces on its top."""

    def __init__(self, branches: tuple[MaxwellBranch, ...], time: TimeStepping | None) -> None:
        mesh = block_mesh((2, 2, 2), (SIDE, SIDE, SIDE))
        body = SoftBody(mesh, Material(YOUNG, NU, branches=branches), element=Element.LINEAR)
        self.model = Scene(body, time=time).finalize()
        self.solver = SolverIPC(self.model, EXACT)
        self.state = initial_state(self.model, NO_BODIES)
        self.rest = self.model.rest_positions.numpy()[0]
        self.top = self.rest[:, 2] > self.rest[:, 2].max() - 1e-9
        forces = np.zeros((1, *self.rest.shape))
        forces[0, self.top, 2] = 1e-6
        self.forces = forces

    def rise(self, dt_s: float) -> float:
        """Mean displacement of the top after a step [m]."""
        report = self.solver.step(self.state, Control(dt_s=dt_s, forces=self.forces))
        assert report.converged.all(), report.summary()
        return float((self.state.positions.numpy()[0] - self.rest)[self.top, 2].mean())


def test_a_held_force_creeps_as_the_closed_form() -> None:
    """u(t) = u (1 - g / (1 + g) exp(-t / ((1 + g) tau))); half the step, a quarter of the error."""
    solid = Column((MaxwellBranch(1e-6, 1.0),), None).rise(1.0)
    share, tau = ONE[0].relative_modulus, ONE[0].time_s
    errors = []
    for steps in (10, 20):
        column, dt = Column(ONE, None), 2.0 / steps
        first = column.rise(1e-6) / solid
        assert first == pytest.approx(1 / (1 + share), rel=1e-4)
        found = [column.rise(dt) / solid for _ in range(steps)]
        times = dt * np.arange(1, steps + 1)
        expected = 1 - share / (1 + share) * np.exp(-times / ((1 + share) * tau))
        errors.append(np.abs(found - expected).max())
    assert errors[1] < 5e-4
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.15)


def test_a_falling_body_that_turns_has_no_stress() -> None:
    """In dynamic scenes too: a block that spins freely keeps its size."""
    mesh = block_mesh((1, 1, 1), (SIDE, SIDE, SIDE))
    gel = Material(YOUNG, NU, branches=ONE)
    body = SoftBody(mesh, gel, bonded_nodes=np.zeros(0, dtype=np.int64), element=Element.LINEAR)
    time = TimeStepping(quasi_static=False, dt_s=1e-3)
    model = Scene(body, time=time).finalize()
    solver, state = SolverIPC(model, EXACT), initial_state(model, NO_BODIES)
    rest = model.rest_positions.numpy()[0]
    turn = pose(0, 0, 0, (1, 2, 3), 80)
    from scipy.spatial.transform import Rotation

    turned = Rotation.from_quat(turn[3:]).apply(rest)
    state.positions = wp.array(turned[None], dtype=wp.vec3d)
    report = solver.step(state)
    assert report.converged.all(), report.summary()
    np.testing.assert_allclose(state.positions.numpy()[0], turned, atol=1e-12)
    assert state.viscous_inverses is not None
    found = state.viscous_inverses.numpy().copy()
    np.testing.assert_allclose(found, np.broadcast_to(np.eye(3), found.shape), atol=1e-12)


# What stands in the state ---------------------------------------------------------------------


def pressed(
    env_count: int = 1, branches: tuple[MaxwellBranch, ...] = BRANCHES[1:], friction: float = 0.4
) -> Model:
    mesh = block_mesh((4, 4, 2), (4e-3, 4e-3, 2e-3), jitter=0.1)
    body = SoftBody(mesh, Material(YOUNG, NU, branches=branches))
    return Scene(body, KinematicBody(Ball(1.5e-3), friction), env_count).finalize()


def ball(env_count: int, *depths_m: float) -> np.ndarray:
    return np.stack([pose(0, 0, 1.52e-3 - depth) for depth in depths_m])[:, None][
        np.arange(env_count) % len(depths_m)
    ]


def force(solver: SolverIPC) -> np.ndarray:
    """Of the gel on the tool along z [N], [env_count]."""
    return solver.contact_gradient.numpy()[:, : solver.model.soft_count, 2].sum(axis=1)


def steps(solver: SolverIPC, state: State, depths: list[float]) -> None:
    count = solver.model.env_count
    for depth in depths:
        report = solver.step(state, Control(ball(count, depth), dt_s=0.4))
        assert report.converged.all(), report.summary()


PATH = [1e-4, 2e-4, 3e-4, 3e-4, 3e-4]


@pytest.mark.thorough
def test_a_step_that_fails_leaves_what_was_there() -> None:
    """And an environment that is not stepped does not relax."""
    model = pressed(2)
    solver = SolverIPC(model, SolverConfig(max_newton_iterations=4, max_substep_halvings=0))
    state = initial_state(model, ball(2, -1e-4))
    usual = SolverIPC(model)
    steps(usual, state, PATH[:2])
    assert state.viscous_inverses is not None
    before = state.viscous_inverses.numpy().copy()
    report = solver.step(state, Control(ball(2, 2e-4, 9e-4), dt_s=0.4), who=np.array([False, True]))
    assert report.status.tolist() == [EnvStatus.SKIPPED, EnvStatus.NO_CONVERGENCE]
    np.testing.assert_array_equal(state.viscous_inverses.numpy().copy(), before)
    report = usual.step(state, Control(ball(2, 2e-4), dt_s=0.4), who=np.array([True, False]))
    after = state.viscous_inverses.numpy().copy()
    np.testing.assert_array_equal(after[1], before[1])
    assert np.abs(after[0] - before[0]).max() > 1e-3


@pytest.mark.thorough
def test_a_step_in_halves_relaxes_for_its_whole_time() -> None:
    """As two steps of half the way and half the time."""
    model = pressed(friction=0.0)
    few = SolverIPC(model, SolverConfig(max_newton_iterations=14))
    state, twin = (initial_state(model, ball(1, -1e-4)) for _ in range(2))
    report = few.step(state, Control(ball(1, 6e-4), dt_s=0.8))
    assert report.converged.all() and report.substeps[0] == 2, report.summary()
    solver = SolverIPC(model)
    for depth in (2.5e-4, 6e-4):
        report = solver.step(twin, Control(ball(1, depth), dt_s=0.4))
        assert report.converged.all(), report.summary()
    assert state.viscous_inverses is not None and twin.viscous_inverses is not None
    halved = state.viscous_inverses.numpy()
    np.testing.assert_allclose(halved, twin.viscous_inverses.numpy(), atol=1e-4)
    assert np.abs(halved - np.eye(3)).max() > 1e-2


@pytest.mark.thorough
def test_environments_have_their_own_past_and_moduli() -> None:
    """One that is reset is as new, and stiffer when it is pressed faster; one twice as stiff has
    twice the force."""
    model = pressed(3)
    model.set_body(model.bodies[0].name, young_modulus_pa=np.array([1, 1, 2]) * YOUNG)
    solver, state = SolverIPC(model), initial_state(model, ball(3, -1e-4))
    steps(solver, state, PATH[:3])
    solver.reset(state, np.array([False, True, False]), ball(3, -1e-4))
    assert state.viscous_inverses is not None
    found = state.viscous_inverses.numpy().copy()
    np.testing.assert_array_equal(found[1], np.broadcast_to(np.eye(3), found[1].shape))
    np.testing.assert_allclose(found[0], found[2], atol=1e-3)
    for depth in PATH[:3]:
        control = Control(ball(3, depth), dt_s=1e-3)
        report = solver.step(state, control, who=np.array([False, True, False]))
        assert report.converged[1], report.summary()
    forces = force(solver)
    assert 1.02 * forces[0] < forces[1] < 1.06 * forces[0]
    assert forces[2] == pytest.approx(2 * forces[0], rel=0.01)


@pytest.mark.thorough
def test_a_step_that_is_taken_again_relaxes_for_its_own_time() -> None:
    """To other targets and back: it ends where it had ended."""
    model = pressed()
    solver, state = SolverIPC(model, TIGHT), initial_state(model, ball(1, -1e-4))
    steps(solver, state, PATH[:3])
    assert state.viscous_inverses is not None
    before, first = state.viscous_inverses.numpy().copy(), force(solver)[0]
    for depth in (3.2e-4, 3e-4):
        report = solver.step(state, Control(ball(1, depth), dt_s=0.4), again=True)
        assert report.converged.all(), report.summary()
        change = np.abs(state.viscous_inverses.numpy() - before).max()
        assert change > 1e-4 if depth > 3e-4 else change < 1e-6
    assert force(solver)[0] == pytest.approx(first, rel=1e-5)


def test_a_scene_without_branches_has_nothing_of_it() -> None:
    model = pressed(branches=())
    solver, state = SolverIPC(model), initial_state(model, ball(1, -1e-4))
    assert state.viscous_inverses is None and solver.work.viscous_inverses is None
    assert solver.elements == solver.elastic
    assert all(isinstance(part, ElasticPotential) for part in solver.elements)
    assert not solver.plan.is_on("relaxation")
    with pytest.raises(InputError, match="a material with Maxwell branches"):
        solver.step(state, Control(ball(1, 0.0), dt_s=0.1))


def test_gradients_refuse_it() -> None:
    model = pressed()
    solver, state = SolverIPC(model), initial_state(model, ball(1, -1e-4))
    steps(solver, state, PATH[:1])
    with pytest.raises(InputError, match="depends on its past"):
        Tangent(solver, state)
