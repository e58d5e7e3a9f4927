# SPDX-License-Identifier: Apache-2.0
"""Open a mechanism of unknown kind, gripped by two gels, by what their markers tell.

Execution and recovery of Tac-Man [Zhao et al. 2024, arXiv 2403.01694], as Taccel's example steps
them: in execution the hand takes a step blind; where the markers in the grip have moved
too far from where they were when gripped, recovery moves the hand by the rigid motion that fits
them [Kabsch 1976], step by step, until they are back. Joints of a scene turn or slide; what does
both is a nut on a thread (``nut.Thread``), by contact alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from taccel_lab.files.strict_model import Number, StrictModel
from taccel_lab.geometry import QuadraticMesh, TetMesh
from taccel_lab.robots.transforms import pose_of, rotation_vector
from taccel_lab.scene import (
    KinematicBody,
    PrismaticJoint,
    RevoluteJoint,
    Scene,
    TimeStepping,
    box_mesh,
)
from taccel_lab.signals.markers import MarkerLayout
from taccel_lab.solvers import Control
from taccel_lab.tasks.bodies import SIDES, contact_config, free_body, gels_of, mounts_of
from taccel_lab.tasks.draw import draw
from taccel_lab.tasks.episode import TaskEpisode
from taccel_lab.tasks.nut import Thread
from taccel_lab.tasks.parameters import (
    Contact,
    Count,
    FreeBody,
    NotNegative,
    PadParameters,
    Positive,
    TaskParameters,
)

FEWEST_MARKERS = 6
"""Least number that a grip must press down."""


class Mechanism(FreeBody):
    """What is gripped, and how it can move: away along the hand's z at first."""

    joint: Literal["prismatic", "revolute", "helical"]
    handle_mm: tuple[Positive, Positive, Positive] | None = None
    """Sides of the handle of a joint: across the grip, along the fingers, along the pull."""
    hinge_mm: Positive | None = None
    """Distance of a hinge from the handle, across the pull, in the middle of what is drawn."""
    thread: Thread | None = None
    """Thread of a helical one."""

    @model_validator(mode="after")
    def _check_parts(self) -> Self:
        wanted = {
            "prismatic": {"handle_mm"},
            "revolute": {"handle_mm", "hinge_mm"},
            "helical": {"thread"},
        }[self.joint]
        parts = ("handle_mm", "hinge_mm", "thread")
        given = {name for name in parts if getattr(self, name) is not None}
        if given != wanted:
            names = ", ".join(sorted(wanted))
            raise ValueError(f"joint {self.joint!r} needs {names} and nothing else of {parts}")
        return self


class TacManStart(StrictModel):
    """Half ranges of what is drawn."""

    grip_mm: NotNegative
    """Half range of the hand's place along the handle, or the flats, and along the pull."""
    around_deg: NotNegative
    """Where the hinge lies around the pull."""
    hinge_mm: NotNegative
    """Half range of its distance."""
    depth_mm: NotNegative
    """Half range of its place along the pull: the hand's own step is then not along the arc."""


class TacManPolicy(StrictModel):
    """Execution and recovery."""

    gap_mm: Positive
    """Gap between each gel and what it grips, at the start."""
    squeeze_mm: Positive
    """Depth that each gel is pressed in."""
    close_steps: Count
    settle_steps: Count
    step_mm: NotNegative
    """Step of execution, along the hand's z."""
    step_deg: NotNegative
    """Turn of a step of execution, about the hand's z."""
    marker_pitch_mm: Positive
    deep_mm: Positive
    """Markers that the grip pushes in by more are watched."""
    begin_mm: Positive
    """Recovery begins where they have moved by more, on the mean (delta_0)."""
    end_part: Annotated[Number, Field(gt=0, lt=1)]
    """It ends below this part of that (alpha)."""
    lost_mm: Positive
    """Given up where they have moved by more."""
    longest_recovery: Count
    """Steps of a recovery after which it is given up."""


class TacManGoal(StrictModel):
    """When it is done."""

    opened_mm: NotNegative
    opened_deg: NotNegative
    """Least way of the handle's middle along the pull, and least turn of it."""
    path_mm: Positive
    """Largest distance of the hand from where the handle's motion would have taken it."""


class TacManParameters(TaskParameters):
    """The file of a Tac-Man task."""

    kind: Literal["tac-man"]
    mechanism: Mechanism
    gel: PadParameters
    contact: Contact
    start: TacManStart
    policy: TacManPolicy
    goal: TacManGoal


