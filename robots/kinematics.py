# SPDX-License-Identifier: Apache-2.0
"""Where the links of a tree are for coordinates of its joints, and how they move with these."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from taccel_lab.bodies.joints import JointKind
from taccel_lab.robots.description import Link, RobotJoint, base_of, coordinate_map, limits_of


class Kinematics:
    """A checked tree of links; raises InputError where links and joints make none."""

    def __init__(self, links: tuple[Link, ...], joints: tuple[RobotJoint, ...]) -> None:
        self.base = base_of(links, joints)
        """Name of the link that stands still."""
        self.factors, self.offsets, self.dof_names = coordinate_map(joints)
        self.limits = limits_of(joints, self.factors, self.offsets, self.dof_names)
        """Smallest and largest coordinates [rad or m], [dof, 2]."""
        self._joints = joints
        self._ids = {link.name: i for i, link in enumerate(links)}
        self._carrier = {joint.child: i for i, joint in enumerate(joints)}
        self._motions = [_motion(joint) for joint in joints]

    def path_to(self, link: str) -> list[int]:
        """Indices of the joints from the base to a link."""
        path = []
        while link in self._carrier:
            path.append(self._carrier[link])
            link = self._joints[path[-1]].parent
        return path[::-1]

    def frames(
        self, q: np.ndarray, links: Sequence[str], world_from_base: np.ndarray
    ) -> np.ndarray:
        """world_from_link of some links at coordinates [n, dof], shape [n, link, 4, 4]; what does
        not carry them is not computed."""
        known = {self.base: np.tile(world_from_base, (len(q), 1, 1))}
        for link in links:
            for i in self.path_to(link):
                joint = self._joints[i]
                if joint.child not in known:
                    known[joint.child] = self._carried(known[joint.parent], i, q)
        result = np.empty((len(q), len(links), 4, 4))
        for k, link in enumerate(links):
            result[:, k] = known[link]
        return result

    def along(self, link: str, q: np.ndarray) -> np.ndarray:
        """base_from_child of the joints from the base to a link, shape [n, joint + 1, 4, 4]; the
        first one is the base, the last one the link."""
        path = self.path_to(link)
        result = np.empty((len(q), len(path) + 1, 4, 4))
        result[:, 0] = np.eye(4)
        for k, i in enumerate(path):
            result[:, k + 1] = self._carried(result[:, k], i, q)
        return result

    def jacobian(self, link: str, frames: np.ndarray, point: np.ndarray) -> np.ndarray:
        """Velocity and angular velocity of a link by the rates of the coordinates, [n, 6, dof].

        Geometric: column of a turning joint (a x (p - o), a), of a sliding one (a, 0), with its
        axis a and origin o in the base's frame [Siciliano et al., Robotics, eq. 3.30].

        Args:
            link: Its name.
            frames: ``along`` of the link.
            point: p, of the link in the base's frame [m], [n, 3].
        """
        result = np.zeros((len(frames), 6, self.factors.shape[1]))
        for k, i in enumerate(self.path_to(link)):
            joint = self._joints[i]
            if not joint.moves:
                continue
            axis = frames[:, k + 1, :3, :3] @ joint.axis
            column = np.zeros((len(frames), 6))
            if joint.kind is JointKind.PRISMATIC:
                column[:, :3] = axis
            else:
                column[:, :3] = np.cross(axis, point - frames[:, k + 1, :3, 3])
                column[:, 3:] = axis
            result += column[:, :, None] * self.factors[i]
        return result

    def length_m(self, link: str) -> float:
        """Length of the way from the base to a link over the joints' frames [m]."""
        steps = [self._joints[i].parent_from_joint[:3, 3] for i in self.path_to(link)]
        return float(sum(np.linalg.norm(step) for step in steps))

    def _carried(self, frames: np.ndarray, i: int, q: np.ndarray) -> np.ndarray:
        """Frames of a joint's child from those of its parent, [n, 4, 4]."""
        still, first, second = self._motions[i]
        result = frames.reshape(-1, 4) @ still
        if first is not None:
            value = np.repeat(q @ self.factors[i] + self.offsets[i], 4)[:, None]
            flat = frames.reshape(-1, 4)
            if second is None:
                result += value * (flat @ first)
            else:
                # 1 - cos by the half angle: small turns keep their digits.
                result += np.sin(value) * (flat @ first)
                result += 2 * np.sin(value / 2) ** 2 * (flat @ second)
        return result.reshape(-1, 4, 4)


def _motion(joint: RobotJoint) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
    """parent_from_child as a sum of constant matrices [4, 4]: the first one, the second one times
    the slide or the sine of the angle, the third one times 1 - cosine (Rodrigues' formula)."""
    origin = joint.parent_from_joint
    if not joint.moves:
        return origin, None, None
    first = np.zeros((4, 4))
    if joint.kind is JointKind.PRISMATIC:
        first[:3, 3] = joint.axis
        return origin, origin @ first, None
    x, y, z = joint.axis
    first[:3, :3] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    return origin, origin @ first, origin @ first @ first
