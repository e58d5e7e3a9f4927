# SPDX-License-Identifier: Apache-2.0
"""Where the links of a tree are for coordinates of its joints, and how they move with these.

Coordinates and frames are arrays of numpy or tensors of torch on any device, float64; what comes
out is of the kind that went in. Joints of one depth of the tree are computed together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from taccel_lab.bodies.joints import JointKind
from taccel_lab.robots.description import Link, RobotJoint, base_of, coordinate_map, limits_of
from taccel_lab.robots.transforms import Array, Constants, namespace


@dataclass(frozen=True)
class _Plan:
    """What has to be computed for some links."""

    bounds: tuple[tuple[int, int], ...]
    """First joint of each depth of the tree, and the one after its last."""
    constants: Constants
    """Constants of the joints that carry the links, by depth: what ``_motion`` gives, factors and
    offsets of their coordinates, which of them turn; where in the depth before each one's parent
    is; and where the links are among the base and the joints' children."""


class Kinematics:
    """A checked tree of links; raises InputError where links and joints make none."""

    def __init__(self, links: tuple[Link, ...], joints: tuple[RobotJoint, ...]) -> None:
        self.base = base_of(links, joints)
        """Name of the link that stands still."""
        self.factors, self.offsets, self.dof_names = coordinate_map(joints)
        self.limits = limits_of(joints, self.factors, self.offsets, self.dof_names)
        """Smallest and largest coordinates [rad or m], [dof, 2]."""
        self._joints = joints
        self._carrier = {joint.child: i for i, joint in enumerate(joints)}
        self._plans: dict[tuple[str, ...], _Plan] = {}
        self._axes: dict[str, Constants] = {}

    def path_to(self, link: str) -> list[int]:
        """Indices of the joints from the base to a link."""
        path = []
        while link in self._carrier:
            path.append(self._carrier[link])
            link = self._joints[path[-1]].parent
        return path[::-1]

    def frames(self, q: Array, links: Sequence[str], world_from_base: Array) -> Array:
        """world_from_link of some links at coordinates [n, dof], shape [n, link, 4, 4]; what does
        not carry them is not computed. ``world_from_base``: [4, 4] or [n, 4, 4]."""
        xp, plan = namespace(q), self._plan(tuple(links))
        of = plan.constants.beside(q)
        value = q @ of["factors"].T + of["offsets"]
        # 1 - cos by the half angle: small turns keep their digits.
        first = xp.where(of["turns"], xp.sin(value), value)[..., None, None]
        second = (2 * xp.sin(value / 2) ** 2)[..., None, None]
        moved = of["still"] + first * of["first"] + second * of["second"]
        known = [xp.broadcast_to(world_from_base, (len(q), 4, 4))[:, None]]
        for k, (begin, end) in enumerate(plan.bounds):
            known.append(known[-1][:, of[f"parents {k}"]] @ moved[:, begin:end])
        return xp.concat(known, axis=1)[:, of["order"]]

    def along(self, link: str, q: Array) -> Array:
        """base_from_child of the joints from the base to a link, shape [n, joint + 1, 4, 4]; the
        first one is the base, the last one the link."""
        children = [self._joints[i].child for i in self.path_to(link)]
        return self.frames(
            q, [self.base, *children], namespace(q).eye(4, dtype=q.dtype, device=q.device)
        )

    def jacobian(self, link: str, frames: Array, point: Array) -> Array:
        """Velocity and angular velocity of a link by the rates of the coordinates, [n, 6, dof].

        Geometric: column of a turning joint (a x (p - o), a), of a sliding one (a, 0), with its
        axis a and origin o in the base's frame [Siciliano et al., Robotics, eq. 3.30].

        Args:
            link: Its name.
            frames: ``along`` of the link.
            point: p, of the link in the base's frame [m], [n, 3].
        """
        xp = namespace(frames)
        if link not in self._axes:
            self._axes[link] = self._axes_to(link)
        of = self._axes[link].beside(frames)
        axis = (frames[:, 1:, :3, :3] @ of["axes"][..., None])[..., 0]
        turning = axis * of["turns"]
        arm = point[:, None] - frames[:, 1:, :3, 3]
        shift = xp.linalg.cross(turning, arm) + axis * of["slides"]
        return xp.concat([shift, turning], axis=-1).swapaxes(1, 2) @ of["factors"]

    def length_m(self, link: str) -> float:
        """Length of the way from the base to a link over the joints' frames [m]."""
        steps = [self._joints[i].parent_from_joint[:3, 3] for i in self.path_to(link)]
        return float(sum(np.linalg.norm(step) for step in steps))

    def _plan(self, links: tuple[str, ...]) -> _Plan:
        if links not in self._plans:
            self._plans[links] = self._made_plan(links)
        return self._plans[links]

    def _made_plan(self, links: tuple[str, ...]) -> _Plan:
        paths = [self.path_to(link) for link in links]
        levels = [
            list(dict.fromkeys(path[k] for path in paths if len(path) > k))
            for k in range(max(map(len, paths), default=0))
        ]
        joints = [i for level in levels for i in level]
        kinds = [self._joints[i].kind for i in joints]
        motions = np.array([_motion(self._joints[i]) for i in joints]).reshape(-1, 3, 4, 4)
        found = {self.base: 0} | {self._joints[i].child: 1 + k for k, i in enumerate(joints)}
        arrays = {
            "still": motions[:, 0],
            "first": motions[:, 1],
            "second": motions[:, 2],
            "factors": self.factors[joints],
            "offsets": self.offsets[joints],
            "turns": np.array([kind is JointKind.REVOLUTE for kind in kinds], dtype=bool),
            "order": np.array([found[link] for link in links], dtype=np.int64),
        }
        before = [self.base]
        for k, level in enumerate(levels):
            parents = [before.index(self._joints[i].parent) for i in level]
            arrays[f"parents {k}"] = np.array(parents, dtype=np.int64)
            before = [self._joints[i].child for i in level]
        ends = np.cumsum([0, *map(len, levels)]).tolist()
        return _Plan(tuple(pairwise(ends)), Constants(arrays))

    def _axes_to(self, link: str) -> Constants:
        path = self.path_to(link)
        kinds = [self._joints[i].kind for i in path]

        def of_kind(kind: JointKind) -> np.ndarray:
            return np.array([float(found is kind) for found in kinds]).reshape(-1, 1)

        return Constants(
            {
                "axes": np.array([self._joints[i].axis for i in path]).reshape(-1, 3),
                "turns": of_kind(JointKind.REVOLUTE),
                "slides": of_kind(JointKind.PRISMATIC),
                "factors": self.factors[path],
            }
        )


def _motion(joint: RobotJoint) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """parent_from_child as a sum of constant matrices [4, 4]: the first one, the second one times
    the slide or the sine of the angle, the third one times 1 - cosine (Rodrigues' formula)."""
    origin, nothing = joint.parent_from_joint, np.zeros((4, 4))
    if not joint.moves:
        return origin, nothing, nothing
    first = np.zeros((4, 4))
    if joint.kind is JointKind.PRISMATIC:
        first[:3, 3] = joint.axis
        return origin, origin @ first, nothing
    x, y, z = joint.axis
    first[:3, :3] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    return origin, origin @ first, origin @ first @ first
