# SPDX-License-Identifier: Apache-2.0
"""Hands of tasks: a robot of the catalogue, gels on its links, and the ways on which they close.

A finger is a group of joints that close together along a path of joint coordinates: a synergy. How
far a finger has gone is the way of its first gel's middle, so that all fingers of all hands close
at a speed in millimetres a second.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from taccel_lab.errors import InputError
from taccel_lab.files.strict_model import Number, StrictModel
from taccel_lab.geometry import TetMesh
from taccel_lab.robots import Robot, named, on_seat
from taccel_lab.robots.transforms import matrix_of, pose_of
from taccel_lab.tasks.bodies import pad_body, pad_mesh
from taccel_lab.tasks.parameters import PadParameters, Positive

SAMPLES = 200
"""Of a path, along which the way of a gel is measured."""

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
    """Those that touch objects; other links of the robot pass through them."""

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
    """Of its base in the world: x, y, z, w."""
    middle_mm: Triple
    """In its base: what it closes about."""
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