class TacMan(TaskEpisode):
    """Tac-Man of some seeds; an environment that is done or given up is not stepped any more."""

    gel = "left"

    def __init__(
        self, parameters: TacManParameters, seeds: Sequence[int], device: str | None = None
    ) -> None:
        self.parameters = parameters
        count, half, what = len(seeds), parameters.start, parameters.mechanism
        ranges = {
            "along_mm": half.grip_mm,
            "pull_mm": half.grip_mm,
            "around_deg": half.around_deg,
            "hinge_mm": half.hinge_mm,
            "depth_mm": half.depth_mm,
        }
        starts = [draw(seed, ranges) for seed in seeds]
        drawn = {name: np.array([start[name] for start in starts]) for name in ranges}
        gels, bodies = gels_of(parameters.gel)
        pose = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (count, 1))
        self._hands = np.tile(np.eye(4), (count, 1, 1))
        joints = []
        if what.thread is not None:
            bolt, shape = what.thread.bolt(), what.thread.nut()
            bodies.append(KinematicBody(bolt, what.thread.friction, name="bolt"))
            pose[:, 2] = what.thread.height_m(np.zeros(count))
            self._hands[:, 2, 3] = pose[:, 2] + shape.vertices_m[:, 2].mean()
            self._half = what.thread.flat_m
        else:
            assert what.handle_mm is not None
            sides = [1e-3 * side for side in what.handle_mm]
            shape = box_mesh((sides[0], sides[1], sides[2]))
            self._half = sides[0] / 2
            if what.joint == "prismatic":
                joints.append(PrismaticJoint("handle", axis=(0.0, 0.0, 1.0)))
            else:
                assert what.hinge_mm is not None
                around = np.radians(drawn["around_deg"])
                across = np.stack([np.cos(around), np.sin(around), np.zeros(count)], axis=1)
                anchor = 1e-3 * (what.hinge_mm + drawn["hinge_mm"])[:, None] * across
                anchor[:, 2] = 1e-3 * drawn["depth_mm"]
                # Turning about it takes the handle along the pull.
                axis = np.cross([0.0, 0.0, 1.0], across)
                joints.append(RevoluteJoint("handle", anchor_m=anchor, axis=axis))
        self._hands[:, 1, 3] += 1e-3 * drawn["along_mm"]
        self._hands[:, 2, 3] += 1e-3 * drawn["pull_mm"]
        self._still = len(bodies) - len(SIDES)
        scene = Scene(
            gels,
            bodies,
            count,
            TimeStepping(False, parameters.dt_s),
            affine_bodies=free_body(what, shape, "handle", pose),
            joints=joints,
        )
        config = contact_config(parameters.contact)
        super().__init__(parameters, seeds, starts, scene, config, self._targets(0), device)
        self._layout = marker_grid(gels[0].nodal_mesh, parameters.policy.marker_pitch_mm)
        in_hand = self.markers_m()
        self._untouched = in_hand.copy()
        self._gripped = in_hand.copy()
        """Markers when gripped, in the hand [m], [env, marker, 3]."""
        self._watched = np.zeros(in_hand.shape[:2], dtype=bool)
        self._now = in_hand
        self._moved = np.zeros(count)
        """Motion of watched markers since, the mean [m], [env]."""
        self._recovering = np.zeros(count, dtype=bool)
        self._in_recovery = np.zeros(count, dtype=int)
        self._switches = np.zeros(count, dtype=int)
        self._given_up = [""] * count
        self._done = np.zeros(count, dtype=bool)
        self._axes = self.affine_frame()[1]
        self._grip_frame = self._start_frame = self.handle_frames()
        self._grip_hand = self._hands.copy()
        self._opened = np.zeros((count, 2))
        """Way of the handle's middle [mm] along the pull, and its turn [deg]."""
        self._path_error = np.zeros(count)
        self._force = np.zeros((count, 2))
        self._strongest = np.zeros(count)

    @property
    def gripped_at(self) -> int:
        """Steps after which the hand begins to pull."""
        return self.parameters.policy.close_steps + self.parameters.policy.settle_steps

    def _targets(self, step: int) -> np.ndarray:
        policy = self.parameters.policy
        closed = min(step / policy.close_steps, 1.0)
        gap = 1e-3 * (policy.gap_mm - closed * (policy.gap_mm + policy.squeeze_mm))
        mounts = mounts_of(self._hands, np.full(len(self._hands), self._half + gap))
        still = np.tile(np.eye(4), (len(mounts), self._still, 1, 1))
        return pose_of(np.concatenate([mounts, still], axis=1))

    def markers_m(self) -> np.ndarray:
        """Markers of both gels in the hand [m], [env, marker, 3]."""
        positions, found = self.state.positions.numpy(), []
        for side in SIDES:
            first = self.model.bodies[self.model.body_id(side)].nodes[0]
            nodes = positions[:, first + self._layout.nodes]
            found.append((nodes * self._layout.weights[..., None]).sum(axis=2))
        world = np.concatenate(found, axis=1) - self._hands[:, None, :3, 3]
        return world @ self._hands[:, :3, :3]

    def handle_frames(self) -> np.ndarray:
        """The handle's middle and how it has turned, [env, 4, 4]."""
        centre, axes = self.affine_frame()
        frames = np.tile(np.eye(4), (len(centre), 1, 1))
        frames[:, :3, 3] = centre
        frames[:, :3, :3] = axes @ np.linalg.inv(self._axes)
        return frames

    def control(self) -> Control:
        if self.taken >= self.gripped_at:
            for env in np.flatnonzero(self.running):
                self._move_hand(int(env))
        return Control(target_poses=self._targets(self.taken + 1))

    def _move_hand(self, env: int) -> None:
        policy = self.parameters.policy
        if self._recovering[env]:
            watched, hand = self._watched[env], self._hands[env]
            moved = rigid_fit(self._gripped[env, watched], self._now[env, watched])
            self._hands[env] = hand @ moved
            self._in_recovery[env] += 1
            if self._moved[env] < 1e-3 * policy.begin_mm * policy.end_part:
                self._recovering[env] = False
            return
        angle = np.radians(policy.step_deg)
        step = np.eye(4)
        step[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        step[2, 3] = 1e-3 * policy.step_mm
        self._hands[env] = self._hands[env] @ step
        if self._moved[env] > 1e-3 * policy.begin_mm:
            self._recovering[env] = True
            self._in_recovery[env] = 0
            self._switches[env] += 1

    def measure(self) -> None:
        policy, goal, run = self.parameters.policy, self.parameters.goal, self.running.copy()
        self._force[run] = self.forces_on("handle", SIDES)[run]
        self._now = self.markers_m()
        frames = self.handle_frames()
        if self.taken <= self.gripped_at:
            self._gripped[run] = self._now[run]
            self._grip_frame, self._grip_hand = frames, self._hands.copy()
            moved_m = np.abs(self._gripped[..., 0] - self._untouched[..., 0])
            deep = 1e-3 * (policy.gap_mm + policy.squeeze_mm) - moved_m
            self._watched = deep > 1e-3 * policy.deep_mm
            if self.taken == self.gripped_at:
                self._give_up(run & (self._watched.sum(axis=1) < FEWEST_MARKERS), "the grip failed")
            return
        moved = np.linalg.norm(self._now - self._gripped, axis=2)
        counts = np.maximum(self._watched.sum(axis=1), 1)
        self._moved[run] = ((moved * self._watched).sum(axis=1) / counts)[run]
        expected = frames @ np.linalg.inv(self._grip_frame) @ self._grip_hand
        off = np.linalg.norm(expected[:, :3, 3] - self._hands[:, :3, 3], axis=1)
        self._path_error[run] = np.maximum(self._path_error, off)[run]
        self._strongest[run] = np.maximum(self._strongest, self._force.max(axis=1))[run]
        gone = frames @ np.linalg.inv(self._start_frame)
        self._opened[run, 0] = 1e3 * (frames - self._start_frame)[run, 2, 3]
        turn = np.linalg.norm(rotation_vector(gone[:, :3, :3]), axis=1)
        self._opened[run, 1] = np.degrees(turn)[run]
        self._done |= run & (self._opened >= [goal.opened_mm, goal.opened_deg]).all(axis=1)
        self._give_up(run & (self._moved > 1e-3 * policy.lost_mm), "the grip was lost")
        stuck = self._recovering & (self._in_recovery >= policy.longest_recovery)
        self._give_up(run & stuck, "a recovery did not end")
        self.running &= ~self._done

    def _give_up(self, who: np.ndarray, why: str) -> None:
        for env in np.flatnonzero(who):
            self._given_up[env] = why
        self.running &= ~who

    def judge(self, env: int) -> tuple[str, dict[str, float]]:
        figures = {
            "opened_mm": self._opened[env, 0],
            "opened_deg": self._opened[env, 1],
            "switches": self._switches[env],
            "path_error_mm": 1e3 * self._path_error[env],
            "seconds": self._steps[env] * self.parameters.dt_s,
            "markers": self._watched[env].sum(),
            "strongest_n": self._strongest[env],
        }
        if self._given_up[env]:
            return self._given_up[env], figures
        if not self._done[env]:
            missed = (
                f"opened by {figures['opened_mm']:.0f} mm and {figures['opened_deg']:.0f} degrees"
            )
            return missed, figures
        if not figures["path_error_mm"] <= self.parameters.goal.path_mm:
            return f"strayed from its path by {figures['path_error_mm']:.1f} mm", figures
        return "", figures

    def forces(self) -> dict[str, float]:
        return {f"{side} gel": float(self._force[0, i]) for i, side in enumerate(SIDES)}


def marker_grid(mesh: TetMesh | QuadraticMesh, pitch_mm: float) -> MarkerLayout:
    """Markers all over the contact face, about its middle."""
    reach = 1e3 * np.abs(mesh.nodes_m[:, :2]).max(axis=0)
    x, y = (pitch_mm * np.arange(-int(r / pitch_mm), int(r / pitch_mm) + 1) for r in reach)
    return MarkerLayout.where_on(mesh, np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))[0]


def rigid_fit(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """The rigid motion [4, 4] that takes points [n, 3] nearest to others [Kabsch 1976]."""
    p, q = before.mean(axis=0), after.mean(axis=0)
    u, _, vt = np.linalg.svd((before - p).T @ (after - q))
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))])
    motion = np.eye(4)
    motion[:3, :3] = vt.T @ flip @ u.T
    motion[:3, 3] = q - motion[:3, :3] @ p
    return motion
