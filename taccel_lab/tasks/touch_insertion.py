# SPDX-License-Identifier: Apache-2.0
"""Push a peg into a hole that is not where the policy believes it, led by what two gels feel.

The policy is fixed, so that what differs between two runs is the gels: a sensor's design is judged
by how often the peg goes in. It sees the markers of both gels, in the planes of their faces and
with noise, and nothing else: it goes down until they have moved up by a limit, tells from where
they moved most on which side the peg stands on the rim, rises, steps away from that side and tries
again. The gels close until both push with a force, which is the gripper's own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from taccel_lab.files.strict_model import Flag, Number, StrictModel
from taccel_lab.geometry import TetMesh
from taccel_lab.robots.transforms import matrix_of, pose_of
from taccel_lab.scene import KinematicBody, Scene, TimeStepping
from taccel_lab.signals.markers import MarkerLayout
from taccel_lab.solvers import Control
from taccel_lab.tasks.bodies import SIDES, contact_config, free_body, gels_of, mounts_of
from taccel_lab.tasks.episode import TaskEpisode
from taccel_lab.tasks.parameters import (
    Contact,
    Count,
    NotNegative,
    PadParameters,
    PlanarStart,
    Positive,
    TaskParameters,
)
from taccel_lab.tasks.pegs import Hole, Peg


class PegMarkers(StrictModel):
    """A grid of markers about the middle of each gel, and how well they are seen."""

    columns: Count
    rows: Count
    """Numbers of markers beside each other across the peg's way, and along it."""
    pitch_mm: tuple[Positive, Positive]
    noise_mm: NotNegative
    """Standard deviation of a marker's place in each direction, in each step."""

    def points_mm(self) -> np.ndarray:
        """Where they are on the gel, [marker, 2]."""
        x, y = (
            pitch * (np.arange(count) - (count - 1) / 2)
            for count, pitch in zip((self.columns, self.rows), self.pitch_mm, strict=True)
        )
        return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


class TouchPolicy(StrictModel):
    """The fixed policy."""

    gap_mm: Positive
    """Gap of each gel from the peg at the start."""
    close_mm_s: Positive
    grip_n: Positive
    """Closing ends when both gels push as hard."""
    squeeze_mm: Positive
    """And at the latest when each gel is squeezed as much."""
    grip_height_mm: Positive
    """Height of the gels' middle over the peg's lower end."""
    clear_mm: Positive
    """Height of the peg over the rim at the start and after rising."""
    search_mm_s: Positive
    """Going down by the first ``search_mm``."""
    search_mm: Positive
    down_mm_s: Positive
    """And below."""
    up_mm_s: Positive
    way_mm: Positive
    """Way that the gels go down by from where they closed, if nothing is felt."""
    felt_mm: Positive
    """Mean way up of the markers at which something is felt."""
    side_part: tuple[NotNegative, NotNegative]
    """The rim is on one side, across the gels or along them, where markers there moved up by more
    than the mean and this part of it."""
    aside_mm: Positive
    """Step away from that side."""
    turns_deg: tuple[Number, ...] = ()
    """Turns instead, one after the other, where the rim is felt on no side."""
    tries: Count


class TouchGoal(StrictModel):
    """When it is done."""

    depth_mm: Positive
    """Depth of the peg's lowest point below the rim."""
    whole: Flag = False
    """Whether its whole lower end counts instead."""


class TouchInsertionParameters(TaskParameters):
    """The file of an insertion that is led by touch."""

    kind: Literal["touch-insertion"]
    peg: Peg
    hole: Hole
    gel: PadParameters
    markers: PegMarkers
    contact: Contact
    start: PlanarStart
    """Start of gels and peg, from above the middle of the hole."""
    on_rim: Flag = False
    """Whether starts from which the peg would go in at once are drawn again."""
    policy: TouchPolicy
    goal: TouchGoal

    def drawn_again(self, x_m: float, y_m: float, yaw_rad: float) -> bool:
        """Whether a start does not count."""
        section = self.peg.section()
        hole = replace(section, outline=self.hole.outline(self.peg))
        return self.on_rim and not hole.crosses(section.placed(x_m, y_m, yaw_rad))


