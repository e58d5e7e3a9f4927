# SPDX-License-Identifier: Apache-2.0
"""A block on an inclined floor under gravity that points down, for all kinds of blocks and floors.

It sticks if and only if tan(angle) <= mu. Below that it creeps: friction is mu N (2 y - y^2) at
sliding of y eps a step, hence at y = 1 - sqrt(1 - tan / mu), never faster than eps_v = eps / dt.
Beyond it slides at g (sin - mu cos). (``test_affine`` leans gravity instead.)
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from taccel_lab.errors import InputError
from taccel_lab.model.env_rows import device_mask
from taccel_lab.outputs import Outputs
from taccel_lab.scene import (
    AffineBody,
    Ball,
    Element,
    KinematicBody,
    Material,
    Plane,
    Scene,
    SoftBody,
    TimeStepping,
    box_mesh,
)
from taccel_lab.solvers import Control, SolverConfig, SolverIPC
from taccel_lab.solvers.step_report import EnvStatus, StepReport
from tests.support.blocks import block_mesh, free_block, pose
from tests.support.scene_steps import G, Stepped, in_time, linear
from tests.support.variants import variants

SIDE, DENSITY, MU = 2e-2, 1000.0, 0.4
MASS = DENSITY * SIDE**3
DHAT = 2e-5
TIGHT = {"dhat_m": DHAT, "relative_tolerance": 1e-5, "absolute_tolerance_n": 1e-10}
AZIMUTH = 0.5
"""Direction of the slope [rad]: along no edge of the block or of the floor."""


class Slope(Stepped):
    """A block of 8 g at rest, half of dhat above a floor whose tangent is ``tangent``."""

    def __init__(
        self, block: str, floor: str, tangent: float, dt: float = 0.01, **config: float
    ) -> None:
        angle = float(np.arctan(tangent))
        self.sin, self.cos = np.sin(angle), np.cos(angle)
        east, north = np.cos(AZIMUTH), np.sin(AZIMUTH)
        down, axis = np.array([[east * self.cos, north * self.cos, -self.sin], [-north, east, 0]])
        turn = np.append(axis * np.sin(angle / 2), np.cos(angle / 2))
        normal = np.cross(down, axis)
        self.frame = np.stack([down, axis, normal])
        """Rows: down the slope, across, up."""
        self.weight, self.dt = MASS * G, dt
        placed = np.append((SIDE / 2 + 0.5 * DHAT) * normal, turn)
        bodies: dict[str, Any] = {}
        if block == "affine":
            shape = box_mesh((SIDE, SIDE, SIDE))
            bodies["affine_bodies"] = AffineBody(shape, DENSITY, initial_pose=placed)
        else:
            # The mesh has its origin in its upper face.
            placed[:3] += SIDE / 2 * normal
            gel, kind = Material(1e6, 0.3, DENSITY), Element(block)
            mesh = free_block((2, 2, 2), SIDE)
            bodies["soft_bodies"] = SoftBody(mesh, gel, initial_pose=placed, element=kind)
        start = []
        if floor == "plane":
            x, y, z = map(float, normal)
            bodies["planes"] = Plane(normal=(x, y, z), friction_coefficient=MU)
        elif floor == "box":
            bodies["kinematic_bodies"] = KinematicBody(box_mesh((0.2, 0.2, 0.02)), MU)
            start = [np.append(-0.01 * normal, turn)]
        else:
            # A gel glued to a tilted back plate.
            bodies["soft_bodies"] = linear(
                block_mesh((8, 8, 2), (2 * SIDE, 2 * SIDE, SIDE / 2)),
                Material(2e5, 0.45, DENSITY),
                friction_coefficient=MU,
                mount="back",
            )
            bodies["kinematic_bodies"] = KinematicBody(None, name="back")
            start = [np.append(np.zeros(3), turn)]
        self.block = 1 if floor == "gel" else 0
        super().__init__(Scene(time=in_time(dt), **bodies), *start, **{**TIGHT, **config})

    def of_weight(self, forces: np.ndarray) -> np.ndarray:
        """Sum of nodal forces on the block over its weight: down the slope, across, up."""
        return self.frame @ forces[self.nodes(self.block)].sum(axis=0) / self.weight

    def creep(self, steps: int) -> np.ndarray:
        """Displacement in some steps [m]: down the slope, across, up."""
        start = self.x(self.block).mean(axis=0)
        self.steps(steps)
        return self.frame @ (self.x(self.block).mean(axis=0) - start)

    def acceleration(self, steps: int) -> float:
        """Down the slope [m/s^2]: places n steps apart differ twice by a (n dt)^2."""
        first, second = (self.creep(steps)[0] for _ in range(2))
        return float(second - first) / (steps * self.dt) ** 2


BLOCKS = ["affine", *Element]
FLOORS = ["plane", "box"]


@pytest.mark.thorough(cases=("quadratic-box",))
@pytest.mark.parametrize(
    ("block", "floor"), variants([("affine", "plane"), (Element.QUADRATIC, "box")], BLOCKS, FLOORS)
)
def test_it_sticks_just_below_the_friction_angle(block: str, floor: str) -> None:
    eps, part = 1e-6, 0.99
    slope = Slope(block, floor, part * MU, friction_speed_m_s=eps / 0.01)
    slope.steps(30)
    along, across, up = slope.creep(10)
    assert along == pytest.approx(10 * eps * (1 - np.sqrt(1 - part)), rel=1e-2)
    assert max(abs(across), abs(up)) < 0.01 * eps
    friction, normal = slope.of_weight(slope.friction()), slope.of_weight(slope.contact())
    assert friction[0] == pytest.approx(-slope.sin, rel=1e-3)
    assert normal[2] == pytest.approx(slope.cos, rel=1e-3)
    assert np.abs([*friction[1:], *normal[:2]]).max() < 1e-4


@pytest.mark.parametrize(
    ("block", "floor"), variants([("affine", "box"), (Element.LINEAR, "plane")], BLOCKS, FLOORS)
)
def test_it_slides_just_beyond_the_friction_angle(block: str, floor: str) -> None:
    slope = Slope(block, floor, 1.01 * MU)
    slope.steps(30)
    expected = G * (slope.sin - MU * slope.cos)
    assert slope.acceleration(10) == pytest.approx(expected, rel=1e-3)
    assert slope.of_weight(slope.friction())[0] == pytest.approx(-MU * slope.cos, rel=1e-4)


@pytest.mark.parametrize(
    ("block", "floor"),
    variants([("affine", "box"), ("linear", "plane")], ["affine", "linear"], FLOORS),
)
def test_the_wrench_balances_the_weight(block: str, floor: str) -> None:
    slope = Slope(block, floor, 0.75 * MU, relative_tolerance=1e-8, absolute_tolerance_n=1e-9)
    slope.steps(40)
    outputs = Outputs(slope.solver).update(slope.state)
    masses = slope.model.masses.numpy()[0] * slope.model.gravity_scale.numpy()
    centre = tuple(masses @ slope.x() / masses.sum())
    normal, friction = (
        read(centre).wrenches.numpy()[0]
        for read in (outputs.contact_wrenches, outputs.friction_wrenches)
    )
    expected = np.array([[0, 0, slope.cos], [-slope.sin, 0, 0]]) * slope.weight
    for found, force in zip((normal, friction), expected, strict=True):
        np.testing.assert_allclose(slope.frame @ found[0, 1, :3], force, atol=1e-6)
    # Torques balance about the centre of mass of the block.
    assert np.abs((normal + friction)[0, 1, 3:]).max() < 1e-6 * SIDE * 2
    np.testing.assert_allclose(normal[1, 0, :3], -normal[0, 1, :3], rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("block", variants(["affine"], BLOCKS))
def test_three_seconds_of_creep_with_default_settings(block: str) -> None:
    """150 frames: 0.15 mm are allowed, where creep by an unconverged solver can be millimetres."""
    usual = SolverConfig()
    names = ("relative_tolerance", "absolute_tolerance_n")
    slope = Slope(block, "plane", 0.5 * MU, 0.02, **{name: getattr(usual, name) for name in names})
    along, across, _ = slope.creep(150)
    allowed = usual.friction_speed_m_s * 150 * slope.dt
    assert along == pytest.approx((1 - np.sqrt(0.5)) * allowed, rel=0.1)
    assert abs(across) < 1e-2 * along


@pytest.mark.parametrize(
    ("speed", "dt"), variants([(1e-5, 2e-3), (1e-3, 2e-2)], [1e-5, 1e-3], [2e-3, 2e-2])
)
def test_creep_goes_by_time_whatever_the_step(dt: float, speed: float) -> None:
    slope = Slope("affine", "box", 0.8 * MU, dt=dt, friction_speed_m_s=speed)
    slope.steps(30)
    along, *_ = slope.creep(10)
    assert along == pytest.approx(10 * dt * speed * (1 - np.sqrt(1 - 0.8)), rel=1e-2)


class ShearedGel(Stepped):
    def __init__(self, **config: float) -> None:
        mesh = block_mesh((4, 4, 2), (8e-3, 8e-3, 2e-3))
        made = Scene(linear(mesh), KinematicBody(Ball(4e-3), 0.5))
        settings = {"dhat_m": DHAT, "relative_tolerance": 1e-5, "friction_eps_m": 2e-5}
        super().__init__(made, pose(0, 0, 4.1e-3), **settings, **config)

    def drag(self, x: float) -> float:
        self.step(pose(x, 0, 3.7e-3))
        return float(self.friction(0)[:, 0].sum())


def fail_whole_steps(solver: SolverIPC, monkeypatch: pytest.MonkeyPatch) -> None:
    attempt = solver._attempt

    def failing(who: np.ndarray, dt: float, whole: bool = False) -> StepReport:
        if not whole:
            return attempt(who, dt)
        solver.rows.read(device_mask(who, len(who), solver.model.device))
        before = solver.work.copy()
        report = attempt(who, dt)
        solver.work.restore(before, who)
        report.status[who] = EnvStatus.NO_CONVERGENCE
        report.substeps[who] = 0
        return report

    monkeypatch.setattr(solver, "_attempt", failing)


def test_halved_steps_of_a_press_creep_no_further(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a resting ball's friction lets go is the same when steps are taken in halves."""
    relaxed = []
    for halved in (False, True):
        gel = ShearedGel(friction_step_share=0.0)
        gel.drag(0)
        first = gel.drag(1e-4)
        if halved:
            fail_whole_steps(gel.solver, monkeypatch)
        relaxed.append(1 - [gel.drag(1e-4) for _ in range(4)][-1] / first)
    assert relaxed[0] > 0.05
    assert relaxed[1] == pytest.approx(relaxed[0], rel=0.1)


