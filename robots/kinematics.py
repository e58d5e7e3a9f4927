# SPDX-License-Identifier: Apache-2.0
"""Where the links of a tree are for coordinates of its joints, and how they move with these."""

from __future__ import annotations

import numpy as np

from taccel_lab.bodies.joints import JointKind
from taccel_lab.robots.description import Link, RobotJoint, base_of, coordinate_map, limits_of
from taccel_lab.robots.transforms import turn_about


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
        paths = {name: self.path_to(name) for name in self._ids}
        # A joint comes after those that carry its parent.
        self._order = sorted(range(len(joints)), key=lambda i: len(paths[joints[i].child]))

    def path_to(self, link: str) -> list[int]:
        """Indices of the joints from the base to a link."""
        path = []
        while link in self._carrier:
            path.append(self._carrier[link])
            link = self._joints[path[-1]].parent
        return path[::-1]

    def all_links(self, q: np.ndarray) -> np.ndarray:
        """base_from_link of all links at coordinates [n, dof], shape [n, link, 4, 4]."""
        result = np.empty((len(q), len(self._ids), 4, 4))
        result[:, self._ids[self.base]] = np.eye(4)
        for i in self._order:
            joint = self._joints[i]
            result[:, self._ids[joint.child]] = result[
                :, self._ids[joint.parent]
            ] @ self._parent_from_child(i, q)
        return result

    def along(self, link: str, q: np.ndarray) -> np.ndarray:
        """base_from_child of the joints from the base to a link, shape [n, joint + 1, 4, 4]; the
        first one is the base, the last one the link."""
        path = self.path_to(link)
        result = np.empty((len(q), len(path) + 1, 4, 4))
        result[:, 0] = np.eye(4)
        for k, i in enumerate(path):
            result[:, k + 1] = result[:, k] @ self._parent_from_child(i, q)
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

    def _parent_from_child(self, i: int, q: np.ndarray) -> np.ndarray:
        joint = self._joints[i]
        if not joint.moves:
            return joint.parent_from_joint
        value = q @ self.factors[i] + self.offsets[i]
        motion = np.tile(np.eye(4), (len(q), 1, 1))
        if joint.kind is JointKind.PRISMATIC:
            motion[:, :3, 3] = value[:, None] * joint.axis
        else:
            motion[:, :3, :3] = turn_about(joint.axis, value)
        return joint.parent_from_joint @ motion
