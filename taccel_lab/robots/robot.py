# SPDX-License-Identifier: Apache-2.0
"""``Robot``: links and joints, where they are, and what of them stands in a scene."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from taccel_lab.bodies.bodies import check_pose
from taccel_lab.bodies.joints import JointKind
from taccel_lab.errors import InputError
from taccel_lab.guards import require_shape
from taccel_lab.robots.description import Link, RobotJoint, check_names, listed
from taccel_lab.robots.inverse_kinematics import IKOptions, IKResult, solve
from taccel_lab.robots.kinematics import Kinematics
from taccel_lab.robots.mounts import (
    GEL_SURFACE,
    TOUCHING_SURFACES,
    CarriedBody,
    Mount,
    carried_bodies,
    make_mount,
)
from taccel_lab.robots.self_contact import (
    LinkPart,
    Pairs,
    checked_pairs,
    on_surfaces,
    overlapping,
    require_apart,
    surfaces,
)
from taccel_lab.robots.shapes import MeshShape, SurfaceShape
from taccel_lab.robots.transforms import Array, Constants, is_tensor, matrix_of, namespace, pose_of
from taccel_lab.scene import KinematicBody, Scene, SoftBody, Surface

if TYPE_CHECKING:
    import torch

    from taccel_lab.profile import SensorProfile

IDENTITY_POSE = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
LIMIT_SLACK = 1e-9
"""How far beyond a limit a coordinate may be [rad or m]: rounding."""


@dataclass(frozen=True, eq=False)
class Robot:
    """A tree of links. Never changes: what adds or removes something returns another robot.

    Poses are position [m] and quaternion x, y, z, w. Coordinates ``q`` [rad or m] are those of the
    joints that move by themselves, in the order of ``dof_names``; one row, or a row for each
    environment. Of coordinates that are a tensor of torch, poses and Jacobians are tensors on its
    device, float64, that autograd follows.
    """

    name: str
    links: tuple[Link, ...]
    joints: tuple[RobotJoint, ...]
    world_from_base: np.ndarray = field(default_factory=IDENTITY_POSE.copy)
    """Where the base stands, [7]."""
    mounts: tuple[Mount, ...] = ()
    link_friction: float | None = None
    """Coulomb friction of the links; None leaves it to what they touch."""
    apart: Pairs | None = None
    """Links and gels that do not touch though the robot touches itself; None: it does not."""

    def __post_init__(self) -> None:
        _ = self.tree  # Refuses what is no tree.
        pose = check_pose(np.asarray(self.world_from_base, dtype=np.float64), "the robot's base")
        assert pose is not None
        require_shape("world_from_base", pose, (7,))
        object.__setattr__(self, "world_from_base", pose)

    # What it is ----------------------------------------------------------------------------------

    @cached_property
    def tree(self) -> Kinematics:
        """Its kinematics in the frame of the base."""
        return Kinematics(self.links, self.joints)

    @property
    def base(self) -> str:
        """Name of the link that the others stand on."""
        return self.tree.base

    @property
    def link_names(self) -> list[str]:
        """Names of the links, in the order of ``forward_kinematics``."""
        return [link.name for link in self.links]

    @property
    def dof_names(self) -> list[str]:
        """Names of the joints that move by themselves, in the order of ``q``."""
        return list(self.tree.dof_names)

    @property
    def dof(self) -> int:
        """Number of coordinates."""
        return len(self.tree.dof_names)

    @property
    def limits(self) -> np.ndarray:
        """Smallest and largest coordinates [rad or m], infinite where there are none, [dof, 2]."""
        return self.tree.limits.copy()

    @property
    def rest_q(self) -> np.ndarray:
        """Coordinates as near to 0 as the limits let them, [dof]."""
        return np.clip(np.zeros(self.dof), *self.tree.limits.T)

    def link_id(self, link: str) -> int:
        """Index of a link; InputError for one that is not there."""
        if link not in self.link_names:
            raise InputError(
                f"robot {self.name!r} has no link {link!r}; there are {listed(self.link_names)}"
            )
        return self.link_names.index(link)

    # Where its links are -------------------------------------------------------------------------

    @overload
    def forward_kinematics(self, q: torch.Tensor, *, check: bool = True) -> torch.Tensor: ...
    @overload
    def forward_kinematics(self, q: Any, *, check: bool = True) -> np.ndarray: ...
    def forward_kinematics(self, q: Any, *, check: bool = True) -> Any:
        """world_from_link of all links for coordinates [n, dof], shape [n, link, 7].

        Limits are not looked at. Raises InputError for another shape, or what is not finite; this
        is not looked at without ``check``, as it waits for the device of a tensor.
        """
        return self._poses(self._rows(q, check), self.link_names)

    @overload
    def link_poses(self, link: str, q: torch.Tensor, *, check: bool = True) -> torch.Tensor: ...
    @overload
    def link_poses(self, link: str, q: Any, *, check: bool = True) -> np.ndarray: ...
    def link_poses(self, link: str, q: Any, *, check: bool = True) -> Any:
        """world_from_link of one link, [n, 7]; as ``forward_kinematics``, without the others."""
        self.link_id(link)
        return self._poses(self._rows(q, check), [link])[:, 0]

    def _poses(self, rows: Array, links: list[str]) -> Array:
        return pose_of(self.tree.frames(rows, links, self._constants.beside(rows)["world"]))

    @overload
    def jacobian(self, link: str, q: torch.Tensor, *, check: bool = True) -> torch.Tensor: ...
    @overload
    def jacobian(self, link: str, q: Any, *, check: bool = True) -> np.ndarray: ...
    def jacobian(self, link: str, q: Any, *, check: bool = True) -> Any:
        """Velocity of a link's origin [m] and its angular velocity [rad], in world axes, by the
        rates of the coordinates: the geometric Jacobian, [n, 6, dof]; ``check`` as of
        ``forward_kinematics``."""
        self.link_id(link)
        rows = self._rows(q, check)
        frames = self.tree.along(link, rows)
        local = self.tree.jacobian(link, frames, frames[:, -1, :3, 3])
        turn = self._constants.beside(rows)["world"][:3, :3]
        return namespace(rows).concat([turn @ local[:, :3], turn @ local[:, 3:]], axis=1)

    def inverse_kinematics(
        self, link: str, poses: Any, start: Any = None, options: IKOptions | None = None
    ) -> IKResult:
        """Coordinates within the limits that bring a link to poses.

        Args:
            link: Its name.
            poses: world_from_link, [7] or [n, 7].
            start: Coordinates to start from, [dof] or [n, dof]; ``rest_q`` when None.
            options: Tolerances and attempts.

        Returns:
            The coordinates, and for each pose whether they reach it: one out of reach is no error.
        """
        self.link_id(link)
        wanted = check_pose(np.atleast_2d(np.asarray(poses, dtype=np.float64)), "the link")
        assert wanted is not None
        begin = self._rows(self.rest_q if start is None else start, True)
        if len(begin) not in (1, len(wanted)):
            raise InputError(f"start has {len(begin)} rows, expected {len(wanted)} or one")
        targets = np.linalg.inv(matrix_of(self.world_from_base)) @ matrix_of(wanted)
        begin = np.broadcast_to(begin, (len(wanted), self.dof))
        return solve(self.tree, link, targets, begin, options or IKOptions())

    # Other robots --------------------------------------------------------------------------------

    def placed(self, world_from_base: Any) -> Robot:
        """Robot with its base elsewhere, [7]."""
        return replace(self, world_from_base=world_from_base)

    def attach(self, link: str, other: Robot, link_from_base: Any, prefix: str = "") -> Robot:
        """Robot with another robot fixed to a link; names of its links and joints get a prefix. It
        does not touch itself until asked to.

        Args:
            link: What carries it.
            other: The other robot; where its base stands is forgotten.
            link_from_base: Pose of its base in the link, [7].
            prefix: "left/" makes of its link "tip" a "left/tip".
        """
        self.link_id(link)
        pose = _one_pose(link_from_base, f"{other.name!r} on {link!r}")
        joints = [
            replace(
                joint,
                name=prefix + joint.name,
                parent=prefix + joint.parent,
                child=prefix + joint.child,
                mimic=joint.mimic and replace(joint.mimic, joint=prefix + joint.mimic.joint),
            )
            for joint in other.joints
        ]
        bond = RobotJoint(
            f"{link} to {prefix}{other.base}",
            JointKind.FIXED,
            link,
            prefix + other.base,
            matrix_of(pose),
            np.array([0.0, 0.0, 1.0]),
        )
        carried = replace(
            self,
            links=(*self.links, *(replace(part, name=prefix + part.name) for part in other.links)),
            joints=(*self.joints, bond, *joints),
            apart=None,
        )
        for mount in other.mounts:
            carried = carried.mount(
                prefix + mount.link,
                replace(mount.gel, mount=None),
                pose_of(mount.link_from_gel),
                prefix + mount.gel.name,
            )
        return carried

    def part(self, link: str) -> Robot:
        """A link and what it carries, as a robot whose base it is; one that does not
        touch itself until asked to.

        Raises InputError where one of its joints mimics another one that is not carried.
        """
        self.link_id(link)
        kept = [name for name in self.link_names if self._carries(link, name)]
        return replace(
            self,
            links=tuple(part for part in self.links if part.name in kept),
            joints=tuple(j for j in self.joints if j.child in kept and j.child != link),
            mounts=tuple(mount for mount in self.mounts if mount.link in kept),
            world_from_base=IDENTITY_POSE,
            apart=None,
        )

    def _carries(self, link: str, other: str) -> bool:
        path = self.tree.path_to(other)
        return other == link or any(self.joints[i].parent == link for i in path)

    def touching(self, links: Iterable[str]) -> Robot:
        """Robot with the collision shapes of these links alone: the others pass through
        everything."""
        kept = list(links)
        for link in kept:
            self.link_id(link)
        return replace(
            self,
            links=tuple(
                link if link.name in kept else replace(link, shapes=()) for link in self.links
            ),
        )

    def touching_itself(self, apart: Iterable[tuple[str, str]] = (), at: Any = None) -> Robot:
        """Robot with gels that touch its links, and links that touch one another where they move
        freely.

        A gel touches all links but those that are one with what carries it. Links that a joint
        connects, or fixed joints do, do not touch. Links that are prescribed do not touch either:
        they go where they are commanded, and through each other. Of two robots that touch
        themselves each touches the other.

        Args:
            apart: Names of links and gels that do not touch, in pairs, beside these.
            at: Coordinates at which nothing may overlap, [dof]; ``rest_q`` when None. Gels that are
                mounted later are not looked at.

        Raises:
            InputError: A gel and a link, or two gels, that overlap there: all pairs are named.
        """
        known = [*self.link_names, *(mount.gel.name for mount in self.mounts)]
        made = replace(self, apart=checked_pairs(apart, known, self.name))
        if made.mounts:
            scene = Scene(made.soft_bodies(), made.kinematic_bodies())
            poses = made.targets(self.rest_q if at is None else at)
            require_apart(overlapping(scene, poses, made.parts(made._shaped)), self.name)
        return made

    def with_hulls(self, links: Iterable[str] | None = None) -> Robot:
        """Robot with the convex hulls of the meshes of these links, or of all when None."""
        chosen = self.link_names if links is None else list(links)
        for link in chosen:
            self.link_id(link)
        return replace(
            self, links=tuple(_hulls(link) if link.name in chosen else link for link in self.links)
        )

    # In a scene ----------------------------------------------------------------------------------

    def mount(
        self, link: str, gel: SensorProfile | SoftBody, pose: Any = IDENTITY_POSE, name: str = ""
    ) -> Robot:
        """Robot with a gel on a link, whose bonded nodes follow the link exactly.

        Args:
            link: What carries it.
            gel: A sensor, whose mesh, material and friction the gel has; or a gel in its own frame,
                for another mesh or element.
            pose: link_from_gel, [7]; the gel frame has z out of the contact face.
            name: Of the soft body; "gel of" the link when empty.
        """
        self.link_id(link)
        name = name or f"gel of {link}"
        made = make_mount(self.name, link, gel, _one_pose(pose, f"the gel on {link!r}"), name)
        check_names("gels", [mount.gel.name for mount in (*self.mounts, made)])
        return replace(self, mounts=(*self.mounts, made))

    def soft_bodies(self) -> list[SoftBody]:
        """Its gels, for ``Scene(soft_bodies=)``."""
        return self._on_surfaces([mount.gel for mount in self.mounts])

    def kinematic_bodies(self) -> list[KinematicBody]:
        """Frames of its gels and shapes of its links, for ``Scene(kinematic_bodies=)``.

        Raises InputError for a collision mesh that cannot be read or touched, and for a shape whose
        size no body may have.
        """
        return self._on_surfaces([carried.body for carried in self._carried])

    def _on_surfaces(self, bodies: list[Any]) -> list[Any]:
        if self.apart is None:
            return bodies
        return on_surfaces(bodies, self.surfaces(self._shaped))

    def surfaces(self, links: Mapping[str, str]) -> dict[str, Surface]:
        """Surfaces of its gels and links in a scene where it touches itself, by body.

        ``links``: of each body that is a link's shape its link. Gels of a surface of their own keep
        it.
        """
        parts = self.parts(links)
        return surfaces(parts, self.link_names, self.joints, self.apart or (), TOUCHING_SURFACES)

    def parts(self, links: Mapping[str, str]) -> list[LinkPart]:
        """Its gels and links in a scene; ``links`` as of ``surfaces``."""
        gels = [mount for mount in self.mounts if mount.gel.surface == GEL_SURFACE]
        return [
            *(LinkPart(mount.gel.name, mount.gel.name, mount.link, True) for mount in gels),
            *(LinkPart(body, link, link, False) for body, link in links.items()),
        ]

    @property
    def _shaped(self) -> dict[str, str]:
        carried = [item for item in self._carried if item.body.shape is not None]
        return {item.body.name: item.link for item in carried}

    @overload
    def targets(self, q: torch.Tensor, *, check: bool = True) -> torch.Tensor: ...
    @overload
    def targets(self, q: Any, *, check: bool = True) -> np.ndarray: ...
    def targets(self, q: Any, *, check: bool = True) -> Any:
        """Poses of ``kinematic_bodies`` for coordinates [n, dof], shape [n, body, 7]: what a step
        takes as ``Control.target_poses``, a row an environment.

        Raises InputError for what is not finite, and coordinates out of the limits, also of joints
        that mimic others. Without ``check`` neither is looked at, as that waits for the device of a
        tensor: keep them within ``limits`` then.
        """
        rows = self._rows(q, check)
        if check:
            self._check_limits(rows)
        frames = self.tree.frames(rows, self._carriers, self._constants.beside(rows)["world"])
        return pose_of(frames @ self._offsets.beside(rows)["link_from_body"])

    def _check_limits(self, rows: Array) -> None:
        low, high = self._constants.beside(rows)["limits"]
        beyond = (rows < low - LIMIT_SLACK) | (rows > high + LIMIT_SLACK)
        if bool(beyond.any()):
            env, i = (int(index[0]) for index in namespace(rows).where(beyond))
            raise InputError(
                f"coordinate {float(rows[env, i]):g} of joint {self.dof_names[i]!r} in row {env} "
                f"is out of its limits [{float(low[i]):g}, {float(high[i]):g}]"
            )

    @cached_property
    def _carried(self) -> list[CarriedBody]:
        return carried_bodies(self.name, self.links, self.mounts, self.link_friction)

    @cached_property
    def _carriers(self) -> list[str]:
        return [carried.link for carried in self._carried]

    @cached_property
    def _constants(self) -> Constants:
        return Constants({"world": matrix_of(self.world_from_base), "limits": self.tree.limits.T})

    @cached_property
    def _offsets(self) -> Constants:
        """Places of the bodies in the links that carry them, [body, 4, 4]."""
        offsets = [carried.link_from_body for carried in self._carried]
        return Constants({"link_from_body": np.array(offsets).reshape(-1, 4, 4)})

    def _rows(self, q: Any, check: bool) -> Array:
        """Coordinates [n, dof], float64."""
        xp = namespace(q)
        given = q.to(xp.float64) if is_tensor(q) else np.asarray(q, dtype=np.float64)
        rows = given if given.ndim == 2 else given.reshape(1, -1)
        if given.ndim not in (1, 2) or rows.shape[1] != self.dof:
            raise InputError(
                f"coordinates of {self.name!r} must have shape [{self.dof}] or [n, {self.dof}] "
                f"({listed(self.dof_names)}), got {tuple(given.shape)}"
            )
        if check and not bool(xp.isfinite(rows).all()):
            raise InputError(f"coordinates of {self.name!r} hold NaN or infinite values")
        return rows


def _one_pose(value: Any, whose: str) -> np.ndarray:
    pose = check_pose(np.asarray(value, dtype=np.float64), whose)
    if pose is None or pose.ndim != 1:
        raise InputError(f"pose of {whose} must have shape [7], got {np.shape(value)}")
    return pose


def _hulls(link: Link) -> Link:
    shapes = tuple(
        replace(item, shape=replace(item.shape, hull=True))
        if isinstance(item.shape, (MeshShape, SurfaceShape))
        else item
        for item in link.shapes
    )
    return replace(link, shapes=shapes)