def test_what_a_resting_tool_shears_stays() -> None:
    gel = ShearedGel()
    gel.drag(0)
    first, *rests = (gel.drag(1e-4) for _ in range(11))
    assert rests[-1] == pytest.approx(first, rel=2e-3)


def test_static_ranges_are_a_part_of_the_longest_way() -> None:
    """Of two tools, by shift and turn, from where the step began even when it is taken again."""
    tools = [KinematicBody(Ball(4e-3), 0.5, name=name) for name in ("one", "other")]
    gel = linear(block_mesh((2, 2, 1), (8e-3, 8e-3, 2e-3)))
    first = pose(0, 0, 6e-3)
    run = Stepped(Scene(gel, tools), first, pose(0, 0, 16e-3), friction_eps_m=1e-5)

    def after(shift_m: float, angle: float, again: bool = False) -> float:
        run.step(first, pose(shift_m, 0, 16e-3, deg=np.degrees(angle)), again=again)
        return eps()

    def eps() -> float:
        assert run.solver.friction is not None
        return float(run.solver.friction.eps_u_m.numpy()[0])

    assert after(2e-4, 0.0) == pytest.approx(2e-6)
    assert after(3e-4, 0.02, again=True) == pytest.approx(0.01 * (3e-4 + 0.02 * 4e-3))
    assert after(3e-4, 0.02) == pytest.approx(1e-8), "nothing moves: a thousandth"
    assert after(3e-3, 0.0) == pytest.approx(1e-5), "never above friction_eps_m"
    run.attempt(Control(forces=np.zeros((1, run.model.node_count, 3))))
    assert eps() == 1e-5, "forces move things, too"


