# SPDX-License-Identifier: Apache-2.0
"""A block on an inclined floor under gravity that points down, for all kinds of blocks and floors.

It sticks if and only if tan(angle) <= mu. Below that it creeps: friction is mu N (2 y - y^2) at
sliding of y eps a step, hence at y = 1 - sqrt(1 - tan / mu), never faster than eps_v = eps / dt.
Beyond it slides at g (sin - mu cos). (``test_affine`` leans gravity instead.)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

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
from taccel_lab.state import initial_state
from tests.support.blocks import block_mesh, everywhere, free_block, pose
from tests.support.variants import variants

G, SIDE, DENSITY, MU = 9.81, 2e-2, 1000.0, 0.4
MASS = DENSITY * SIDE**3
DHAT = 2e-5
TIGHT = {"dhat_m": DHAT, "relative_tolerance": 1e-5, "absolute_tolerance_n": 1e-10}
AZIMUTH = 0.5
"""Direction of the slope [rad]: along no edge of the block or of the floor."""


class Slope:
    """A block of 8 g at rest, half of dhat above a floor whose tangent is ``tangent``."""

    def __init__(
        self, block: str, floor: str, tangent: float, dt: float = 0.01, **config: float
    ) -> None:
        angle = float(np.arctan(tangent))
        self.down = np.array([np.cos(AZIMUTH), np.sin(AZIMUTH), 0]) * np.cos(angle)
        self.down[2] = -np.sin(angle)
        """Unit vector down the slope."""
        axis = np.array([-np.sin(AZIMUTH), np.cos(AZIMUTH), 0])
        turn = np.append(axis * np.sin(angle / 2), np.cos(angle / 2))
        self.normal = np.cross(self.down, axis)
        self.frame = np.stack([self.down, np.cross(self.normal, self.down), self.normal])
        """Rows: down the slope, across, up."""
        self.weight, self.dt = MASS * G, dt
        self.sin, self.cos = np.sin(angle), np.cos(angle)
        placed = np.append((SIDE / 2 + 0.5 * DHAT) * self.normal, turn)
        bodies: dict = {}
        if block == "affine":
            bodies["affine_bodies"] = AffineBody(
                box_mesh((SIDE, SIDE, SIDE)), DENSITY, initial_pose=placed
            )
        else:
            mesh = free_block((2, 2, 2), SIDE)
            # The mesh has its origin in its upper face.
            placed[:3] += SIDE / 2 * self.normal
            bodies["soft_bodies"] = SoftBody(
                mesh, Material(1e6, 0.3, DENSITY), initial_pose=placed, element=Element(block)
            )
        poses = np.zeros((1, 0, 7))
        if floor == "plane":
            up = (float(self.normal[0]), float(self.normal[1]), float(self.normal[2]))
            bodies["planes"] = Plane(normal=up, friction_coefficient=MU)
        elif floor == "box":
            bodies["kinematic_bodies"] = KinematicBody(box_mesh((0.2, 0.2, 0.02)), MU)
            poses = everywhere(1, np.append(-0.01 * self.normal, turn))
        else:
            # A gel glued to a tilted back plate.
            mesh = block_mesh((8, 8, 2), (2 * SIDE, 2 * SIDE, SIDE / 2))
            bodies["soft_bodies"] = SoftBody(
                mesh,
                Material(2e5, 0.45, DENSITY),
                friction_coefficient=MU,
                mount="back",
                element=Element.LINEAR,
            )
            bodies["kinematic_bodies"] = KinematicBody(None, name="back")
            poses = everywhere(1, np.append(np.zeros(3), turn))
        stepping = TimeStepping(quasi_static=False, dt_s=dt, gravity_m_s2=(0, 0, -G))
        self.model = Scene(time=stepping, **bodies).finalize()
        self.block = 1 if floor == "gel" else 0
        self.solver = SolverIPC(self.model, SolverConfig(**{**TIGHT, **config}))  # type: ignore[arg-type]
        self.state = initial_state(self.model, poses)

    def run(self, steps: int) -> None:
        for _ in range(steps):
            report = self.solver.step(self.state)
            assert report.converged.all(), report.summary()

    def _on_block(self, values: np.ndarray) -> np.ndarray:
        return values[0, self.model.bodies[self.block].node_slice]

    @property
    def place(self) -> np.ndarray:
        """Middle of the block's vertices [m], shape [3]."""
        return self._on_block(self.state.positions.numpy()).mean(axis=0)

    def force(self, which: str) -> np.ndarray:
        """Contact or friction force on the block over its weight: down the slope, across, up."""
        gradient = getattr(self.solver, f"{which}_gradient").numpy()
        total = -self._on_block(gradient).sum(axis=0) / self.weight
        return self.frame @ total

    def creep(self, steps: int) -> np.ndarray:
        """Displacement in so many steps [m]: down the slope, across, up."""
        start = self.place
        self.run(steps)
        return self.frame @ (self.place - start)

    def acceleration(self, steps: int) -> float:
        """Down the slope [m/s^2]. Positions of implicit Euler n steps apart differ twice by
        a (n dt)^2."""
        places = [self.place]
        for _ in range(2):
            self.run(steps)
            places.append(self.place)
        return float(self.down @ np.diff(places, n=2, axis=0)[0]) / (steps * self.dt) ** 2


