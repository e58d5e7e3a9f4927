# SPDX-License-Identifier: Apache-2.0
"""Materials with Maxwell branches against closed forms: held strain, held force, harmonic strain,
cycles; and what a step leaves in the state."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from taccel_lab.errors import InputError
from taccel_lab.ipc.potentials.elements.elastic import ElasticPotential
from taccel_lab.scene import (
    Ball,
    Element,
    KinematicBody,
    Material,
    MaxwellBranch,
    Scene,
    SoftBody,
    box_mesh,
)
from taccel_lab.solvers import Control, EnvStatus
from taccel_lab.solvers.tangent import Tangent
from tests.support.blocks import block_mesh, everywhere, pose
from tests.support.scene_steps import Stepped, in_time, linear

YOUNG, NU = 1e5, 0.45
MU, LAM = YOUNG / (2 * (1 + NU)), YOUNG * NU / ((1 + NU) * (1 - 2 * NU))
BRANCHES = (MaxwellBranch(0.5, 0.2), MaxwellBranch(0.3, 2.0), MaxwellBranch(0.2, 20.0))
ONE = (MaxwellBranch(0.5, 1.0),)
SIDE = 2e-3
AT_ONCE_S = 1e-6
EXACT = {"absolute_tolerance_n": 1e-13}
Branches = tuple[MaxwellBranch, ...]


def gel(branches: Branches) -> Material:
    return Material(YOUNG, NU, branches=branches)


CUBE = block_mesh((2, 2, 2), (SIDE, SIDE, SIDE))


class HeldCube(Stepped):
    def __init__(self, branches: Branches, element: Element = Element.LINEAR) -> None:
        surface = np.unique(CUBE.faces)
        super().__init__(Scene(SoftBody(CUBE, gel(branches), surface, element=element)), **EXACT)
        self.top = self.rest[:, 2] > self.rest[:, 2].max() - 1e-9
        self.stretch = 1.0

    def pull(self, stretch: float, dt_s: float) -> float:
        """Hold for that time, then stretch along z at once; the pull on the top [Pa]."""
        if dt_s:
            self.step(Control(dt_s=dt_s))
        if stretch != self.stretch:
            x = self.rest * [1, 1, stretch]
            self.state.positions = wp.array(x[None], dtype=wp.vec3d)
            self.stretch = stretch
        self.step(Control(dt_s=AT_ONCE_S))
        return float(self.solver.gradient.numpy()[0, self.top, 2].sum()) / SIDE**2


def stress(stretch: float) -> float:
    """Neo-Hookean nominal stress [Pa] of a cube that is stretched along one axis alone."""
    return MU * (stretch - 1 / stretch) + LAM * np.log(stretch) / stretch


@pytest.mark.parametrize("element", list(Element))
@pytest.mark.parametrize("stretch", [0.999, 0.7, 1.3])
def test_held_strain_relaxes_as_the_closed_form(element: Element, stretch: float) -> None:
    """F_e = F^(exp(-t / tau)) in each branch; of small strains a sum of exponentials."""
    cube = HeldCube(BRANCHES, element)
    time = 0.0
    for dt in (0.0, 0.1, 0.1, 1.0, 5.0, 10.0):
        found = cube.pull(stretch, dt)
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


MEAN_M, SWING_M = 3e-5, 2e-6


def harmonic(steps: int, omega: float, branches: Branches = ONE) -> complex:
    """Force over depth [N/m] of a block under a plate, in the third cycle about a relaxed depth."""
    made = Scene(linear(CUBE, gel(branches)), KinematicBody(box_mesh((4e-3, 4e-3, 1e-3))))
    block = Stepped(made, pose(0, 0, 0.5e-3 + 5e-6), dhat_m=2e-6, relative_tolerance=1e-9)

    def press(depth_m: float, dt_s: float) -> float:
        target = everywhere(1, pose(0, 0, 0.5e-3 - depth_m))
        block.step(Control(target, dt_s=dt_s if branches else None))
        return float(-block.force(0)[2])

    for hold in (1e-3, 10.0, 10.0):
        press(MEAN_M, hold)
    phase = 2 * np.pi * np.arange(1, 3 * steps + 1) / steps
    forces = [press(MEAN_M + SWING_M * np.sin(p), 2 * np.pi / omega / steps) for p in phase]
    turn = np.exp(-1j * phase[-steps:])
    return complex(np.dot(forces[-steps:], turn) / (SWING_M * (np.sin(phase[-steps:]) @ turn)))


@pytest.mark.thorough
@pytest.mark.parametrize("omega", [0.5, 4.0])
def test_a_harmonic_strain_has_the_loss_angle(omega: float) -> None:
    """E* = E (1 + g i w tau / (1 + i w tau)); a step half as long has a quarter of the error."""
    turn = 1j * omega * ONE[0].time_s
    expected = 1 + ONE[0].relative_modulus * turn / (1 + turn)
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
    active = wp.full(1, 1, dtype=wp.int32)
    before, stretch, works = 0.0, 1.0, []
    for phase in np.linspace(0, 4 * np.pi, 49)[1:]:
        new = float(np.exp(amplitude * np.sin(phase)))
        work = cube.pull(new, 0.3) * (new - stretch) * SIDE**3
        # Of the solid and of the branches at the end of the step [J].
        after = sum(part.energy(active, cube.state.positions)[0] for part in cube.solver.elements)
        assert after - before <= work * (1 + 1e-9) + 1e-14
        works.append(work)
        before, stretch = after, new
    assert sum(works[24:]) > 0.02 * np.abs(works[24:]).sum()


class Column(Stepped):
    def __init__(self, branches: Branches) -> None:
        super().__init__(Scene(linear(CUBE, gel(branches))), **EXACT)
        self.top = self.rest[:, 2] > self.rest[:, 2].max() - 1e-9
        self.forces = np.zeros((1, *self.rest.shape))
        self.forces[0, self.top, 2] = 1e-6

    def rise(self, dt_s: float) -> float:
        self.step(Control(dt_s=dt_s, forces=self.forces))
        return float((self.x() - self.rest)[self.top, 2].mean())


def test_a_held_force_creeps_as_the_closed_form() -> None:
    """u(t) = u (1 - g / (1 + g) exp(-t / ((1 + g) tau))); half the step, a quarter of the error."""
    solid = Column((MaxwellBranch(1e-6, 1.0),)).rise(1.0)
    share, tau = ONE[0].relative_modulus, ONE[0].time_s
    errors = []
    for steps in (10, 20):
        column, dt = Column(ONE), 2.0 / steps
        assert column.rise(1e-6) / solid == pytest.approx(1 / (1 + share), rel=1e-4)
        found = [column.rise(dt) / solid for _ in range(steps)]
        times = dt * np.arange(1, steps + 1)
        expected = 1 - share / (1 + share) * np.exp(-times / ((1 + share) * tau))
        errors.append(np.abs(found - expected).max())
    assert errors[1] < 5e-4
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.15)


def past(run: Stepped) -> np.ndarray:
    assert run.state.viscous_inverses is not None
    return run.state.viscous_inverses.numpy().copy()


def test_a_falling_body_that_turns_has_no_stress() -> None:
    mesh = block_mesh((1, 1, 1), (SIDE, SIDE, SIDE))
    body = linear(mesh, gel(ONE), bonded_nodes=np.zeros(0, dtype=np.int64))
    run = Stepped(Scene(body, time=in_time(1e-3, 0.0)), **EXACT)
    turned = Rotation.from_rotvec(np.radians(80) * np.array([1, 2, 3]) / 14**0.5).apply(run.rest)
    run.state.positions = wp.array(turned[None], dtype=wp.vec3d)
    run.step()
    np.testing.assert_allclose(run.x(), turned, atol=1e-12)
    np.testing.assert_allclose(past(run), np.broadcast_to(np.eye(3), past(run).shape), atol=1e-12)


class Pressed(Stepped):
    """Gels under balls, from 0.1 mm above; a step takes 0.4 s."""

    def __init__(
        self,
        env_count: int = 1,
        branches: Branches = BRANCHES[1:],
        friction: float = 0.4,
        **config: Any,
    ) -> None:
        mesh = block_mesh((4, 4, 2), (4e-3, 4e-3, 2e-3), jitter=0.1)
        tool = KinematicBody(Ball(1.5e-3), friction)
        made = Scene(SoftBody(mesh, gel(branches)), tool, env_count)
        super().__init__(made, self.ball(-1e-4, env_count), **config)

    def ball(self, depth_m: float | list[float], env_count: int = 0) -> np.ndarray:
        depths = np.broadcast_to(depth_m, env_count or self.model.env_count)
        return np.stack([pose(0, 0, 1.52e-3 - depth) for depth in depths])[:, None]

    def press(self, *depths_m: float | list[float], dt_s: float = 0.4, **more: Any) -> None:
        for depth in depths_m:
            report = self.attempt(Control(self.ball(depth), dt_s=dt_s), **more)
            assert report.converged[more.get("who", slice(None))].all(), report.summary()

    def forces(self) -> np.ndarray:
        return self.solver.contact_gradient.numpy()[:, self.nodes(0), 2].sum(axis=1)


PATH = [1e-4, 2e-4, 3e-4, 3e-4, 3e-4]
FIRST, SECOND = np.array([True, False]), np.array([False, True])


@pytest.mark.thorough
def test_a_step_that_fails_leaves_what_was_there() -> None:
    run = Pressed(2)
    run.press(*PATH[:2])
    before = past(run)
    hasty = Pressed(2, max_newton_iterations=4, max_substep_halvings=0)
    control = Control(run.ball([2e-4, 9e-4]), dt_s=0.4)
    report = hasty.solver.step(run.state, control, who=SECOND)
    assert report.status.tolist() == [EnvStatus.SKIPPED, EnvStatus.NO_CONVERGENCE]
    np.testing.assert_array_equal(past(run), before)
    run.press(2e-4, who=FIRST)
    np.testing.assert_array_equal(past(run)[1], before[1])
    assert np.abs(past(run)[0] - before[0]).max() > 1e-3


@pytest.mark.thorough
def test_a_step_in_halves_relaxes_for_its_whole_time() -> None:
    few, twin = Pressed(friction=0.0, max_newton_iterations=14), Pressed(friction=0.0)
    assert few.step(Control(few.ball(6e-4), dt_s=0.8)).substeps[0] == 2
    twin.press(2.5e-4, 6e-4)
    np.testing.assert_allclose(past(few), past(twin), atol=1e-4)
    assert np.abs(past(few) - np.eye(3)).max() > 1e-2


@pytest.mark.thorough
def test_environments_have_their_own_past_and_moduli() -> None:
    """One that is reset is as new; faster is stiffer; twice the modulus, twice the force."""
    run, second = Pressed(3), np.array([False, True, False])
    run.model.set_body("gel", young_modulus_pa=np.array([1, 1, 2]) * YOUNG)
    run.press(*PATH[:3])
    run.solver.reset(run.state, second, run.ball(-1e-4))
    found = past(run)
    np.testing.assert_array_equal(found[1], np.broadcast_to(np.eye(3), found[1].shape))
    np.testing.assert_allclose(found[0], found[2], atol=1e-3)
    run.press(*PATH[:3], dt_s=1e-3, who=second)
    forces = run.forces()
    assert 1.02 * forces[0] < forces[1] < 1.06 * forces[0]
    assert forces[2] == pytest.approx(2 * forces[0], rel=0.01)


@pytest.mark.thorough
def test_a_step_that_is_taken_again_relaxes_for_its_own_time() -> None:
    run = Pressed(relative_tolerance=1e-8)
    run.press(*PATH[:3])
    before, first = past(run), run.forces()[0]
    run.press(3.2e-4, again=True)
    assert np.abs(past(run) - before).max() > 1e-4
    run.press(3e-4, again=True)
    assert np.abs(past(run) - before).max() < 1e-6
    assert run.forces()[0] == pytest.approx(first, rel=1e-5)


def test_a_scene_without_branches_has_nothing_of_it() -> None:
    run = Pressed(branches=())
    assert run.state.viscous_inverses is None and run.solver.work.viscous_inverses is None
    assert run.solver.elements == run.solver.elastic
    assert all(isinstance(part, ElasticPotential) for part in run.solver.elements)
    assert not run.solver.plan.is_on("relaxation")
    with pytest.raises(InputError, match="a material with Maxwell branches"):
        run.press(0.0, dt_s=0.1)


def test_gradients_refuse_it() -> None:
    run = Pressed()
    run.press(PATH[0])
    with pytest.raises(InputError, match="depends on its past"):
        Tangent(run.solver, run.state)