@pytest.mark.parametrize(
    ("quasi_static", "option", "says"),
    [
        (True, "friction_speed_m_s", "friction_eps_m"),
        (False, "friction_eps_m", "friction_speed_m_s"),
    ],
)
def test_the_other_range_is_refused(quasi_static: bool, option: str, says: str) -> None:
    gel = linear(block_mesh((1, 1, 1), (1e-3, 1e-3, 1e-3)))
    model = Scene(gel, time=TimeStepping(quasi_static=quasi_static)).finalize()
    with pytest.raises(InputError, match=f"{option} means nothing.*{says}"):
        SolverIPC(model, replace(SolverConfig(), **{option: 1e-4}))


@pytest.mark.thorough
def test_a_gel_holds_a_block() -> None:
    """Both move; what the gel's friction carries at rest is the block's weight along the slope."""
    slope = Slope("affine", "gel", 0.8 * MU)
    slope.steps(60)
    along, across, _ = slope.creep(10)
    assert 0 < along < 1.1 * 10 * slope.dt * slope.solver.config.friction_speed_m_s
    assert abs(across) < 0.1 * along
    # The gel's face is not exactly flat: its tangents lean with it.
    total = slope.of_weight(slope.friction() + slope.contact())
    np.testing.assert_allclose(total[[0, 2]], [-slope.sin, slope.cos], rtol=1e-3)
    assert slope.of_weight(slope.friction())[0] == pytest.approx(-slope.sin, rel=2e-2)


def test_a_gel_lets_a_block_go() -> None:
    """Over two millimetres, before the block's edge comes to the next row of the gel's nodes."""
    slope = Slope("affine", "gel", 1.25 * MU, dt=5e-3)
    slope.steps(6)
    expected = G * (slope.sin - MU * slope.cos)
    assert slope.acceleration(4) == pytest.approx(expected, rel=5e-3)


@pytest.mark.parametrize("tangent", variants([0.99 * MU], [0.99 * MU, 1.01 * MU]))
def test_tight_tolerances_are_met_where_energies_are_rounded(tangent: float) -> None:
    """The line search must not wait for a decrease that rounding hides."""
    slope = Slope("linear", "plane", tangent, relative_tolerance=1e-7, max_substep_halvings=0)
    for _ in range(30):
        assert slope.step().newton_iterations[0] < 60