def fail_whole_steps(solver: SolverIPC, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let every step fail that is as long as the scene's, so that its halves are taken."""
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


BLOCKS = ["affine", *Element]
FLOORS = ["plane", "box"]


@pytest.mark.thorough(cases=("quadratic-box",))
@pytest.mark.parametrize(
    ("block", "floor"), variants([("affine", "plane"), (Element.QUADRATIC, "box")], BLOCKS, FLOORS)
)
def test_it_sticks_just_below_the_friction_angle(block: str, floor: str) -> None:
    eps, part = 1e-6, 0.99
    slope = Slope(block, floor, part * MU, friction_speed_m_s=eps / 0.01)
    slope.run(30)
    along, across, up = slope.creep(10)
    assert along < 1.1 * 10 * eps
    assert along == pytest.approx(10 * eps * (1 - np.sqrt(1 - part)), rel=1e-2)
    assert max(abs(across), abs(up)) < 0.01 * eps
    friction, normal = slope.force("friction"), slope.force("contact")
    assert friction[0] == pytest.approx(-slope.sin, rel=1e-3)
    assert normal[2] == pytest.approx(slope.cos, rel=1e-3)
    assert np.abs([*friction[1:], *normal[:2]]).max() < 1e-4


@pytest.mark.parametrize(
    ("block", "floor"), variants([("affine", "box"), (Element.LINEAR, "plane")], BLOCKS, FLOORS)
)
def test_it_slides_just_beyond_the_friction_angle(block: str, floor: str) -> None:
    slope = Slope(block, floor, 1.01 * MU)
    slope.run(30)
    found = slope.acceleration(10)
    assert found == pytest.approx(G * (slope.sin - MU * slope.cos), rel=1e-3)
    assert slope.force("friction")[0] == pytest.approx(-MU * slope.cos, rel=1e-4)


@pytest.mark.parametrize(
    ("block", "floor"),
    variants([("affine", "box"), ("linear", "plane")], ["affine", "linear"], FLOORS),
)
def test_the_wrench_balances_the_weight(block: str, floor: str) -> None:
    """Between block and floor, to a micronewton."""
    slope = Slope(block, floor, 0.75 * MU, relative_tolerance=1e-8, absolute_tolerance_n=1e-9)
    slope.run(40)
    outputs = Outputs(slope.solver).update(slope.state)
    x = slope.state.positions.numpy()[0]
    masses = slope.model.masses.numpy()[0] * slope.model.gravity_scale.numpy()
    centre = tuple(masses @ x / masses.sum())
    normal, friction = (
        read(centre).wrenches.numpy()[0]
        for read in (outputs.contact_wrenches, outputs.friction_wrenches)
    )
    force = [slope.frame @ part[0, 1, :3] / slope.weight for part in (normal, friction)]
    np.testing.assert_allclose(force[0], [0, 0, slope.cos], atol=1e-6 / slope.weight)
    np.testing.assert_allclose(force[1], [-slope.sin, 0, 0], atol=1e-6 / slope.weight)
    # Torques balance about the centre of mass of the block.
    assert np.abs((normal + friction)[0, 1, 3:]).max() < 1e-6 * SIDE * 2
    np.testing.assert_allclose(normal[1, 0, :3], -normal[0, 1, :3], rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("block", variants(["affine"], BLOCKS))
def test_three_seconds_of_creep_with_default_settings(block: str) -> None:
    """150 frames: 0.15 mm are allowed, where creep by an unconverged solver can be millimetres."""
    defaults = SolverConfig()
    slope = Slope(
        block,
        "plane",
        0.5 * MU,
        dt=0.02,
        relative_tolerance=defaults.relative_tolerance,
        absolute_tolerance_n=defaults.absolute_tolerance_n,
    )
    speed = defaults.friction_speed_m_s
    along, across, _ = slope.creep(150)
    assert 0 < along < 1.1 * speed * 150 * slope.dt
    assert along == pytest.approx((1 - np.sqrt(0.5)) * speed * 150 * slope.dt, rel=0.1)
    assert abs(across) < 1e-2 * along


@pytest.mark.parametrize(
    ("speed", "dt"), variants([(1e-5, 2e-3), (1e-3, 2e-2)], [1e-5, 1e-3], [2e-3, 2e-2])
)
def test_creep_goes_by_time_whatever_the_step(dt: float, speed: float) -> None:
    slope = Slope("affine", "box", 0.8 * MU, dt=dt, friction_speed_m_s=speed)
    slope.run(30)
    along, *_ = slope.creep(10)
    assert along == pytest.approx(10 * dt * speed * (1 - np.sqrt(1 - 0.8)), rel=1e-2)


def sheared_gel(**config: float) -> tuple[SolverIPC, Callable[[float, float], float]]:
    """A gel below a ball; what brings the ball to x, z [m] in one step, and gives its friction."""
    mesh = block_mesh((4, 4, 2), (8e-3, 8e-3, 2e-3))
    ball = KinematicBody(Ball(4e-3), 0.5)
    settings = SolverConfig(dhat_m=DHAT, relative_tolerance=1e-5, **config)  # type: ignore[arg-type]
    model = Scene(SoftBody(mesh, Material(1e5, 0.4), element=Element.LINEAR), ball).finalize()
    solver = SolverIPC(model, settings)
    state = initial_state(model, everywhere(1, pose(0, 0, 4.1e-3)))

    def force(x: float, z: float) -> float:
        report = solver.step(state, everywhere(1, pose(x, 0, z)))
        assert report.converged.all(), report.summary()
        return float(-solver.friction_gradient.numpy()[0, : model.soft_count, 0].sum())

    return solver, force


def test_halved_steps_of_a_press_creep_no_further(monkeypatch: pytest.MonkeyPatch) -> None:
    """A gel sheared by a ball that then rests: what its friction lets go in so many steps is the
    same when they are taken in halves. The range is large, so that there is much to let go."""
    relaxed = []
    for halved in (False, True):
        solver, force = sheared_gel(friction_eps_m=2e-5, friction_step_share=0.0)
        force(0, 3.7e-3)
        first = force(1e-4, 3.7e-3)
        if halved:
            fail_whole_steps(solver, monkeypatch)
        relaxed.append(1 - [force(1e-4, 3.7e-3) for _ in range(4)][-1] / first)
    assert relaxed[0] > 0.05
    assert relaxed[1] == pytest.approx(relaxed[0], rel=0.1)


def test_what_a_resting_tool_shears_stays() -> None:
    """By default the range is a part of the tools' way: next to nothing where they rest."""
    _, force = sheared_gel(friction_eps_m=2e-5)
    force(0, 3.7e-3)
    first = force(1e-4, 3.7e-3)
    rests = [force(1e-4, 3.7e-3) for _ in range(10)]
    assert rests[-1] == pytest.approx(first, rel=2e-3)


def test_static_ranges_are_a_part_of_the_longest_way() -> None:
    """Of two tools, by shift and turn, from where the step began even when it is taken again."""
    mesh = block_mesh((2, 2, 1), (8e-3, 8e-3, 2e-3))
    tools = [KinematicBody(Ball(4e-3), 0.5, name=name) for name in ("one", "other")]
    model = Scene(SoftBody(mesh, Material(1e5, 0.4), element=Element.LINEAR), tools).finalize()
    solver = SolverIPC(model, SolverConfig(friction_eps_m=1e-5))
    poses = np.stack([pose(0, 0, 6e-3), pose(0, 0, 16e-3)])[None]
    state = initial_state(model, poses)
    assert solver.friction is not None

    def after(shift_m: float, angle: float, again: bool = False) -> float:
        """Range of a step of the second tool from where it is at first [m]."""
        target = poses.copy()
        target[0, 1, 0] += shift_m
        target[0, 1, 3:] = 0, 0, np.sin(angle / 2), np.cos(angle / 2)
        assert solver.step(state, Control(target), again=again).converged.all()
        assert solver.friction is not None
        return float(solver.friction.eps_u_m.numpy()[0])

    assert after(2e-4, 0.0) == pytest.approx(2e-6)
    assert after(3e-4, 0.02, again=True) == pytest.approx(0.01 * (3e-4 + 0.02 * 4e-3))
    assert after(3e-4, 0.02) == pytest.approx(1e-8), "nothing moves: a thousandth"
    assert after(3e-3, 0.0) == pytest.approx(1e-5), "never above friction_eps_m"
    pushed = np.zeros((1, model.node_count, 3))
    solver.step(state, Control(forces=pushed))
    assert float(solver.friction.eps_u_m.numpy()[0]) == 1e-5, "forces move things, too"


@pytest.mark.parametrize(
    ("quasi_static", "option", "says"),
    [
        (True, "friction_speed_m_s", "friction_eps_m"),
        (False, "friction_eps_m", "friction_speed_m_s"),
    ],
)
def test_the_range_of_the_other_kind_of_scene_is_refused(
    quasi_static: bool, option: str, says: str
) -> None:
    mesh = block_mesh((1, 1, 1), (1e-3, 1e-3, 1e-3))
    time = TimeStepping(quasi_static=quasi_static)
    model = Scene(SoftBody(mesh, Material(1e5, 0.3), element=Element.LINEAR), time=time).finalize()
    with pytest.raises(InputError, match=f"{option} means nothing.*{says}"):
        SolverIPC(model, replace(SolverConfig(), **{option: 1e-4}))


@pytest.mark.thorough
def test_a_gel_holds_a_block() -> None:
    """Both move; what the gel's friction carries at rest is the block's weight along the slope."""
    slope = Slope("affine", "gel", 0.8 * MU)
    slope.run(60)
    along, across, _ = slope.creep(10)
    assert 0 < along < 1.1 * 10 * slope.dt * slope.solver.config.friction_speed_m_s
    assert abs(across) < 0.1 * along
    # The gel's face is not exactly flat: its tangents lean with it.
    total = slope.force("friction") + slope.force("contact")
    assert total[0] == pytest.approx(-slope.sin, rel=1e-3)
    assert total[2] == pytest.approx(slope.cos, rel=1e-3)
    assert slope.force("friction")[0] == pytest.approx(-slope.sin, rel=2e-2)


def test_a_gel_lets_a_block_go() -> None:
    """Over two millimetres, before the block's edge comes to the next row of the gel's nodes."""
    slope = Slope("affine", "gel", 1.25 * MU, dt=5e-3)
    slope.run(6)
    found = slope.acceleration(4)
    assert found == pytest.approx(G * (slope.sin - MU * slope.cos), rel=5e-3)


@pytest.mark.parametrize("tangent", variants([0.99 * MU], [0.99 * MU, 1.01 * MU]))
def test_tight_tolerances_are_met_where_energies_are_rounded(tangent: float) -> None:
    """A turned block's elastic energy is a small difference of terms of 3 J: the line search must
    not wait for a decrease that rounding hides (it used up all iterations)."""
    slope = Slope("linear", "plane", tangent, relative_tolerance=1e-7, max_substep_halvings=0)
    for _ in range(30):
        report = slope.solver.step(slope.state)
        assert report.converged.all(), report.summary()
        assert report.newton_iterations[0] < 60
