# SPDX-License-Identifier: Apache-2.0
"""Two gels grip a nut on a standing bolt and turn it; the thread makes it climb or sink.

The gels close on two flats until both push with a force, then go around the bolt at the height
where they began: the flats must slip along them by what the nut travels. Bolt and nut are those of
``threads``, M20 or all of it 0.8 times as large, M16; wide play as in the published scene.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from taccel_lab.files.strict_model import Number, StrictModel
from taccel_lab.robots.transforms import pose_of
from taccel_lab.scene import KinematicBody, Scene, TimeStepping, TriangleMesh
from taccel_lab.solvers import Control
from taccel_lab.tasks.bodies import SIDES, G, contact_config, free_body, gels_of, mounts_of
from taccel_lab.tasks.draw import draw
from taccel_lab.tasks.episode import TaskEpisode
from taccel_lab.tasks.parameters import (
    Contact,
    Count,
    FreeBody,
    NotNegative,
    PadParameters,
    Positive,
    TaskParameters,
)
from taccel_lab.tasks.parts import APOTHEM_M, PITCH_M, hexagon_nut, threaded_rod


class Thread(StrictModel):
    """Bolt and nut."""

    size: Literal["M16", "M20"]
    bolt_threads: Count
    nut_threads: Count
    friction: NotNegative
    """Friction of the bolt."""

    @property
    def scale(self) -> float:
        """Size against M20: pitch and diameter of M16 are both 0.8 times as large."""
        return {"M16": 0.8, "M20": 1.0}[self.size]

    @property
    def pitch_m(self) -> float:
        """What a turn travels."""
        return PITCH_M * self.scale

    @property
    def flat_m(self) -> float:
        """Distance of the nut's flats from the axis."""
        return APOTHEM_M * self.scale

    def bolt(self) -> TriangleMesh:
        """Surface from z = 0 up."""
        return scaled(threaded_rod(self.bolt_threads), self.scale)

    def nut(self) -> TriangleMesh:
        """Surface from z = 0 up, flats to +-x."""
        return scaled(hexagon_nut(self.nut_threads), self.scale)

    def height_m(self, turned: np.ndarray) -> np.ndarray:
        """Height of the nut's frame about the middle of the bolt, in the middle of its play,
        turned by angles [rad]."""
        between = (self.bolt_threads - self.nut_threads) // 2
        return self.pitch_m * (between + turned / (2 * np.pi))


class NutStart(StrictModel):
    """Half ranges of what is drawn."""

    turn_deg: NotNegative
    """Turn of the nut, which lies that much further along its thread; the gels turn with it."""
    grip_deg: NotNegative
    """Turn of the gels against the flats."""
    grip_mm: NotNegative
    """Distance of the gels' middle from the flats', along the bolt."""


class NutPolicy(StrictModel):
    """The scripted baseline."""

    gap_mm: Positive
    """Gap between each gel and its flat, at the start."""
    closed_mm: Positive
    """Way that closing goes beyond the flat at most, whatever the force."""
    close_mm_s: Positive
    grip_n: Positive
    """Closing ends when both gels push as hard."""
    turns: Number
    """Turns of the gels; counter-clockwise, up, is positive."""
    turn_deg_s: Positive


class NutGoal(StrictModel):
    """When it is done."""

    turns: Positive
    """Turns of the nut at least, since the grip."""
    threads: Positive
    """Pitches that it has travelled at least."""
    play_threads: Positive
    """Largest difference between the pitches that it travelled and its turns."""


class NutParameters(TaskParameters):
    """The file of a nut on a bolt."""

    kind: Literal["nut"]
    thread: Thread
    nut: FreeBody
    gel: PadParameters
    contact: Contact
    start: NutStart
    policy: NutPolicy
    goal: NutGoal


