# SPDX-License-Identifier: Apache-2.0
"""Tell mechanical parts apart by what two gels feel when they close on them.

A part stands still between two gels, shown to them with one of its three axes, turned about the
line on which they close, tilted and off the middle. Each gel closes until its own depth map is as
deep as was drawn. A network is taught by the maps of some seeds and judged by those of others: each
seed is judged once, by a network that has seen no grasp of its region of turns (``regions``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from taccel_lab.files.strict_model import StrictModel
from taccel_lab.geometry import PixelGrid
from taccel_lab.robots.transforms import matrix_of, pose_of
from taccel_lab.scene import KinematicBody, Scene, TimeStepping
from taccel_lab.scene import Surface as Presence
from taccel_lab.signals import SignalTactile
from taccel_lab.solvers import Control
from taccel_lab.tasks.depth_classifier import Learner, folds, judge_by_folds, nearest
from taccel_lab.tasks.draw import draw
from taccel_lab.tasks.episode import TaskEpisode
from taccel_lab.tasks.pair_of_gels import SIDES, gels_of, mounts_of
from taccel_lab.tasks.parameters import (
    Contact,
    Count,
    NotNegative,
    PadParameters,
    Positive,
    TaskParameters,
)
from taccel_lab.tasks.parts import PARTS
from taccel_lab.tasks.physics import contact_config
from taccel_lab.tasks.result import TaskTrial


class GraspStart(StrictModel):
    """What is drawn: which axis of the part the gels close on, its turn about that, and half ranges
    of tilts and place; and the range of depths."""

    turn_deg: NotNegative
    tilt_deg: NotNegative
    place_mm: NotNegative
    depth_mm: tuple[Positive, Positive]
    """Of the depth map at which a gel stops."""


class ClosingPolicy(StrictModel):
    """How the gels close."""

    gap_mm: Positive
    """Between the part's outermost points and the gels at the start."""
    step_mm: Positive


class DepthMaps(StrictModel):
    """Of both gels."""

    width_px: Count
    height_px: Count
    mm_per_px: Positive


class ClassificationParameters(TaskParameters):
    """The file of a classification."""

    kind: Literal["classification"]
    parts: Annotated[tuple[str, ...], Field(min_length=2)]
    part_friction: NotNegative
    gel: PadParameters
    contact: Contact
    start: GraspStart
    policy: ClosingPolicy
    maps: DepthMaps
    learner: Learner

    @model_validator(mode="after")
    def _check(self) -> Self:
        unknown = [name for name in self.parts if name not in PARTS]
        if unknown:
            raise ValueError(f"no parts {', '.join(unknown)}; there are {', '.join(PARTS)}")
        if len(set(self.parts)) < len(self.parts):
            raise ValueError("parts names one part twice")
        return self


