# SPDX-License-Identifier: Apache-2.0
"""Grasp and lift each of several objects with each of several hands.

A cell is a hand with an object. A hand is a robot of the catalogue with gels on its links. A finger
is a group of joints that close together along a path of joint coordinates: a synergy. How far it
has gone is the way of its first gel's middle, so that all fingers of all hands close at a speed in
millimetres a second. Each finger closes until its own gels push with a force; then the hand rises.
Starts are the same in all cells.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from taccel_lab.errors import InputError
from taccel_lab.files.strict_model import Number, StrictModel
from taccel_lab.geometry import TetMesh
from taccel_lab.robots import Robot, named, on_seat
from taccel_lab.robots.transforms import matrix_of, pose_of
from taccel_lab.scene import Plane, Scene, TimeStepping, TriangleMesh, sphere_mesh
from taccel_lab.solvers import Control
from taccel_lab.tasks.bodies import G, contact_config, free_body, pad_body, pad_mesh
from taccel_lab.tasks.episode import TaskEpisode
from taccel_lab.tasks.lift_record import LiftGoal, LiftRecord
from taccel_lab.tasks.parameters import (
    Contact,
    Count,
    FreeBody,
    NotNegative,
    PadParameters,
    PlanarStart,
    Positive,
    TaskParameters,
)
from taccel_lab.tasks.parts import PARTS

SAMPLES = 200
"""Points of a path, along which the way of a gel is measured."""

Triple = tuple[Number, Number, Number]


class PadSeat(StrictModel):
    """Where a gel sits on a link."""

    link: str
    at_mm: Triple = (0.0, 0.0, 0.0)
    """The middle of the gel's back, in the link."""
    turn_deg: Number = 0.0
    """The gel looks along the link's x axis, turned by so much about its z axis."""

    def pose(self, mesh: TetMesh) -> np.ndarray:
        """link_from_gel, [7]."""
        turn = np.radians(self.turn_deg)
        seat = np.eye(4)
        seat[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
        seat[:3, 3] = 1e-3 * np.array(self.at_mm)
        return pose_of(seat @ matrix_of(on_seat(mesh)))


class Finger(StrictModel):
    """Joints that close together, and the gels and links that this moves."""

    joints: Annotated[tuple[str, ...], Field(min_length=1)]
    path: Annotated[tuple[tuple[Number, ...], ...], Field(min_length=2)]
    """Coordinates of the joints [rad or m] from open to closed; straight lines between."""
    gels: Annotated[tuple[PadSeat, ...], Field(min_length=1)]
    links: tuple[str, ...]
    """Links that touch objects; other links of the robot pass through them."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        if any(len(row) != len(self.joints) for row in self.path):
            raise ValueError(f"each row of path needs {len(self.joints)} coordinates")
        if any(a == b for a, b in pairwise(self.path)):
            raise ValueError("rows of path that follow one another must differ")
        return self


class Hand(StrictModel):
    """A robot with gels."""

    robot: str
    quaternion: tuple[Number, Number, Number, Number]
    """Turn of its base in the world: x, y, z, w."""
    middle_mm: Triple
    """Place in its base that it closes about."""
    lowest_mm: Positive
    """Least height of that over a plane: fingers reach below it."""
    fingers: Annotated[tuple[Finger, ...], Field(min_length=1)]


class HandWithGels:
    """A hand whose gels are ``gel 1``, ``gel 2``, ... in the order of its fingers."""

    def __init__(self, hand: Hand, pad: PadParameters) -> None:
        """Raises InputError for links and joints that the robot has not."""
        mesh = pad_mesh(pad)
        robot = named(hand.robot)
        robot = robot.touching([link for finger in hand.fingers for link in finger.links])
        self.gels: list[str] = []
        """Names of the gels."""
        owner = []
        for i, finger in enumerate(hand.fingers):
            for seat in finger.gels:
                self.gels.append(f"gel {len(self.gels) + 1}")
                owner.append(i)
                body = pad_body(pad, mesh)
                robot = robot.mount(seat.link, body, seat.pose(mesh), self.gels[-1])
        self.robot: Robot = robot
        self.finger_of = np.array(owner)
        """Finger of each gel, int, [gel]."""
        bodies = [body.name for body in robot.kinematic_bodies() if body.shape is not None]
        self.links = [
            [
                body
                for link in finger.links
                for body in bodies
                if body == f"{robot.name}/{link}" or body.startswith(f"{robot.name}/{link}/")
            ]
            for finger in hand.fingers
        ]
        """Names of the bodies of each finger's links."""
        self._hand = hand
        self._paths = [self._path(finger) for finger in hand.fingers]
        self.lengths_m = np.array([travels[-1] for _, travels, _ in self._paths])
        """Way of each finger's first gel from open to closed [m], [finger]."""

    def _path(self, finger: Finger) -> tuple[list[int], np.ndarray, np.ndarray]:
        """Indices of a finger's coordinates; its gel's way [m] and these coordinates, sampled."""
        names = self.robot.dof_names
        for joint in finger.joints:
            if joint not in names:
                raise InputError(
                    f"robot {self.robot.name!r} has no coordinate {joint!r}; "
                    f"there are {', '.join(names)}"
                )
        columns = [names.index(joint) for joint in finger.joints]
        rows = np.array(finger.path)
        part = np.linspace(0, len(rows) - 1, SAMPLES)
        sampled = np.stack(
            [np.interp(part, np.arange(len(rows)), column) for column in rows.T], axis=1
        )
        q = np.tile(self.robot.rest_q, (SAMPLES, 1))
        q[:, columns] = sampled
        seat = finger.gels[0]
        link = matrix_of(self.robot.link_poses(seat.link, q))
        places = link[:, :3, :3] @ (1e-3 * np.array(seat.at_mm)) + link[:, :3, 3]
        steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
        return columns, np.concatenate([[0.0], np.cumsum(steps)]), sampled

    def coordinates(self, travels_m: np.ndarray) -> np.ndarray:
        """Coordinates of the robot, [env, dof], for the ways of its fingers [m], [env, finger]."""
        q = np.tile(self.robot.rest_q, (len(travels_m), 1))
        for i, (columns, travels, sampled) in enumerate(self._paths):
            for column, values in zip(columns, sampled.T, strict=True):
                q[:, column] = np.interp(travels_m[:, i], travels, values)
        return q

    def base(self, height_m: float) -> np.ndarray:
        """Pose of the base, [7], that puts its middle on the vertical through the origin, so high
        and not lower than the hand may."""
        turn = matrix_of(np.array([0.0, 0.0, 0.0, *self._hand.quaternion]))[:3, :3]
        high = max(height_m, 1e-3 * self._hand.lowest_mm)
        place = np.array([0.0, 0.0, high]) - turn @ (1e-3 * np.array(self._hand.middle_mm))
        return np.concatenate([place, self._hand.quaternion])


SHAPES: dict[str, Callable[[], TriangleMesh]] = {
    **PARTS,
    "ball": lambda: sphere_mesh(5e-3, 1e-3),
}
"""Objects by name, before they are scaled; the ball has a radius of 5 mm."""


class ScaledShape(StrictModel):
    """What is grasped, as it stands with its axis upright."""

    shape: str
    scale: Positive

    def mesh(self) -> TriangleMesh:
        """It about the middle of its box [m]."""
        shape = SHAPES[self.shape]()
        return TriangleMesh(self.scale * shape.vertices_m, shape.faces)


class MatrixPolicy(StrictModel):
    """The scripted baseline."""

    reach_mm_s: Positive
    """Speed of each gel until one of its finger's touches the object."""
    close_mm_s: Positive
    """And after."""
    grip_n: Positive
    """A finger stays while all its gels push as hard, or a link of it touches the object: where
    links go as commanded, several would crush it."""
    most_n: Positive
    """Closing ends when all fingers stay or are closed, or a gel pushes as hard."""
    grip_s: Positive
    """And at the latest then."""
    lift_mm_s: Positive
    lift_mm: Positive
    lost_mm: Positive
    """An object that has slipped as far is given up."""


class GraspMatrixParameters(TaskParameters):
    """The file of a matrix of hands and objects."""

    kind: Literal["grasp-matrix"]
    starts: Count
    """Starts of each cell: seed k is start k modulo this, of cell k divided by it, cells row by row
    (all objects of the first hand first); seeds beyond all cells are further starts of them."""
    plane_friction: NotNegative
    gel: PadParameters
    contact: Contact
    body: FreeBody
    """Mass and friction of every object."""
    start: PlanarStart
    """Start of the object, from below the middle of the hand."""
    policy: MatrixPolicy
    goal: LiftGoal
    objects: Annotated[tuple[ScaledShape, ...], Field(min_length=1)]
    hands: Annotated[dict[str, Hand], Field(min_length=1)]

    @model_validator(mode="after")
    def _check(self) -> Self:
        unknown = [thing.shape for thing in self.objects if thing.shape not in SHAPES]
        if unknown:
            raise ValueError(f"no shapes {', '.join(unknown)}; there are {', '.join(SHAPES)}")
        if len({thing.shape for thing in self.objects}) < len(self.objects):
            raise ValueError("objects names one shape twice")
        return self

    def cell(self, seed: int) -> tuple[str, ScaledShape]:
        """Name of the hand, and the object of a seed."""
        row, column = divmod(
            seed // self.starts % (len(self.hands) * len(self.objects)), len(self.objects)
        )
        return list(self.hands)[row], self.objects[column]

    def drawn(self, seed: int) -> int:
        """Number of a seed's start, the same in all cells."""
        rounds = seed // (self.starts * len(self.hands) * len(self.objects))
        return rounds * self.starts + seed % self.starts


class GraspMatrix(TaskEpisode):
    """Grasps of some seeds of one cell; one that is over is not stepped any more."""

    gel = "gel 1"

    def __init__(
        self, parameters: GraspMatrixParameters, seeds: Sequence[int], device: str | None = None
    ) -> None:
        self.parameters = parameters
        name, thing = parameters.cell(seeds[0])
        if any(parameters.cell(seed) != (name, thing) for seed in seeds):
            raise InputError("seeds of one episode must be of one cell")
        self._cell = (name, thing.shape)
        count, policy = len(seeds), parameters.policy
        starts, poses = parameters.start.draw([parameters.drawn(seed) for seed in seeds])
        mesh = thing.mesh()
        half = -float(mesh.vertices_m[:, 2].min())
        # It lies where contact has just begun, and settles while the fingers close.
        poses[:, 2] = half + 1e-3 * parameters.contact.dhat_mm
        self.hand = HandWithGels(parameters.hands[name], parameters.gel)
        robot = self.hand.robot
        self._base = self.hand.base(half)
        scene = Scene(
            robot.soft_bodies(),
            robot.kinematic_bodies(),
            count,
            TimeStepping(False, parameters.dt_s, (0.0, 0.0, -G)),
            affine_bodies=free_body(parameters.body, mesh, "object", poses),
            planes=Plane(friction_coefficient=parameters.plane_friction),
        )
        self._travels = np.zeros((count, len(self.hand.lengths_m)))
        """Travel of the fingers [m], [env, finger]."""
        self._raised = np.zeros(count)
        config = contact_config(parameters.contact)
        super().__init__(parameters, seeds, starts, scene, config, self._targets(), device)
        rest = self.affine_frame()[0][:, 2]
        shape = (count, len(self.hand.gels))
        self._record = LiftRecord(parameters.goal, parameters.dt_s, rest, shape)
        self._touched = np.zeros_like(self._travels, dtype=bool)
        self._stays = np.zeros_like(self._travels, dtype=bool)
        self._grip_steps = round(policy.grip_s / parameters.dt_s)

    def _targets(self) -> np.ndarray:
        base = np.tile(self._base, (len(self._travels), 1))
        base[:, 2] += self._raised
        links = self.hand.robot.targets(self.hand.coordinates(self._travels))
        return pose_of(matrix_of(base)[:, None] @ matrix_of(links))

    def control(self) -> Control:
        policy, dt = self.parameters.policy, self.parameters.dt_s
        speed = np.where(self._touched, policy.close_mm_s, policy.reach_mm_s)
        closer = np.minimum(self._travels + 1e-3 * speed * dt, self.hand.lengths_m)
        gripping = self._record.gripping
        self._travels = np.where(gripping[:, None] | self._stays, self._travels, closer)
        higher = np.minimum(self._raised + 1e-3 * policy.lift_mm_s * dt, 1e-3 * policy.lift_mm)
        self._raised = np.where(gripping, higher, self._raised)
        return Control(target_poses=self._targets())

    def measure(self) -> None:
        policy, record = self.parameters.policy, self._record
        wrenches = self.outputs.contact_wrenches().wrenches.numpy()
        on_object = np.linalg.norm(wrenches[:, self.model.body_id("object"), :, :3], axis=2)

        def by(names: list[str]) -> np.ndarray:
            return on_object[:, [self.model.body_id(name) for name in names]]

        forces = by(self.hand.gels)
        record.grip_n = np.where(self.running[:, None], forces, record.grip_n)
        for i, links in enumerate(self.hand.links):
            own = forces[:, self.hand.finger_of == i]
            self._touched[:, i] |= (own > 0).any(axis=1)
            self._stays[:, i] = (own >= policy.grip_n).all(axis=1) | (by(links) > 0).any(axis=1)
        ended = (self._stays | (self._travels >= self.hand.lengths_m - 1e-12)).all(axis=1)
        ended |= (forces >= policy.most_n).any(axis=1) | (self.taken >= self._grip_steps)
        begins = self.running & ~record.gripping & ended
        record.look(self.running, begins, self.affine_frame()[0], self._raised)
        lost = np.nan_to_num(record.slip_m) > 1e-3 * policy.lost_mm
        self.running &= ~(record.done | lost)

    def judge(self, env: int) -> tuple[str, dict[str, float]]:
        record = self._record
        pushing = int(record.pushing[env].sum())
        figures = record.figures(env) | {"gels_pushing": float(pushing)}
        # What links hold, which push as hard as it takes, is no grasp.
        if pushing < 2:
            return f"never gripped: {pushing} of {len(self.hand.gels)} gels pushed", figures
        missed = record.missed(env)
        return missed and f"slipped: {missed}", figures

    def cell(self, env: int) -> tuple[str, ...]:
        return self._cell

    def forces(self) -> dict[str, float]:
        return {gel: float(self._record.grip_n[0, i]) for i, gel in enumerate(self.hand.gels)}

    @classmethod
    def groups(cls, parameters: TaskParameters, seeds: Sequence[int]) -> list[Sequence[int]]:
        assert isinstance(parameters, GraspMatrixParameters)
        by_cell: dict[tuple[str, str], list[int]] = {}
        for seed in seeds:
            hand, thing = parameters.cell(seed)
            by_cell.setdefault((hand, thing.shape), []).append(seed)
        found: list[Sequence[int]] = []
        for chosen in by_cell.values():
            found += super().groups(parameters, chosen)
        return found
