# SPDX-License-Identifier: Apache-2.0
"""Throw a body up between two gels, let go of it, and catch it on its way down.

The hand carries the body up and opens while it is as fast as it gets, brakes and stays. The body
flies out of the hand and falls back. The policy closes when it expects the body back from the
throw that it meant; the throw that it makes is a little faster or slower, and it closes early or
late.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from taccel_lab.files.strict_model import StrictModel
from taccel_lab.robots.transforms import pose_of
from taccel_lab.scene import Scene, TimeScheme, TimeStepping
from taccel_lab.solvers import Control
from taccel_lab.tasks.bodies import SIDES, G, contact_config, gels_of, mounts_of
from taccel_lab.tasks.draw import draw
from taccel_lab.tasks.episode import TaskEpisode
from taccel_lab.tasks.grasp_lift import Object
from taccel_lab.tasks.parameters import (
    Contact,
    NotNegative,
    PadParameters,
    Positive,
    TaskParameters,
)


class ThrowStart(StrictModel):
    """Half ranges of what is drawn."""

    place_mm: NotNegative
    """Half range of the body's place in the grip, along the gels and up."""
    speed_part: NotNegative
    """Half range by which the throw is faster than was meant, as a part of that."""
    late_s: NotNegative
    """Half range by which the gels close later than was meant."""


class ThrowPolicy(StrictModel):
    """The scripted baseline."""

    gap_mm: Positive
    """Gap of each gel from the body at the start."""
    squeeze_mm: Positive
    """Squeeze of each gel in the first grip, which takes a step, and the most when it catches."""
    hold_s: NotNegative
    throw_m_s: Positive
    """Speed at which the hand opens."""
    throw_m_s2: Positive
    open_mm: Positive
    """Gap of each gel from the body when the hand is open."""
    open_m_s: Positive
    """Speed of each gel, opening and closing."""
    brake_m_s2: Positive
    """Once the hand is open."""
    grip_n: Positive
    """Closing ends when both gels push as hard."""


class CatchGoal(StrictModel):
    """When it is done."""

    fly_s: Positive
    """Time without any touch."""
    above_mm: Positive
    """Height of the body's middle over that of the hand at its highest."""
    off_mm: Positive
    """Distance of the body's middle from that of the hand, at the end."""
    hold_s: Positive
    """Time of both gels touching it, without a break, until the end."""


class ThrowCatchParameters(TaskParameters):
    """The file of a throw and catch."""

    kind: Literal["throw-catch"]
    object: Object
    gel: PadParameters
    contact: Contact
    start: ThrowStart
    policy: ThrowPolicy
    goal: CatchGoal