class TouchInsertion(TaskEpisode):
    """Insertion of some seeds; one that is in or has no tries left is not stepped any more."""

    gel = "right"

    def __init__(
        self,
        parameters: TouchInsertionParameters,
        seeds: Sequence[int],
        device: str | None = None,
        gel: TetMesh | None = None,
    ) -> None:
        """``gel`` is the mesh of both gels, see ``gels_of``."""
        self.parameters = parameters
        count, policy = len(seeds), parameters.policy
        block, pit = parameters.peg, parameters.hole
        self._rim, self._flat = 1e-3 * pit.depth_mm, block.half_m
        peg, hole = block.mesh(), pit.mesh(block)
        self._end = peg.vertices_m[:, 2] < peg.vertices_m[:, 2].min() + 1e-9
        """Nodes of the peg's lower end, bool, [node]."""
        starts, pose = parameters.start.draw(seeds, parameters.drawn_again)
        self._hands = matrix_of(pose)
        """Middle of both gels, as the policy moves it, [env, 4, 4]."""
        lower = self._rim + 1e-3 * policy.clear_mm
        pose[:, 2] = lower
        self._hands[:, 2, 3] = lower + 1e-3 * policy.grip_height_mm
        self._top = self._hands[0, 2, 3]
        self._closed = np.full(count, -1e-3 * policy.gap_mm)
        """Squeeze of each gel [m], negative before it touches."""
        gels, mounts = gels_of(parameters.gel, gel)
        self._layout = MarkerLayout.from_points(gels[0].nodal_mesh, parameters.markers.points_mm())
        scene = Scene(
            gels,
            [*mounts, KinematicBody(hole, pit.friction, name="hole")],
            count,
            TimeStepping(False, parameters.dt_s),
            affine_bodies=free_body(block, peg, "peg", pose),
        )
        config = contact_config(parameters.contact)
        super().__init__(parameters, seeds, starts, scene, config, self._targets(), device)
        self._noise = [np.random.default_rng((seed, 1)) for seed in self.seeds]
        self._gripped = np.zeros(count, dtype=bool)
        self._rising = np.zeros(count, dtype=bool)
        self._zero = self._seen()
        """Markers before the peg goes down, [env, side, marker, 2]."""
        self._now = self._zero.copy()
        self._aside = np.zeros((count, 2))
        """Step that the policy takes when it is up [m]."""
        self._turn, self._turns = np.zeros(count), np.zeros(count, dtype=int)
        """Turn that it takes then [rad], and how many of its turns it has taken."""
        self._tries = np.ones(count, dtype=int)
        self._depth = np.full(count, np.nan)
        self._jam, self._on_hole = np.zeros(count), np.zeros(count)
        self._grip = np.zeros((count, 2))
        self._gripped_at = np.full((count, 3), np.nan)
        self._slip = np.full(count, np.nan)

    @property
    def hands_m(self) -> np.ndarray:
        """Where the policy has moved the middle of the gels [m], [env, 3]."""
        return self._hands[:, :3, 3].copy()

    @property
    def turns_deg(self) -> np.ndarray:
        """How far about the vertical the hands are turned, [env]."""
        return np.degrees(np.arctan2(self._hands[:, 1, 0], self._hands[:, 0, 0]))

    def _targets(self) -> np.ndarray:
        mounts = mounts_of(self._hands, self._flat - self._closed)
        still = np.tile(np.eye(4), (len(mounts), 1, 1, 1))
        return pose_of(np.concatenate([mounts, still], axis=1))

    def _seen(self) -> np.ndarray:
        """Markers in the planes of the faces, across the hand and up [m], with noise,
        [env, side, marker, 2]."""
        positions, found = self.state.positions.numpy(), []
        for side in SIDES:
            first = self.model.bodies[self.model.body_id(side)].nodes[0]
            nodes = positions[:, first + self._layout.nodes]
            world = (nodes * self._layout.weights[..., None]).sum(axis=2)
            local = (world - self._hands[:, None, :3, 3]) @ self._hands[:, :3, :3]
            found.append(local[..., 1:])
        seen = np.stack(found, axis=1)
        scale = 1e-3 * self.parameters.markers.noise_mm
        for env, generator in enumerate(self._noise):
            seen[env] += scale * generator.standard_normal(seen[env].shape)
        return seen

    def control(self) -> Control:
        policy, dt = self.parameters.policy, self.parameters.dt_s
        closer = self._closed + 1e-3 * policy.close_mm_s * dt
        closing = ~self._gripped
        self._closed[closing] = np.minimum(closer, 1e-3 * policy.squeeze_mm)[closing]
        up = self._gripped & self._rising
        down = self._gripped & ~self._rising
        height = self._hands[:, 2, 3]
        height[up] = np.minimum(height + 1e-3 * policy.up_mm_s * dt, self._top)[up]
        lowest = self._top - 1e-3 * policy.way_mm
        searching = height > self._top - 1e-3 * policy.search_mm
        speed = 1e-3 * np.where(searching, policy.search_mm_s, policy.down_mm_s)
        height[down] = np.maximum(height - speed * dt, lowest)[down]
        # Aside only when it is up, a step by itself.
        there = up & (height >= self._top - 1e-12)
        turned = np.einsum("eij,ej->ei", self._hands[:, :2, :2], self._aside)
        self._hands[there, :2, 3] += turned[there]
        about_z = np.zeros((int(there.sum()), 7))
        about_z[:, 5], about_z[:, 6] = np.sin(self._turn[there] / 2), np.cos(self._turn[there] / 2)
        self._hands[there] = self._hands[there] @ matrix_of(about_z)
        self._aside[there], self._turn[there] = 0.0, 0.0
        return Control(target_poses=self._targets())

    def measure(self) -> None:
        policy, run = self.parameters.policy, self.running.copy()
        self._grip[run] = self.forces_on("peg", SIDES, friction=False)[run]
        self._on_hole[run] = np.linalg.norm(self.force_on("peg", "hole"), axis=1)[run]
        self._jam = np.maximum(self._jam, self._on_hole)
        body = self.model.bodies[self.model.body_id("peg")]
        heights = self.state.positions.numpy()[:, body.node_slice, 2]
        end = heights[:, self._end]
        lower = end.max(axis=1) if self.parameters.goal.whole else end.min(axis=1)
        self._depth[run] = (self._rim - lower)[run]
        seen = self._seen()
        self._now[run] = seen[run]
        was = self._gripped.copy()
        firm = (self._grip >= policy.grip_n).all(axis=1)
        self._gripped |= run & (firm | (self._closed >= 1e-3 * policy.squeeze_mm - 1e-12))
        local = np.einsum(
            "eji,ej->ei", self._hands[:, :3, :3], self.affine_frame()[0] - self._hands[:, :3, 3]
        )
        fresh = self._gripped & ~was
        self._gripped_at[fresh] = local[fresh]
        self._slip[run] = np.linalg.norm(local - self._gripped_at, axis=1)[run]
        ready = run & self._gripped & (~was | self._rising)
        ready &= self._hands[:, 2, 3] >= self._top - 1e-12
        going = run & was & ~self._rising
        self._zero[ready] = self._now[ready]
        self._rising[ready] = False
        felt = going & (self._moved_up().mean(axis=(1, 2)) > 1e-3 * policy.felt_mm)
        for env in np.flatnonzero(felt):
            self._aside[env] = self._away(int(env))
            if not self._aside[env].any() and self._turns[env] < len(policy.turns_deg):
                self._turn[env] = np.radians(policy.turns_deg[self._turns[env]])
                self._turns[env] += 1
        out = felt & (self._tries >= policy.tries)
        self._tries[felt & ~out] += 1
        self._rising |= felt
        lowest_hand = self._top - 1e-3 * policy.way_mm
        arrived = going & ~felt & (self._hands[:, 2, 3] <= lowest_hand + 1e-12)
        self.running &= ~(out | arrived)

    def _moved_up(self) -> np.ndarray:
        """Rise of each marker since before the peg went down [m], [env, side, marker]."""
        return (self._now - self._zero)[..., 1]

    def _away(self, env: int) -> np.ndarray:
        """The step away from the side on which the peg stands, in the hand's x and y [m].

        Across the gels (x) that is the gel whose markers moved up more; along them (y) the end
        towards which they moved up more, by the line fitted through all of them, at the outermost.
        """
        policy = self.parameters.policy
        up = self._moved_up()[env]
        mean = up.mean()
        across = self._zero[env, ..., 0] - self._zero[env, ..., 0].mean()
        slope = (across * (up - up.mean(axis=1, keepdims=True))).sum() / (across**2).sum()
        sides = np.array([up[1].mean() - mean, slope * across.max()])
        chosen = np.abs(sides) > mean * np.array(policy.side_part)
        return -1e-3 * policy.aside_mm * np.sign(sides) * chosen

    def judge(self, env: int) -> tuple[str, dict[str, float]]:
        figures = {
            "depth_mm": 1e3 * self._depth[env],
            "tries": self._tries[env],
            "jam_force_n": self._jam[env],
            "slip_mm": 1e3 * self._slip[env],
            "grip_n": self._grip[env].mean(),
        }
        if not figures["depth_mm"] >= self.parameters.goal.depth_mm:
            return f"came {figures['depth_mm']:.1f} mm deep", figures
        return "", figures

    def forces(self) -> dict[str, float]:
        gels = {f"{side} gel": float(self._grip[0, i]) for i, side in enumerate(SIDES)}
        return gels | {"hole": float(self._on_hole[0])}
