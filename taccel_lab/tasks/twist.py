# SPDX-License-Identifier: Apache-2.0
"""Press a ball on a gel, turn it about the normal, and tell by markers how far it turned.

The rim of the contact slips while its middle sticks, and the markers in the middle turn with the
ball. The estimate is a rigid turn fitted to the markers that went down most; it knows neither the
angle nor the closed form of torque and flow (``Torsion``):

Pressure is Hertz's; turning does not change it. Where friction would not hold, the rim of the
contact slips and a disc of radius c sticks [Lubkin 1951, J. Appl. Mech. 18:183; Johnson 1985,
Contact Mechanics, 7.4]. With the transform of torsion [Sneddon 1966, Mixed boundary value problems]

    u(r) = 1 / r int_0^min(r, a) t g(t) / sqrt(r^2 - t^2) dt,    torque = 4 pi G int_0^a t g(t) dt,

turning the disc gives g = 4 theta t / pi for t < c, and slip of traction q(r) on r > c gives
g = 2 t / (pi G) int_t^a q(r) / sqrt(r^2 - t^2) dr = (2 t q0 / (pi G)) (K(m) - E(m)) with
m = 1 - t^2 / a^2 for q = q0 sqrt(1 - r^2 / a^2). That g is continuous at c gives Lubkin's angle.
Nothing slips as friction grows: torque 16/3 G a^3 theta [Reissner and Sagoci 1944].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from taccel_lab.files.strict_model import Number, StrictModel
from taccel_lab.guards import require_positive, require_range
from taccel_lab.scene import Ball, KinematicBody, Scene, TimeStepping
from taccel_lab.signals.markers import MarkerLayout
from taccel_lab.solvers import Control
from taccel_lab.tasks.bodies import contact_config, pad_body, pad_mesh
from taccel_lab.tasks.draw import draw
from taccel_lab.tasks.episode import TaskEpisode
from taccel_lab.tasks.parameters import (
    Contact,
    Count,
    NotNegative,
    PadParameters,
    Positive,
    TaskParameters,
)

_POINTS = 200
"""Points of Gauss-Legendre quadrature."""


def contact_radius(force_n: float, ball_m: float, young_pa: float, poisson: float) -> float:
    """Hertz's radius of contact of a rigid ball [m]."""
    return (3 * force_n * ball_m * (1 - poisson**2) / (4 * young_pa)) ** (1 / 3)


@dataclass(frozen=True)
class Torsion:
    """A contact that is turned by an angle."""

    shear_modulus_pa: float
    contact_m: float
    """Radius of the contact."""
    force_n: float
    """It is pressed with."""
    friction: float
    angle_rad: float
    """Not negative."""

    def __post_init__(self) -> None:
        for name in ("shear_modulus_pa", "contact_m", "force_n", "friction"):
            require_positive(name, getattr(self, name))
        require_range("angle_rad", self.angle_rad, 0, np.inf)

    @property
    def limit_nm(self) -> float:
        """Torque at which all of it slips."""
        return 3 * np.pi / 16 * self.friction * self.force_n * self.contact_m

    @property
    def stuck_nm(self) -> float:
        """Torque if nothing slipped."""
        return 16 / 3 * self.shear_modulus_pa * self.contact_m**3 * self.angle_rad

    @cached_property
    def stuck_part(self) -> float:
        """Radius of the disc that sticks, as a part of the contact's."""
        from scipy.optimize import brentq

        a = self.contact_m
        scale = self.friction * self.force_n / (self.shear_modulus_pa * a**2) * 3 / (4 * np.pi)
        if self.angle_rad == 0:
            return 1.0
        wished = self.angle_rad / scale
        # K - E grows without bound as c goes to 0, as slowly as a logarithm.
        smallest = 1e-150
        if wished >= _slip(smallest):
            return 0.0
        return float(brentq(lambda c: _slip(c) - wished, smallest, 1.0))  # type: ignore[arg-type]

    @property
    def torque_nm(self) -> float:
        """Torque of the contact."""
        a, total = self.contact_m, 0.0
        for low, high in pairwise((0.0, self.stuck_part, 1.0)):
            t, weight = _gauss(a * low, a * high)
            total += float((weight * t * self._g(t)).sum())
        return 4 * np.pi * self.shear_modulus_pa * total

    def moved_m(self, radius_m: np.ndarray) -> np.ndarray:
        """How far points of the face at distances from the axis [n] go around it [m], [n]."""
        found = []
        for r in np.asarray(radius_m, dtype=np.float64):
            end = min(r, self.contact_m) / self.contact_m
            edges = sorted({0.0, min(self.stuck_part, end), end})
            total = 0.0
            for low, high in pairwise(edges):
                # t = r sin(phi) takes the root away.
                phi, weight = _gauss(
                    *np.arcsin(np.minimum(np.array([low, high]) * self.contact_m / r, 1))
                )
                t = r * np.sin(phi)
                total += float((weight * t * self._g(t)).sum())
            found.append(total / r if r > 0 else 0.0)
        return np.array(found)

    def _g(self, t: np.ndarray) -> np.ndarray:
        c = self.stuck_part * self.contact_m
        q0 = 1.5 * self.friction * self.force_n / (np.pi * self.contact_m**2)
        slipping = 2 * t * q0 / (np.pi * self.shear_modulus_pa) * _slip(t / self.contact_m)
        return np.where(t <= c, 4 * self.angle_rad * t / np.pi, slipping)