class Nut(TaskEpisode):
    """Nut turning of some seeds."""

    gel = "left"

    def __init__(
        self, parameters: NutParameters, seeds: Sequence[int], device: str | None = None
    ) -> None:
        self.parameters = parameters
        count, thread = len(seeds), parameters.thread
        starts = [draw(seed, parameters.start.model_dump()) for seed in seeds]
        turned = np.radians([s["turn_deg"] for s in starts])
        bolt, nut = thread.bolt(), thread.nut()
        height = thread.height_m(turned)
        pose = np.zeros((count, 7))
        pose[:, 2], pose[:, 5], pose[:, 6] = height, np.sin(turned / 2), np.cos(turned / 2)
        self._flat = thread.flat_m
        self._toward = turned + np.radians([s["grip_deg"] for s in starts])
        self._height = height + nut.vertices_m[:, 2].mean()
        self._height += 1e-3 * np.array([s["grip_mm"] for s in starts])
        self._gap = np.full(count, 1e-3 * parameters.policy.gap_mm)
        """Gaps between gels and flats [m]."""
        self._around = np.zeros(count)
        """How far the gels have gone around [rad]."""
        self._gripping = np.zeros(count, dtype=bool)
        gels, mounts = gels_of(parameters.gel)
        scene = Scene(
            gels,
            [*mounts, KinematicBody(bolt, thread.friction, name="bolt")],
            count,
            TimeStepping(False, parameters.dt_s, (0.0, 0.0, -G)),
            affine_bodies=free_body(parameters.nut, nut, "nut", pose),
        )
        config = contact_config(parameters.contact)
        super().__init__(parameters, seeds, starts, scene, config, self._targets(), device)
        centre, self._axes = self.affine_frame()
        self._centre = centre
        self._turned = np.zeros(count)
        """How far the nut has turned [rad]."""
        self._travel = np.zeros(count)
        self._before = np.full((count, 2), np.nan)
        """Turn [rad] and height [m] of the nut when the grip was firm."""
        self._grip = np.zeros((count, 2))
        self._on_bolt = np.zeros(count)
        self._jam = np.zeros(count)

    def _targets(self) -> np.ndarray:
        angle = self._toward + self._around
        hands = np.tile(np.eye(4), (len(angle), 1, 1))
        hands[:, 0, 0], hands[:, 0, 1] = np.cos(angle), -np.sin(angle)
        hands[:, 1, 0], hands[:, 1, 1] = np.sin(angle), np.cos(angle)
        hands[:, 2, 3] = self._height
        bolt = np.tile(np.eye(4), (len(angle), 1, 1, 1))
        mounts = mounts_of(hands, self._flat + self._gap)
        return pose_of(np.concatenate([mounts, bolt], axis=1))

    def control(self) -> Control:
        policy, dt = self.parameters.policy, self.parameters.dt_s
        closer = np.maximum(self._gap - 1e-3 * policy.close_mm_s * dt, -1e-3 * policy.closed_mm)
        self._gap = np.where(self._gripping, self._gap, closer)
        end = 2 * np.pi * abs(policy.turns)
        farther = np.minimum(np.abs(self._around) + np.radians(policy.turn_deg_s) * dt, end)
        self._around = np.where(self._gripping, np.sign(policy.turns) * farther, self._around)
        return Control(target_poses=self._targets())

    def measure(self) -> None:
        policy, run = self.parameters.policy, self.running
        self._grip[run] = self.forces_on("nut", SIDES, friction=False)[run]
        self._on_bolt[run] = np.linalg.norm(self.force_on("nut", "bolt"), axis=1)[run]
        centre, axes = self.affine_frame()
        turn = axes @ np.linalg.inv(self._axes)
        angle = np.arctan2(turn[:, 1, 0] - turn[:, 0, 1], turn[:, 0, 0] + turn[:, 1, 1])
        step = (angle - self._turned + np.pi) % (2 * np.pi) - np.pi
        self._turned[run] += step[run]
        self._travel[run] = (centre - self._centre)[run, 2]
        closed = self._gap <= -1e-3 * policy.closed_mm + 1e-12
        firm = run & ~self._gripping & ((self._grip.min(axis=1) >= policy.grip_n) | closed)
        self._before[firm] = np.stack([self._turned, self._travel], axis=1)[firm]
        self._gripping |= firm
        self._jam[run & self._gripping] = np.maximum(self._jam, self._on_bolt)[run & self._gripping]

    def judge(self, env: int) -> tuple[str, dict[str, float]]:
        goal, pitch = self.parameters.goal, self.parameters.thread.pitch_m
        sense = np.sign(self.parameters.policy.turns)
        turns = sense * (self._turned[env] - self._before[env, 0]) / (2 * np.pi)
        threads = sense * (self._travel[env] - self._before[env, 1]) / pitch
        figures = {
            "turns": turns,
            "threads": threads,
            "behind_deg": np.degrees(np.abs(self._around[env])) - 360 * turns,
            "jam_force_n": self._jam[env],
            "grip_n": self._grip[env].mean(),
        }
        if not figures["turns"] >= goal.turns:
            return f"turned by {figures['turns']:.2f} turns", figures
        off = abs(figures["threads"] - figures["turns"])
        if not (figures["threads"] >= goal.threads and off <= goal.play_threads):
            missed = f"travelled {figures['threads']:.2f} threads in {figures['turns']:.2f} turns"
            return missed, figures
        return "", figures

    def forces(self) -> dict[str, float]:
        gels = {f"{side} gel": float(self._grip[0, i]) for i, side in enumerate(SIDES)}
        return gels | {"bolt": float(self._on_bolt[0])}


def scaled(mesh: TriangleMesh, factor: float) -> TriangleMesh:
    """The same surface, larger or smaller about its origin."""
    return TriangleMesh(mesh.vertices_m * factor, mesh.faces)
