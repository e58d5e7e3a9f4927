# SPDX-License-Identifier: Apache-2.0
"""``State``: what a step changes, as device arrays ``[env_count, ...]``."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.bodies.joints import ROW_COUNT
from taccel_lab.bodies.primitives import checked_pose
from taccel_lab.errors import InputError
from taccel_lab.model import Model
from taccel_lab.model.embedding import control_positions, embed_vertices, rotate
from taccel_lab.model.env_rows import (
    copy_rows,
    device_mask,
    given_array,
    on_device,
    zero_rows,
)
from taccel_lab.model.kinematics import place_at_start
from taccel_lab.model.sameness import same_bodies
from taccel_lab.model.turns import in_turn
from taccel_lab.summary import Summary
from taccel_lab.typed import typed

IDENTITY_POSE = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


@dataclass
class StepHistory:
    """The step before the last one; BDF2 needs it, implicit Euler does not."""

    positions: wp.array
    """Node positions one step earlier [m], vec3d, shape [env_count, node_count]."""
    velocities: wp.array
    """Node velocities one step earlier [m/s], vec3d, shape [env_count, node_count]."""
    dts: wp.array
    """Length of the last step [s], float64, shape [env_count]; 0 where there was none, and after an
    impact."""
    forces: wp.array
    """Sum of the magnitudes of the contact forces on the nodes of each body at the end of the last
    step [N], float64, shape [env_count, body_count]."""

    @classmethod
    def empty(cls, model: Model) -> StepHistory:
        """No past in any environment."""
        shape = (model.env_count, model.node_count)
        return cls(
            positions=wp.zeros(shape, dtype=wp.vec3d, device=model.device),
            velocities=wp.zeros(shape, dtype=wp.vec3d, device=model.device),
            dts=wp.zeros(model.env_count, dtype=wp.float64, device=model.device),
            forces=wp.zeros(
                (model.env_count, len(model.bodies)), dtype=wp.float64, device=model.device
            ),
        )

    def arrays(self) -> list[wp.array]:
        """All of it."""
        return [self.positions, self.velocities, self.dts, self.forces]

    def forget(self, mask: np.ndarray) -> None:
        """Leave the environments of ``mask`` (bool, [env_count]) without a past."""
        zero_rows(device_mask(mask, len(self.dts), self.dts.device), self.dts)


@dataclass
class JointState:
    """What joints carry from one step to the next."""

    targets: wp.array
    """Targets of the drives [rad, m, rad/s or m/s], float64, [env_count, joint_count]; set them at
    any time, here or by ``Control.joint_targets``. A step goes by what they are when it begins."""
    coordinates: wp.array
    """Angle [rad], whole turns included, or slide [m], float64, shape [env_count, joint_count]."""
    multipliers: wp.array
    """Forces that keep joints closed [N; N m for the angle], float64, [env_count, joint_count,
    ROW_COUNT]; where Newton starts, so that a mechanism under steady load needs no second round."""

    @classmethod
    def at_rest(cls, model: Model) -> JointState:
        """No forces, no turns, drives at the targets that the scene says."""
        motors = [joint.motor for joint in model.scene.joints]
        shape = (model.env_count, len(motors))
        targets = np.zeros(shape)
        for index, motor in enumerate(motors):
            if motor is not None:
                targets[:, index] = motor.target
        return cls(
            targets=wp.array(targets, dtype=wp.float64, device=model.device),
            coordinates=wp.zeros(shape, dtype=wp.float64, device=model.device),
            multipliers=wp.zeros((*shape, ROW_COUNT), dtype=wp.float64, device=model.device),
        )

    def arrays(self) -> list[wp.array]:
        """All of it."""
        return [self.targets, self.coordinates, self.multipliers]


@dataclass(repr=False)
class State(Summary):
    """All that the next step depends on, but for the model and its targets and loads. A copy is a
    checkpoint, which any solver of the model goes on from.

    A step reads it when it begins and writes it when it is over: whatever interrupts one, each
    environment is where its step began or where it ended. Who writes positions or poses into it
    says so by ``moved``.
    """

    positions: wp.array
    """Node positions [m], vec3d, shape [env_count, node_count]."""
    velocities: wp.array
    """Node velocities [m/s], vec3d, shape [env_count, node_count]; in quasi-static scenes the mean
    of the last step, which only decides where the next one starts to search."""
    poses: wp.array
    """world_from_body of the kinematic bodies, transformd, shape [env_count, kinematic_count]."""
    history: StepHistory | None = None
    """The step before the last one; in scenes that are stepped by BDF2 only."""
    joints: JointState | None = None
    """State of the joints, in scenes with joints only."""
    external_forces: wp.array | None = None
    """Forces on nodes [N], vec3d, shape [env_count, node_count]: on soft nodes and on vertices of
    affine bodies; they stay until changed. See ``load``."""
    wrenches: wp.array | None = None
    """Force [N] and torque about the centre of mass [N m] on each affine body in world axes, vec3d,
    shape [env_count, affine_count, 2]. See ``load``."""
    viscous_inverses: wp.array | None = None
    """Inverse of the viscous deformation, F_v^-1, of each Maxwell branch at each point of its
    elements, mat33d, shape [env_count, point_count]; groups of ``Model.elastic`` one after the
    other, and in them branches. In scenes with such materials only."""
    unsearched: wp.array | None = None
    """1 where bodies overlap, or where nobody has searched for such yet, int32, [env_count];
    everywhere when None."""
    searched: bool = False
    """Whether the first is what it says everywhere; else the next step searches."""
    model: Model | None = None
    """The model that it was made for: it is read as one of that or of the same bodies. None where
    nobody said."""
    writers: dict[str, Any] = field(default_factory=dict, init=False, compare=False)
    """The solver that has steps of it at work, see ``solvers.one_writer``."""

    def summary(self) -> tuple[str, list[tuple[str, str]]]:
        """Return what ``repr`` shows."""
        count, nodes = self.positions.shape
        rows = [("nodes", str(nodes)), ("kinematic", str(self.poses.shape[1]))]
        return f"state on {self.positions.device}, env_count = {count}", rows

    def motion(self) -> list[wp.array]:
        """Return what steps change."""
        found = [self.positions, self.velocities, self.poses]
        if self.history is not None:
            found += self.history.arrays()
        if self.joints is not None:
            found += self.joints.arrays()[1:]
        if self.viscous_inverses is not None:
            found.append(self.viscous_inverses)
        return found

    def asked(self) -> list[wp.array]:
        """Return what steps read and leave as it is, as far as it is there."""
        joints = None if self.joints is None else self.joints.targets
        found = (joints, self.external_forces, self.wrenches)
        return [array for array in found if array is not None]

    @in_turn
    def copy(self) -> State:
        """Return an independent copy."""

        names = [one.name for one in fields(self) if one.init]
        return State(**{name: _each(wp.clone, getattr(self, name)) for name in names})

    @in_turn
    def shared(self) -> State:
        """Return a copy to ``restore`` from, in which what is the same in all environments has one
        row."""

        def rows(array: wp.array) -> wp.array:
            value = array.numpy()
            same = array.size > 0 and (value == value[:1]).all()
            return wp.clone(array[:1] if same else array)

        names = ("positions", "velocities", "poses", "history", "joints", "viscous_inverses")
        parts = {name: _each(rows, getattr(self, name)) for name in names}
        return State(**parts, model=self.model)

    @in_turn
    def restore(self, other: State, mask: np.ndarray | wp.array | None = None) -> None:
        """Take motion and poses of the environments of ``mask`` (bool, or int32 on the device,
        [env_count]), of all when None, from another state, ``shared`` or not; loads and targets of
        drives stay.

        Raises:
            InputError: The other state is that of another model.
        """
        mine, theirs = self.motion(), other.motion()
        shapes = [array.shape[1:] for array in mine]
        known = {len(self.positions), 1}
        if shapes != [array.shape[1:] for array in theirs] or not known.issuperset(
            array.shape[0] for array in theirs
        ):
            raise InputError(
                f"a state of {_size(other)} cannot be restored into one of {_size(self)}: both "
                "have to be of the same model"
            )
        if self.model and other.model and not same_bodies(self.model, other.model):
            raise _of_another_model()
        if mask is not None:
            mask = device_mask(mask, len(self.positions), self.positions.device)
        for target, source in zip(mine, theirs, strict=True):
            if source is not target:
                copy_rows(mask, source, target)
        if self.unsearched is not None:
            if other.unsearched is None:
                self.moved(mask)
            else:
                copy_rows(mask, other.unsearched, self.unsearched)
        self.searched = False

    @in_turn
    def moved(self, mask: np.ndarray | wp.array | None = None) -> None:
        """Mark positions or poses as written by hand, in the environments of ``mask`` (bool, or
        int32 on the device, [env_count]), in all when None. The next step searches them for bodies
        that overlap."""
        self.searched = False
        if self.unsearched is None or mask is None:
            self.unsearched = None
            return
        mask = device_mask(mask, len(self.unsearched), self.unsearched.device)
        copy_rows(mask, mask, self.unsearched)

    def complete(self, model: Model) -> None:
        """Add what steps of a model need and the state does not have: no past, joints at rest,
        no viscous strain."""
        if self.history is None and model.scene.time.bdf2:
            self.history = StepHistory.empty(model)
        if self.joints is None and model.scene.joints:
            self.joints = JointState.at_rest(model)
        if self.viscous_inverses is None and model.viscous_point_count:
            self.viscous_inverses = no_viscous_strain(model)
        if self.unsearched is None:
            self.unsearched = wp.full(model.env_count, 1, dtype=wp.int32, device=model.device)
            self.searched = False

    def __reduce__(self) -> Any:
        raise InputError(
            "a State is on a device and cannot be pickled: keep state.positions.numpy() and the "
            "like, and write them into initial_state(model) again"
        )

    def loads(self, model: Model) -> tuple[wp.array, wp.array]:
        """Return ``external_forces`` and ``wrenches``; made, all zero, when there were none."""
        if self.external_forces is None:
            self.external_forces = wp.zeros_like(self.positions)
        if self.wrenches is None:
            shape = (model.env_count, model.affine.count, 2)
            self.wrenches = wp.zeros(shape, dtype=wp.vec3d, device=model.device)
        return self.external_forces, self.wrenches

    @in_turn
    def load(
        self, model: Model, forces: Any = None, wrenches: Any = None, mask: Any = None
    ) -> None:
        """Set forces on nodes [N], [env_count, node_count, 3], and wrenches on affine bodies,
        [env_count, affine_count, 2, 3]; None leaves them as they are.

        ``mask``: environments, bool, or int32 on the device, [env_count]; all when None.

        Arrays of the host are checked, those of the model's device are read where they are.
        """
        shapes = (self.positions.shape, (model.env_count, model.affine.count, 2))
        given = [
            None if value is None else given_array(value, name, shape, wp.vec3d, model.device)
            for value, name, shape in zip(
                (forces, wrenches), ("forces", "wrenches"), shapes, strict=True
            )
        ]
        if mask is not None:
            mask = device_mask(mask, model.env_count, model.device)
        for array, value in zip(self.loads(model), given, strict=True):
            if value is not None:
                copy_rows(mask, value, array)


def _each(change: Callable[[wp.array], wp.array], part: Any) -> Any:
    """A part of a state with each of its arrays changed; a copy of what has none."""
    if isinstance(part, wp.array):
        return change(part)
    if isinstance(part, StepHistory | JointState):
        return type(part)(*map(change, part.arrays()))
    return part if isinstance(part, Model) else copy(part)


def no_viscous_strain(model: Model) -> wp.array:
    """``State.viscous_inverses`` of gels that were never strained: identities."""
    shape = (model.env_count, model.viscous_point_count, 3, 3)
    return wp.array(np.broadcast_to(np.eye(3), shape), dtype=wp.mat33d, device=model.device)


def as_poses(model: Model, poses: np.ndarray) -> np.ndarray:
    """Check poses (x, y, z [m], quaternion x, y, z, w), shape [env_count, kinematic_count, 7]."""
    return checked_pose("poses", poses, (model.env_count, len(model.kinematic), 7))


def poses_array(model: Model, poses: Any) -> wp.array:
    """Poses of the kinematic bodies as transformd, [env_count, kinematic_count], sharing memory.

    ``poses``: [env_count, kinematic_count, 7], x, y, z [m] and quaternion x, y, z, w. Those of
    numpy are checked, and stay on the host. What is on the model's device already, such as a torch
    tensor of float64, is not checked for its values: that would wait for the device.
    """
    if not on_device(poses):
        poses = as_poses(model, poses)
    shape = (model.env_count, len(model.kinematic))
    return given_array(poses, "poses", shape, wp.transformd, model.device)


def check_state(state: State, model: Model) -> None:
    """Refuse a state of another model, and arrays of another device or shape, which a kernel would
    read as they are."""
    nodes = (model.env_count, model.node_count)
    for name, array, shape in (
        ("positions", state.positions, nodes),
        ("velocities", state.velocities, nodes),
        ("poses", state.poses, (model.env_count, len(model.kinematic))),
    ):
        if array.device != model.device:
            raise InputError(
                f"{name} of the state are on {array.device}, the solver is on {model.device}: "
                f"make the array with device={str(model.device)!r}"
            )
        if array.shape != shape:
            raise InputError(f"{name} of the state have shape {array.shape}, expected {shape}")
    inverses, count = state.viscous_inverses, model.viscous_point_count
    if inverses is not None and inverses.shape != (model.env_count, count):
        raise InputError(
            f"viscous_inverses of the state have shape {inverses.shape}, expected "
            f"{(model.env_count, count)}: the state is one of gels of another material"
        )
    if state.model is not None and not same_bodies(state.model, model):
        raise _of_another_model()
    # Looked at once: steps on a model that was built the same compare no arrays of the device.
    state.model = model


def _of_another_model() -> InputError:
    return InputError(
        "the state is one of another model, whose bodies or materials are others: give a state "
        "that initial_state made for this model, or a copy of it"
    )


@typed
@in_turn
def initial_state(model: Model, poses: np.ndarray | None = None) -> State:
    """Place all bodies at their initial poses and velocities, gels in their rest shape.

    ``poses``: of the kinematic bodies, [env_count, kinematic_count, 7]; at the origin when None.
    There are no forces or wrenches.
    """
    env_count, kinematic_count = model.env_count, len(model.kinematic)
    if poses is None:
        poses = np.tile(IDENTITY_POSE, (env_count, kinematic_count, 1))
    positions, velocities = _initial_motion(model)

    def nodal(value: np.ndarray) -> wp.array:
        return wp.array(value, dtype=wp.vec3d, device=model.device)

    state = State(
        positions=nodal(positions),
        velocities=nodal(velocities),
        poses=wp.clone(poses_array(model, poses), device=model.device),
        model=model,
    )
    state.complete(model)
    place_at_start(model, state.poses, state.positions)
    embed_vertices(model, state.positions)
    embed_vertices(model, state.velocities)
    return state


def _size(state: State) -> str:
    envs, nodes = state.positions.shape
    parts = [(state.poses.shape[1], "kinematic bodies")]
    if state.joints is not None:
        parts.append((state.joints.targets.shape[1], "joints"))
    if state.history is not None:
        parts.append((1, "step before the last"))
    if state.viscous_inverses is not None:
        parts.append((state.viscous_inverses.shape[1], "points of Maxwell branches"))
    more = ", ".join(f"{count} {name}" for count, name in parts)
    return f"{envs} environments, {nodes} nodes, {more}"


def _initial_motion(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities of soft and control nodes; the others, and gels on a mount, follow
    from these and from the poses."""
    scene = model.scene
    rest = model.rest_positions.numpy()
    positions = np.repeat(rest, model.env_count // model.rest_count, axis=0)
    velocities = np.zeros_like(positions)
    for index, body in enumerate(scene.soft_bodies):
        nodes = model.bodies[index].node_slice
        start = (scene.carrier(body) or body).initial_pose
        if start is not None:
            pose = np.atleast_2d(start)[:, None]
            positions[:, nodes] = rotate(pose[..., 3:], positions[:, nodes]) + pose[..., :3]
        velocities[:, nodes] = body.initial_velocity_m_s
    velocities[:, model.free_index.numpy() < 0] = 0.0
    for index, body in enumerate(scene.affine_bodies):
        first = model.affine.first_control + 4 * index
        pose = IDENTITY_POSE if body.initial_pose is None else body.initial_pose
        control = control_positions(model.affine.properties[index], np.atleast_2d(pose))
        positions[:, first : first + 4] = control
        spin = np.cross(np.array(body.initial_spin_rad_s), control[:, 1:])
        velocities[:, first] = body.initial_velocity_m_s
        velocities[:, first + 1 : first + 4] = spin
        absent = model.present.numpy()[:, len(scene.soft_bodies) + index] == 0
        velocities[absent, first : first + 4] = 0.0
        for gel, soft in enumerate(scene.soft_bodies):
            if soft.mount == body.name:
                nodes = model.bodies[gel].node_slice
                arms = positions[:, nodes] - control[:, :1]
                turning = np.cross(np.array(body.initial_spin_rad_s), arms)
                velocities[:, nodes] = np.array(body.initial_velocity_m_s) + turning
    return positions, velocities
