# SPDX-License-Identifier: Apache-2.0
"""Tell mechanical parts apart by what two gels feel when they close on them.

A part stands still between two gels, shown to them with one of its three axes, turned about the
line on which they close, tilted and off the middle. Each gel closes until its own depth map is as
deep as was drawn. A network is taught by the maps of some seeds and judged by those of others: each
seed is judged once, by a network that has seen no grasp of its region of turns (``regions``).

The hand of two like gels is the same after half a turn about any of its axes, so that each grasp
stands for four: both maps turned by half a turn, the gels exchanged, and both (``alike``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from taccel_lab.files.strict_model import StrictModel, Whole
from taccel_lab.geometry import PixelGrid
from taccel_lab.robots.transforms import matrix_of, pose_of
from taccel_lab.scene import KinematicBody, Scene, TimeStepping
from taccel_lab.scene import Surface as Presence
from taccel_lab.signals import SignalTactile
from taccel_lab.solvers import Control
from taccel_lab.tasks.bodies import SIDES, contact_config, gels_of, mounts_of
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
from taccel_lab.tasks.parts import PARTS
from taccel_lab.tasks.result import TaskTrial

if TYPE_CHECKING:
    import torch


SCALE = 1e3
"""Depths go into the network in mm."""
VARIED_RAD, VARIED_PX = 0.35, 3.0
"""Largest turn and motion of the grasps of a lesson."""


class Learner(StrictModel):
    """The network that is taught, and how it is judged."""

    regions: Annotated[Whole, Field(ge=2, le=36)]
    """Equal sectors of the turn, modulo 180 degrees, which the symmetry of the hand makes alike."""
    epochs: Count
    batch: Count
    learning_rate: Positive


def folds(count: int, parts: int) -> np.ndarray:
    """A fold for each of ``count`` grasps, at random, int, as even as can be."""
    return np.random.default_rng(0).permutation(count) % parts


def alike(maps: np.ndarray) -> np.ndarray:
    """The four grasps that each stands for: maps [n, 2, h, w] to [4, n, 2, h, w].

    Gels look at each other: half a turn about the line between them turns both maps, half a turn
    about the vertical exchanges them, as each gel's x points the other way across the hand.
    """
    turned = maps[..., ::-1, ::-1]
    return np.stack([maps, turned, maps[:, ::-1], turned[:, ::-1]])


def nearest(maps: np.ndarray, truth: np.ndarray, fold: np.ndarray) -> np.ndarray:
    """Part of the nearest grasp of other folds, by the squared difference of the maps, [n]."""
    flat = (SCALE * alike(maps)).reshape(4, len(maps), -1)
    predicted = np.empty(len(maps), dtype=int)
    for i in range(len(maps)):
        others = np.flatnonzero(fold != fold[i])
        away = ((flat[:, others] - flat[0, i]) ** 2).sum(axis=2).min(axis=0)
        predicted[i] = truth[others[np.argmin(away)]]
    return predicted


def judge_by_folds(
    maps: np.ndarray,
    truth: np.ndarray,
    fold: np.ndarray,
    learner: Learner,
    device: str | None = None,
) -> np.ndarray:
    """Predict the part of each grasp by a network trained on the other folds.

    Args:
        maps: Depth maps [m], [n, 2, height, width].
        truth: Number of the part, int, [n].
        fold: Of each grasp, int, [n].
        learner: How it is taught.
        device: Where; the CPU when None.
    """
    import torch

    predicted = np.empty(len(maps), dtype=int)
    for number in np.unique(fold):
        held_out = fold == number
        network = taught(maps[~held_out], truth[~held_out], learner, device)
        with torch.no_grad():
            tries = _inputs(maps[held_out], device)
            votes = torch.stack([network(each).softmax(dim=1) for each in tries]).sum(dim=0)
        predicted[held_out] = votes.argmax(dim=1).cpu().numpy()
    return predicted


def taught(
    maps: np.ndarray, truth: np.ndarray, learner: Learner, device: str | None = None
) -> torch.nn.Sequential:
    """A network after its lessons: always the same for the same grasps on the same CPU."""
    import torch
    from torch import nn

    count = int(truth.max()) + 1
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        network = nn.Sequential(
            nn.Conv2d(2, 16, 3, padding=1), nn.BatchNorm2d(16), nn.ReLU(), nn.MaxPool2d(2),
            nn.Conv2d(16, 32, 3, padding=1), nn.BatchNorm2d(32), nn.ReLU(), nn.MaxPool2d(2),
            nn.Conv2d(32, 64, 3, padding=1), nn.BatchNorm2d(64), nn.ReLU(),
            nn.AdaptiveMaxPool2d(2), nn.Flatten(), nn.Dropout(0.3), nn.Linear(256, count),
        ).to(device or "cpu")  # fmt: skip
        inputs, labels = _inputs(maps, device), torch.as_tensor(truth, device=device or "cpu")
        steps = -(-len(maps) // learner.batch)
        adam = torch.optim.Adam(network.parameters(), weight_decay=1e-4)
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            adam, learner.learning_rate, total_steps=learner.epochs * steps
        )
        for _ in range(learner.epochs):
            for chosen in torch.randperm(len(maps)).chunk(steps):
                # Drawn on the host, so that a GPU is taught by the same lessons.
                batch = inputs[torch.randint(4, (len(chosen),)), chosen]
                loss = nn.functional.cross_entropy(network(_varied(batch)), labels[chosen])
                adam.zero_grad()
                loss.backward()
                adam.step()
                schedule.step()
    return network.eval()


def _inputs(maps: np.ndarray, device: str | None) -> torch.Tensor:
    """Inputs of the four grasps that each stands for, [4, n, 2, h, w]."""
    import torch

    return torch.as_tensor((SCALE * alike(maps)).astype(np.float32), device=device or "cpu")


def _varied(batch: torch.Tensor) -> torch.Tensor:
    """Grasps [n, 2, h, w] as of a hand that is turned and moved by a little: the maps of gels that
    look at each other turn the opposite way, and go the opposite way across."""
    import torch
    from torch import nn

    n, _, height, width = batch.shape
    part = 2 * torch.rand(3, n) - 1
    angle = part[0] * VARIED_RAD
    across, up = part[1] * VARIED_PX / (width / 2), part[2] * VARIED_PX / (height / 2)
    shape = height / width
    found = []
    for side, sign in enumerate((1.0, -1.0)):
        c, s = angle.cos(), sign * angle.sin()
        rows = torch.stack([c, -s * shape, sign * across, s / shape, c, up], dim=1)
        size = [n, 1, height, width]
        grid = nn.functional.affine_grid(rows.view(n, 2, 3), size, align_corners=False)
        one = batch[:, side : side + 1]
        found.append(nn.functional.grid_sample(one, grid.to(one), align_corners=False))
    return torch.cat(found, dim=1)


class GraspStart(StrictModel):
    """What is drawn: which axis of the part the gels close on, its turn about that, and half ranges
    of tilts and place; and the range of depths."""

    turn_deg: NotNegative
    tilt_deg: NotNegative
    place_mm: NotNegative
    depth_mm: tuple[Positive, Positive]
    """Range of the depth map's deepest point at which a gel stops."""


class ClosingPolicy(StrictModel):
    """How the gels close."""

    gap_mm: Positive
    """Gap between the part's outermost points and the gels at the start."""
    step_mm: Positive


class DepthMaps(StrictModel):
    """Depth maps of both gels."""

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
        """Distance of the faces of both gels from the middle [m], [env, 2]."""
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
        """Force of the part on each gel in environment 0 [N]."""
        self._rest = self._heights()
        self.depths_m = np.zeros_like(self._rest)
        """Depth maps of both gels, [env, 2, height_px, width_px], rows along the gel's y."""

    def _targets(self) -> np.ndarray:
        hands = np.tile(np.eye(4), (len(self._half), 1, 1))
        mounts = mounts_of(hands, self._half)
        return pose_of(np.concatenate([mounts, self._parts], axis=1))

    def _heights(self) -> np.ndarray:
        """Heights of both faces in their own frames [m], [env, 2, height_px, width_px]."""
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
    """Start of a seed: parts take turns, all else is drawn."""
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