def _slip(part: float | np.ndarray) -> np.ndarray:
    """K(m) - E(m), m = 1 - part^2."""
    from scipy.special import ellipe, ellipkm1

    return ellipkm1(np.square(part)) - ellipe(1 - np.square(part))


def _gauss(low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    x, weight = _rule()
    return low + (high - low) * (x + 1) / 2, weight * (high - low) / 2


@cache
def _rule() -> tuple[np.ndarray, np.ndarray]:
    return np.polynomial.legendre.leggauss(_POINTS)


class TwistBall(StrictModel):
    """What is pressed and turned."""

    radius_mm: Positive
    friction: NotNegative


class TwistMarkers(StrictModel):
    """A square grid of markers about the middle of the gel's face, and which of them are read."""

    pitch_mm: Positive
    side_mm: Positive
    read_from: Annotated[Number, Field(gt=0, lt=1)]
    """Markers that went down by at least this part of the deepest one are fitted."""


class TwistStart(StrictModel):
    """What is drawn: half ranges of the ball's place and depth, and the range of the turn, of
    either sense."""

    x_mm: NotNegative
    y_mm: NotNegative
    depth_mm: NotNegative
    turn_deg: tuple[Positive, Positive]


class TwistPolicy(StrictModel):
    """The scripted motion."""

    gap_mm: Positive
    depth_mm: Positive
    """Depth of the ball below the face, in the middle of what is drawn."""
    press_steps: Count
    turn_steps: Count


class TwistGoal(StrictModel):
    """When it is done."""

    angle_deg: Positive
    """Largest error of the turn that the markers tell."""
    torque_part: Positive
    """Largest error of the torque, as a part of the closed form's."""


class TwistParameters(TaskParameters):
    """The file of a twist."""

    kind: Literal["twist"]
    ball: TwistBall
    gel: PadParameters
    markers: TwistMarkers
    contact: Contact
    start: TwistStart
    policy: TwistPolicy
    goal: TwistGoal


class Twist(TaskEpisode):
    """Twist of some seeds."""

    gel = "gel"

    def __init__(
        self, parameters: TwistParameters, seeds: Sequence[int], device: str | None = None
    ) -> None:
        self.parameters = parameters
        count, half, policy = len(seeds), parameters.start, parameters.policy
        ranges = {"x_mm": half.x_mm, "y_mm": half.y_mm, "depth_mm": half.depth_mm, "turn_deg": 1.0}
        starts = [draw(seed, ranges) for seed in seeds]
        least, most = half.turn_deg
        for start in starts:
            start["depth_mm"] += policy.depth_mm
            part = start["turn_deg"]
            start["turn_deg"] = float(np.copysign(least + (most - least) * abs(part), part))
        self._place = 1e-3 * np.array([[s["x_mm"], s["y_mm"]] for s in starts])
        self._depth = 1e-3 * np.array([s["depth_mm"] for s in starts])
        self._turn = np.radians([s["turn_deg"] for s in starts])
        gel = pad_body(parameters.gel, pad_mesh(parameters.gel))
        ball = Ball(1e-3 * parameters.ball.radius_mm)
        scene = Scene(
            gel,
            KinematicBody(ball, parameters.ball.friction, name="ball"),
            count,
            TimeStepping(True),
            pair_friction={("ball", gel.name): parameters.ball.friction},
        )
        config = contact_config(parameters.contact, parameters.dt_s)
        super().__init__(parameters, seeds, starts, scene, config, self._targets(0), device)
        ticks = np.arange(0.0, parameters.markers.side_mm + 1e-9, parameters.markers.pitch_mm)
        ticks -= ticks.mean()
        self._layout = MarkerLayout.from_points(
            gel.nodal_mesh, np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)
        )
        self._first = self.markers_m()
        self._pressed = self._first.copy()
        self._last = self._first.copy()
        self._force = np.zeros((count, 3))
        self._torque = np.zeros(count)
        """Torque of the ball on the gel about its axis [N m]."""

    def _targets(self, step: int) -> np.ndarray:
        policy = self.parameters.policy
        down = min(step / policy.press_steps, 1.0)
        turned = np.clip((step - policy.press_steps) / policy.turn_steps, 0.0, 1.0) * self._turn
        gap = 1e-3 * policy.gap_mm
        pose = np.zeros((len(turned), 1, 7))
        pose[:, 0, :2] = self._place
        pose[:, 0, 2] = 1e-3 * self.parameters.ball.radius_mm + gap - down * (gap + self._depth)
        pose[:, 0, 5], pose[:, 0, 6] = np.sin(turned / 2), np.cos(turned / 2)
        return pose

    def markers_m(self) -> np.ndarray:
        """Where the markers are [m], [env, marker, 3]."""
        nodes = self.state.positions.numpy()[:, self._layout.nodes]
        return (nodes * self._layout.weights[..., None]).sum(axis=2)

    def control(self) -> Control:
        return Control(target_poses=self._targets(self.taken + 1))

    def measure(self) -> None:
        run = self.running
        markers = self.markers_m()
        self._last[run] = markers[run]
        if self.taken <= self.parameters.policy.press_steps:
            self._pressed[run] = markers[run]
        i, j = self.model.body_id("gel"), self.model.body_id("ball")
        wrench = self.outputs.contact_wrenches().wrenches.numpy()[:, i, j].copy()
        wrench += self.outputs.friction_wrenches().wrenches.numpy()[:, i, j]
        self._force[run] = wrench[run, :3]
        x, y = self._place.T
        torque = wrench[:, 5] - (x * wrench[:, 1] - y * wrench[:, 0])
        self._torque[run] = torque[run]

    def torsion(self, env: int) -> Torsion:
        """The closed form at the force that was measured."""
        gel, ball = self.parameters.gel, self.parameters.ball
        force, nu = -float(self._force[env, 2]), gel.poisson_ratio
        radius = contact_radius(force, 1e-3 * ball.radius_mm, gel.young_modulus_pa, nu)
        shear = gel.young_modulus_pa / (2 * (1 + nu))
        return Torsion(shear, radius, force, ball.friction, abs(float(self._turn[env])))

    def measured_turn(self, env: int) -> float:
        """Turn that the markers tell [rad]: the rigid one nearest to their motion since the press
        [Kabsch 1976], in the plane."""
        before, after = self._pressed[env, :, :2], self._last[env, :, :2]
        sunk = self._first[env, :, 2] - self._pressed[env, :, 2]
        read = sunk >= self.parameters.markers.read_from * sunk.max()
        a = before[read] - before[read].mean(axis=0)
        b = after[read] - after[read].mean(axis=0)
        cross = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum()
        return float(np.arctan2(cross, (a * b).sum()))

    def flow(self, env: int) -> tuple[np.ndarray, np.ndarray]:
        """Distance of each marker from the ball's axis after the press [m], and how far it went
        around it since, in the sense of the turn [m], [marker] each."""
        arm = self._pressed[env, :, :2] - self._place[env]
        moved = self._last[env, :, :2] - self._place[env]
        r = np.linalg.norm(arm, axis=1)
        angle = np.arctan2(arm[:, 0] * moved[:, 1] - arm[:, 1] * moved[:, 0], (arm * moved).sum(1))
        return r, np.copysign(1.0, self._turn[env]) * angle * r

    def judge(self, env: int) -> tuple[str, dict[str, float]]:
        measured, turn = self.measured_turn(env), float(self._turn[env])
        if not -self._force[env, 2] > 0:
            return "the ball did not touch the gel", {
                "angle_error_deg": np.degrees(measured - turn)
            }
        closed = self.torsion(env)
        r, moved = self.flow(env)
        expected = closed.moved_m(r)
        torque = float(np.copysign(1.0, turn) * self._torque[env])
        figures = {
            "angle_error_deg": np.degrees(measured - turn),
            "torque_mnm": 1e3 * torque,
            "torque_of_closed_form": torque / closed.torque_nm,
            "flow_error": np.sqrt(np.mean((moved - expected) ** 2)) / expected.max(),
            "stuck_part": closed.stuck_part,
            "contact_mm": 1e3 * closed.contact_m,
            "force_n": closed.force_n,
        }
        goal = self.parameters.goal
        if self.taken < self.parameters.policy.press_steps + self.parameters.policy.turn_steps:
            return "the ball had not gone its way", figures
        if not abs(figures["angle_error_deg"]) <= goal.angle_deg:
            return f"markers missed the turn by {figures['angle_error_deg']:.2f} degrees", figures
        if not abs(figures["torque_of_closed_form"] - 1) <= goal.torque_part:
            return f"torque is {figures['torque_of_closed_form']:.2f} of the closed form", figures
        return "", figures

    def forces(self) -> dict[str, float]:
        return {"pressing": float(-self._force[0, 2])}
