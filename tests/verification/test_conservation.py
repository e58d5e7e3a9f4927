# SPDX-License-Identifier: Apache-2.0
"""Order of the time schemes, and what they conserve: momentum, the balance of torques, energy.

Inner forces have no resultant and no torque at the positions where they are evaluated, the end of
the step. Linear momentum is therefore kept exactly. Angular momentum is not: by the end of the step
the lever arms have turned by dt w, so that implicit Euler changes it by -dt^2 sum v x f a step, in
total by a part that falls in proportion to dt, and BDF2 by one that falls faster.

Under BDF2 an impact never gives energy, which it carries on in a part of the last change of
velocity: without a hand-over to implicit Euler a soft cube that falls by two of its sides gained
83 % of m g h in one step, a stiff one 65 %.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from taccel_lab.geometry.block import free_block
from taccel_lab.outputs import Outputs
from taccel_lab.scene import (
    AffineBody,
    Element,
    Material,
    Plane,
    Scene,
    SoftBody,
    TimeScheme,
    box_mesh,
)
from tests.support.blocks import block_mesh, pose
from tests.support.scene_steps import G, Stepped, in_time, linear
from tests.support.variants import variants

SIDE = 4e-2
SOFT = Material(1e4, 0.4)
MESH = free_block((2, 2, 2), SIDE, jitter=0.15)
EULER, BDF2 = TimeScheme.EULER, TimeScheme.BDF2


class Free(Stepped):
    """A scene without outer forces, and its history of momenta and energies."""

    def __init__(self, scene: Scene, **config: float) -> None:
        super().__init__(scene, absolute_tolerance_n=1e-9, **config)
        self.outputs = Outputs(self.solver)
        self.linear: list[np.ndarray] = []
        self.angular: list[np.ndarray] = []
        self.torque: list[np.ndarray] = []
        """sum x_{n+1} x m (v_{n+1} - v_n): momentum that inner forces bring in by their torque."""
        self.energy: list[float] = []
        self.touched = 0

    def record(self) -> None:
        momentum = self.outputs.update(self.state).momentum()
        self.linear.append(momentum.linear.numpy()[0].sum(axis=0))
        self.angular.append(momentum.angular.numpy()[0].sum(axis=0))
        self.energy.append(float(sum(e[0] for e in self.outputs.energies.values())))

    def run(self, steps: int) -> None:
        self.record()
        reader = self.outputs._momentum
        for _ in range(steps):
            before = self.state.copy()
            self.touched += int(np.isfinite(self.step().min_distance_m[0]))
            self.record()
            # The same lever arms for both velocities: only forces remain.
            now, then = (
                reader.read(self.state.positions, velocities).angular.numpy()[0].sum(axis=0)
                for velocities in (self.state.velocities, before.velocities)
            )
            self.torque.append(now - then)

    def drift(self, name: str) -> float:
        values = np.array(getattr(self, name))
        return float(np.abs(values - values[0]).max() / np.linalg.norm(values[0]))

    def check(self, scheme: TimeScheme, within: float) -> None:
        """Linear momentum is kept; implicit Euler has no torque and only loses energy."""
        assert self.drift("linear") < within
        if scheme is EULER:
            assert np.abs(self.torque).max() < within * np.linalg.norm(self.angular[0])
            assert np.diff(self.energy).max() <= 0


def block(
    scheme: TimeScheme, dt: float, stretch: float, spin: float, element: Element = Element.LINEAR
) -> Free:
    free = Free(Scene(SoftBody(MESH, SOFT, element=element), time=in_time(dt, 0, scheme=scheme)))
    x = free.state.positions.numpy().copy()
    centre = x.mean(axis=1, keepdims=True)
    free.state.positions.assign(centre + (x - centre) * [1 + stretch, 1 - stretch / 2, 1])
    spinning = np.cross([0.3 * spin, 0, spin], x - centre)
    free.state.velocities.assign(spinning + [0.5, 0.0, -0.2])
    return free


@pytest.mark.thorough
@pytest.mark.parametrize(("scheme", "order", "fewest"), [(EULER, 1, 32), (BDF2, 2, 16)])
def test_measured_order_of_a_free_oscillation(scheme: TimeScheme, order: int, fewest: int) -> None:
    ends = []
    for steps in (fewest * 2**k for k in range(4)):
        free = block(scheme, 5e-3 / steps, 0.05, 0.0)
        free.run(steps)
        ends.append(free.x())
    # Differences of neighbours fall as the error does, and need no reference.
    changes = [np.linalg.norm(a - b) for a, b in pairwise(ends)]
    slopes = np.log2(np.array(changes[:-1]) / np.array(changes[1:]))
    np.testing.assert_allclose(slopes, order, atol=0.1)


@pytest.mark.parametrize(
    ("scheme", "element"),
    variants([(EULER, Element.LINEAR), (BDF2, Element.QUADRATIC)], TimeScheme, Element),
)
def test_a_free_body_keeps_its_momentum(scheme: TimeScheme, element: Element) -> None:
    free = block(scheme, 1e-3, 0.05, 20.0, element)
    free.run(8)
    free.check(scheme, 1e-10)
    # It is not an empty statement: the body deforms and its angular momentum does change.
    assert free.drift("angular") > 1e-4
    assert free.energy[-1] < 0.995 * free.energy[0]


@pytest.mark.parametrize(
    ("scheme", "element"),
    variants([(EULER, Element.QUADRATIC), (BDF2, Element.LINEAR)], TimeScheme, Element),
)
def test_a_body_and_the_gel_on_it_keep_their_momentum(scheme: TimeScheme, element: Element) -> None:
    """They pull at one another; what one gains the other loses. The gel is let go sheared."""
    body = AffineBody(
        box_mesh((SIDE, SIDE / 2, SIDE / 4)),
        name="body",
        density_kg_m3=300.0,
        initial_velocity_m_s=(0.5, 0.0, -0.2),
        initial_spin_rad_s=(6.0, 0.0, 20.0),
    )
    mesh = block_mesh((3, 2, 2), (SIDE / 2, SIDE / 4, SIDE / 4), jitter=0.15)
    place = pose(0, 0, 3 * SIDE / 8, (0, 0, 1), 30.0)
    gel = SoftBody(mesh, SOFT, mount="body", mount_pose=place, element=element)
    free = Free(Scene(gel, affine_bodies=body, time=in_time(1e-3, 0, scheme=scheme)))
    x = free.state.positions.numpy().copy()
    nodes = free.nodes(0)
    height = x[:, nodes, 2:] - x[:, nodes, 2:].min()
    x[:, nodes] += 0.1 * height * [1.0, 0.5, 0.0]
    free.state.positions.assign(x)
    free.run(8)
    free.check(scheme, 1e-9)
    momenta = free.outputs.momentum().linear.numpy()[0]
    assert np.linalg.norm(momenta[0]) > 0.1 * np.linalg.norm(momenta[1])
    of_gel = free.state.velocities.numpy()[0, nodes]
    assert np.linalg.norm(of_gel - of_gel.mean(axis=0), axis=1).max() > 0.1, "the gel swings"


@pytest.mark.thorough
def test_how_angular_momentum_is_lost() -> None:
    """By 2.6 % in 30 steps of a quarter turn, 1.4 % in 60; BDF2 by 0.1 % and 0.03 %."""
    duration = np.pi / 2 / np.hypot(20.0, 6.0)

    def loss(scheme: TimeScheme, steps: int) -> float:
        free = block(scheme, duration / steps, 0.0, 20.0)
        free.run(steps)
        return float(1 - np.linalg.norm(free.angular[-1]) / np.linalg.norm(free.angular[0]))

    euler, bdf2 = (np.array([loss(scheme, n) for n in (30, 60)]) for scheme in (EULER, BDF2))
    assert np.log2(euler[0] / euler[1]) == pytest.approx(1, abs=0.15)
    assert euler[1] == pytest.approx(0.014, rel=0.1)
    assert (np.abs(bdf2) < 0.05 * euler).all()


@pytest.mark.parametrize("soft", [True, False])
def test_a_collision_keeps_momentum_and_gains_no_energy(soft: bool) -> None:
    """A block flies off-centre into another block, or into a stiff cube."""
    place = pose(0.3 * SIDE, 0.1 * SIDE, 2e-4 + 0.5 * SIDE, (0, 0, 1), 15.0)
    bodies: dict[str, Any] = {
        "soft_bodies": [linear(MESH, SOFT, initial_velocity_m_s=(0.1, 0, 0.5))]
    }
    if soft:
        # The mesh hangs below its frame's origin.
        place[2] += 0.5 * SIDE
        bodies["soft_bodies"] += [linear(MESH, SOFT, name="other", initial_pose=place)]
    else:
        bodies["affine_bodies"] = AffineBody(box_mesh((SIDE,) * 3), initial_pose=place)
    free = Free(Scene(time=in_time(1e-3, 0), **bodies), dhat_m=1e-4, relative_tolerance=1e-12)
    free.run(12)
    assert free.touched >= 5
    scale = np.linalg.norm(free.linear[0])
    assert np.abs(np.diff(free.linear, axis=0)).max() < 1e-10 * scale
    momenta = free.outputs.momentum().linear.numpy()[0]
    assert np.linalg.norm(momenta[1]) > 0.1 * scale, "the second body was hit"
    assert np.abs(free.torque).max() < 1e-9 * scale * SIDE
    assert np.diff(free.energy).max() < 1e-9 * free.energy[0]


EDGE, HEIGHT = 5e-3, 1e-2


class Fall(Stepped):
    """A cube that falls on a floor by BDF2; energies over m g h."""

    def __init__(self, kind: str, tilt_deg: float, dt: float, young_pa: float = 2e5) -> None:
        rise = {"affine": 0.9, "linear": 1.5, "quadratic": 1.5}[kind] * EDGE
        place = pose(0, 0, HEIGHT + rise, (1, 1, 0), tilt_deg)
        bodies: dict[str, Any] = {"planes": Plane(), "time": in_time(dt, scheme=BDF2)}
        if kind == "affine":
            bodies["affine_bodies"] = AffineBody(box_mesh((EDGE,) * 3), initial_pose=place)
        else:
            mesh, gel = free_block((2, 2, 2), EDGE), Material(young_pa, 0.3)
            soft = SoftBody(mesh, gel, initial_pose=place, element=Element(kind))
            bodies["soft_bodies"] = soft
        super().__init__(Scene(**bodies), dhat_m=5e-5)
        self.free = self.model.free_nodes.numpy()
        self.masses = self.model.masses.numpy()[0, self.free]
        self.weights = G * self.masses * self.model.gravity_scale.numpy()[self.free]

    def energy(self) -> float:
        s, state = self.solver, self.state
        s.active.fill_(1)
        speeds_sq = (state.velocities.numpy()[0, self.free] ** 2).sum(axis=-1)
        total = 0.5 * speeds_sq @ self.masses + self.x()[self.free, 2] @ self.weights
        for part in [*s.elastic, *([s.affine] if s.affine else []), s.contact]:
            total += part.energy(s.active, state.positions)[0]
        return total / (self.weights.sum() * HEIGHT)

    def run(self, seconds: float) -> np.ndarray:
        found, touched = [self.energy()], False
        for _ in range(round(seconds / self.model.scene.time.dt_s)):
            touched |= bool(self.step().contact_force_n[0] > 0)
            found.append(self.energy())
        assert touched
        return np.array(found)


@pytest.mark.parametrize(
    ("kind", "tilt", "dt"),
    variants(
        [("affine", 25.0, 2e-3), ("linear", 0.0, 5e-3), ("quadratic", 25.0, 5e-3)],
        ["affine", "linear", "quadratic"],
        [0.0, 25.0],
        [5e-3, 2e-3, 5e-4],
    ),
)
def test_no_step_of_an_impact_gives_energy(kind: str, tilt: float, dt: float) -> None:
    energies = Fall(kind, tilt, dt).run(0.1 if dt > 1e-3 else 0.06)
    # In free flight the energy of a body that vibrates goes up and down with BDF2, by 4e-4 here.
    assert np.diff(energies).max() < 5e-4
    assert energies[-1] < energies[0]


@pytest.mark.thorough(cases=("200000.0-0.0002",))
@pytest.mark.parametrize(("young_pa", "dt"), [(2e4, 1e-3), (2e5, 2e-4)])
def test_nor_does_one_of_a_long_contact(young_pa: float, dt: float) -> None:
    """A soft cube of ten-node tets gained 0.8 and 0.9 % of m g h in one step."""
    assert np.diff(Fall("quadratic", 25.0, dt, young_pa).run(0.07)).max() < 5e-4


def test_flight_stays_of_second_order() -> None:
    fall = Fall("affine", 25.0, 2e-3)
    centre = fall.model.affine.first_control
    start = fall.x()[centre, 2]
    for t in 2e-3 * np.arange(1, 16):
        fall.step()
        # The first step is one of implicit Euler: half a step's worth of speed, once.
        expected = pytest.approx(0.5 * G * t**2, abs=G * 2e-3**2 * 1.01)
        assert start - fall.x()[centre, 2] == expected