class ThrowCatch(TaskEpisode):
    """Throw and catch of some seeds."""

    gel = "left"

    def __init__(
        self, parameters: ThrowCatchParameters, seeds: Sequence[int], device: str | None = None
    ) -> None:
        self.parameters = parameters
        count, half, policy = len(seeds), parameters.start, parameters.policy
        ranges = {
            "y_mm": half.place_mm,
            "z_mm": half.place_mm,
            "speed_part": half.speed_part,
            "late_s": half.late_s,
        }
        starts = [draw(seed, ranges) for seed in seeds]
        pose = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (count, 1))
        pose[:, 1] = [1e-3 * start["y_mm"] for start in starts]
        pose[:, 2] = [1e-3 * start["z_mm"] for start in starts]
        self._throw = policy.throw_m_s * (1 + np.array([s["speed_part"] for s in starts]))
        self._late = np.array([start["late_s"] for start in starts])
        body = parameters.object.at(pose)
        self._touch = float(body.shape.vertices_m[:, 0].max())
        self._height, self._speed = np.zeros(count), np.zeros(count)
        """Height and speed of the hand [m], [m/s]."""
        self._gap = np.full(count, 1e-3 * policy.gap_mm)
        """Gap of each gel from the body, negative when squeezed [m]."""
        self._opened = np.full(count, np.nan)
        """Time at which the hand began to open [s]."""
        self._closing, self._caught = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
        gels, mounts = gels_of(parameters.gel)
        scene = Scene(
            gels,
            mounts,
            count,
            TimeStepping(False, parameters.dt_s, (0.0, 0.0, -G), TimeScheme.BDF2),
            affine_bodies=body,
        )
        config = contact_config(parameters.contact)
        super().__init__(parameters, seeds, starts, scene, config, self._targets(), device)
        self._force = np.zeros((count, 2))
        self._strongest = np.zeros(count)
        self._flown, self._longest, self._held = np.zeros((3, count), dtype=int)
        self._above = np.zeros(count)
        self._off = np.full(count, np.nan)

    def _targets(self) -> np.ndarray:
        hands = np.tile(np.eye(4), (len(self._height), 1, 1))
        hands[:, 2, 3] = self._height
        return pose_of(mounts_of(hands, self._touch + self._gap))

    def _opening_s(self) -> float:
        policy = self.parameters.policy
        return 1e-3 * (policy.open_mm + policy.squeeze_mm) / policy.open_m_s

    def _back_s(self) -> float:
        """Time from the opening of the hand until the body, thrown as was meant, is back in it."""
        policy = self.parameters.policy
        speed = policy.throw_m_s
        stops = speed * self._opening_s() + speed**2 / (2 * policy.brake_m_s2)
        return (speed + np.sqrt(max(speed**2 - 2 * G * stops, 0.0))) / G

    def control(self) -> Control:
        policy, dt = self.parameters.policy, self.parameters.dt_s
        now = self.taken * dt
        start = self._speed
        thrown = ~np.isnan(self._opened)
        if now >= policy.hold_s - 1e-9:
            faster = np.minimum(start + policy.throw_m_s2 * dt, self._throw)
            since = np.where(thrown, now - self._opened, 0.0)
            slower = np.maximum(start - policy.brake_m_s2 * dt, 0.0)
            braking = thrown & (since >= self._opening_s() - 1e-9)
            self._speed = np.where(braking, slower, np.where(thrown, start, faster))
        self._height = self._height + dt * (start + self._speed) / 2
        step = policy.open_m_s * dt
        wide = np.minimum(self._gap + step, 1e-3 * policy.open_mm)
        expected = self._back_s() - self._opening_s() + self._late
        self._closing |= thrown & (now - self._opened >= expected)
        gripped = np.full_like(self._gap, -1e-3 * policy.squeeze_mm)
        tighter = np.where(self._caught, self._gap, np.maximum(self._gap - step, gripped))
        self._gap = np.where(self._closing, tighter, np.where(thrown, wide, gripped))
        self._opened[~thrown & (self._speed >= self._throw - 1e-12)] = now + dt
        return Control(target_poses=self._targets())

    def measure(self) -> None:
        run, policy = self.running, self.parameters.policy
        self._force[run] = self.forces_on("object", SIDES, friction=False)[run]
        self._strongest = np.maximum(self._strongest, self._force.max(axis=1))
        self._caught |= run & self._closing & (self._force.min(axis=1) >= policy.grip_n)
        free = self._force.max(axis=1) == 0
        self._flown[run] = np.where(free, self._flown + 1, 0)[run]
        self._longest = np.maximum(self._longest, self._flown)
        held = self._closing & (self._force.min(axis=1) > 0)
        self._held[run] = np.where(held, self._held + 1, 0)[run]
        centre = self.affine_frame()[0]
        centre[:, 2] -= self._height
        self._above[run] = np.maximum(self._above, centre[:, 2])[run]
        self._off[run] = np.linalg.norm(centre, axis=1)[run]

    def judge(self, env: int) -> tuple[str, dict[str, float]]:
        goal, dt = self.parameters.goal, self.parameters.dt_s
        figures = {
            "flown_s": self._longest[env] * dt,
            "above_mm": 1e3 * self._above[env],
            "off_mm": 1e3 * self._off[env],
            "held_s": self._held[env] * dt,
            "strongest_n": self._strongest[env],
        }
        if figures["flown_s"] < goal.fly_s - 1e-9 or figures["above_mm"] < goal.above_mm:
            flown, above = figures["flown_s"], figures["above_mm"]
            return f"flew for {flown:.2f} s, {above:.0f} mm over the hand", figures
        if figures["held_s"] < goal.hold_s - 1e-9:
            return f"was held for {figures['held_s']:.2f} s at the end", figures
        if not figures["off_mm"] <= goal.off_mm:
            return f"was caught {figures['off_mm']:.1f} mm off the middle", figures
        return "", figures

    def forces(self) -> dict[str, float]:
        return {f"{side} gel": float(self._force[0, i]) for i, side in enumerate(SIDES)}