class Classification(TaskEpisode):
    """Grasps of some seeds; one that is closed is not stepped any more."""

    gel = "left"
    direction = (0.8, -1.4, 0.6)

    def __init__(
        self, parameters: ClassificationParameters, seeds: Sequence[int], device: str | None = None
    ) -> None:
        self.parameters = parameters
        starts = [_drawn(parameters, seed) for seed in seeds]
        wanted = np.array([int(start["part"]) for start in starts])
        frames = np.array([_part_frame(start) for start in starts])
        gels, mounts = gels_of(parameters.gel)
        bodies, outermost = [], np.zeros((len(seeds), 2))
        for kind in np.unique(wanted):
            shape = PARTS[parameters.parts[kind]]()
            envs = np.flatnonzero(wanted == kind)
            present = Presence(environments=tuple(int(env) for env in envs))
            name, friction = parameters.parts[kind], parameters.part_friction
            bodies.append(KinematicBody(shape, friction, name=name, surface=present))
            x = np.einsum("ej,vj->ev", frames[envs, 0, :3], shape.vertices_m)
            outermost[envs] = np.stack([-x.min(axis=1), x.max(axis=1)], axis=1)
        self._parts = np.tile(frames[:, None], (1, len(bodies), 1, 1))
        self._half = outermost + 1e-3 * parameters.policy.gap_mm
        """Of the faces of both gels from the middle [m], [env, 2]."""
        self._stop = 1e-3 * np.array([start["depth_mm"] for start in starts])
        scene = Scene(gels, [*mounts, *bodies], len(seeds), TimeStepping(True))
        config = contact_config(parameters.contact, parameters.dt_s)
        super().__init__(parameters, seeds, starts, scene, config, self._targets(), device)
        size = parameters.maps
        self.grid = PixelGrid(size.width_px, size.height_px, size.mm_per_px, size.mm_per_px)
        mesh = gels[0].nodal_mesh
        self._signals = [
            SignalTactile(
                mesh,
                self.grid,
                env_count=len(seeds),
                first_node=self.model.bodies[self.model.body_id(side)].nodes[0],
                device=self.model.device,
            )
            for side in SIDES
        ]
        self._force = np.zeros(2)
        """Of the part on each gel in environment 0 [N]."""
        self._rest = self._heights()
        self.depths_m = np.zeros_like(self._rest)
        """Depth maps of both gels, [env, 2, height_px, width_px], rows along the gel's y."""

    def _targets(self) -> np.ndarray:
        hands = np.tile(np.eye(4), (len(self._half), 1, 1))
        mounts = mounts_of(hands, self._half)
        return pose_of(np.concatenate([mounts, self._parts], axis=1))

    def _heights(self) -> np.ndarray:
        """Of both faces in their own frames [m], [env, 2, height_px, width_px]."""
        import warp as wp

        found = []
        for side, signal in enumerate(self._signals):
            signal.update(self.state.positions, wp.clone(self.state.poses[:, side]))
            found.append(signal.height_m.numpy().astype(np.float64))
        return np.stack(found, axis=1)

    def _deepest(self) -> np.ndarray:
        return self.depths_m.max(axis=(2, 3))

    def control(self) -> Control:
        closing = self.running[:, None] & (self._deepest() < self._stop[:, None])
        self._half = self._half - np.where(closing, 1e-3 * self.parameters.policy.step_mm, 0.0)
        return Control(target_poses=self._targets())

    def measure(self) -> None:
        depths = np.nan_to_num(self._rest - self._heights())
        self.depths_m[self.running] = depths[self.running]
        part = self.parameters.parts[int(self.starts[0]["part"])]
        self._force[:] = [np.linalg.norm(self.force_on(side, part)[0]) for side in SIDES]
        self.running &= (self._deepest() < self._stop[:, None]).any(axis=1)

    def judge(self, env: int) -> tuple[str, dict[str, float]]:
        left, right = (float(1e3 * depth) for depth in self._deepest()[env])
        figures = {"left_depth_mm": left, "right_depth_mm": right}
        if min(left, right) < 1e3 * self._stop[env]:
            return f"the gels had not closed: {left:.2f} and {right:.2f} mm deep", figures
        return "", figures

    def trials(self) -> list[TaskTrial]:
        felt = self.depths_m.astype(np.float32)
        return [replace(t, felt=felt[env]) for env, t in enumerate(super().trials())]

    def forces(self) -> dict[str, float]:
        return {f"{side} gel": float(self._force[i]) for i, side in enumerate(SIDES)}

    @classmethod
    def conclude(
        cls, parameters: TaskParameters, trials: list[TaskTrial], device: str | None
    ) -> list[TaskTrial]:
        """What the networks say of the grasps that closed."""
        assert isinstance(parameters, ClassificationParameters)
        good = [i for i, trial in enumerate(trials) if trial.success]
        learner, count = parameters.learner, len(parameters.parts)
        region = np.array([_region(trials[i].start, learner.regions) for i in good], dtype=int)
        truth = np.array([int(trials[i].start["part"]) for i in good], dtype=int)
        if len(set(region.tolist())) < 2 or len(set(truth.tolist())) < count:
            few = "too few grasps to learn from: each part and two regions of turns are needed"
            return [replace(t, success=False, cause=t.cause or few) for t in trials]
        maps = np.array([trials[i].felt for i in good])
        at_random = folds(len(good), learner.regions)
        predicted = judge_by_folds(maps, truth, region, learner, device)
        predicted_at_random = judge_by_folds(maps, truth, at_random, learner, device)
        near, near_at_random = nearest(maps, truth, region), nearest(maps, truth, at_random)
        concluded = list(trials)
        for row, i in enumerate(good):
            figures = trials[i].figures | {
                "predicted": float(predicted[row]),
                "right": float(predicted[row] == truth[row]),
                "right_at_random": float(predicted_at_random[row] == truth[row]),
                "nearest_right": float(near[row] == truth[row]),
                "nearest_right_at_random": float(near_at_random[row] == truth[row]),
            }
            wrong = f"taken for a {parameters.parts[predicted[row]]}"
            right = predicted[row] == truth[row]
            concluded[i] = replace(
                trials[i], success=bool(right), cause="" if right else wrong, figures=figures
            )
        return concluded


def _drawn(parameters: ClassificationParameters, seed: int) -> dict[str, float]:
    """Of a seed: parts take turns, all else is drawn."""
    half = parameters.start
    found = draw(
        seed,
        {
            "turn_deg": half.turn_deg,
            "depth_mm": 1.0,
            "face": 1.5,
            "tilt_y_deg": half.tilt_deg,
            "tilt_z_deg": half.tilt_deg,
            "y_mm": half.place_mm,
            "z_mm": half.place_mm,
        },
    )
    low, high = half.depth_mm
    found["depth_mm"] = low + (high - low) * (found["depth_mm"] + 1) / 2
    found["face"] = float(min(int(found["face"] + 1.5), 2))
    return {**found, "part": float(seed % len(parameters.parts))}


def _part_frame(start: dict[str, float]) -> np.ndarray:
    """Where a part is, [4, 4]: its axis number ``face`` along x, then tilted, turned and moved."""
    axes = np.roll(np.eye(3), int(start["face"]), axis=1)
    spin = np.eye(3)
    for axis, angle in (("tilt_y_deg", 1), ("tilt_z_deg", 2), ("turn_deg", 0)):
        spin = _about(angle, np.radians(start[axis])) @ spin
    frame = np.eye(4)
    frame[:3, :3] = spin @ axes
    frame[1:3, 3] = [1e-3 * start["y_mm"], 1e-3 * start["z_mm"]]
    return frame


def _about(axis: int, angle: float) -> np.ndarray:
    pose = np.zeros(7)
    pose[3 + axis], pose[6] = np.sin(angle / 2), np.cos(angle / 2)
    return matrix_of(pose)[:3, :3]


def _region(start: dict[str, float], regions: int) -> int:
    return min(int((start["turn_deg"] % 180.0) / 180.0 * regions), regions - 1)
