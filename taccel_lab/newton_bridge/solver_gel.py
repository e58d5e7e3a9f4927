# SPDX-License-Identifier: Apache-2.0
"""``SolverGel``: a solver of newton's with our gels inside.

Newton's bodies move by one of newton's own solvers, the gels by ours: in double precision inside,
in single precision where poses come in and wrenches and poses go out. Two couplings:

- ``LAGGED``: newton's solver moves all bodies; gels follow them, and what they push is applied as
  ``body_f`` in the next step. That is a spring taken explicitly: a body of mass m on gels of
  stiffness k diverges in steps above 2 sqrt(m / k), and needs a few times shorter ones.
- ``INSIDE``: bodies that move freely are unknowns of our step, which is implicit, and their poses
  and velocities are written back. What carries gels still feels them one step late.

The wrench on a body that carries a gel is that of contact on the gel: a gel has weight and inertia
of its own here, which belong into the mass of newton's body as far as they matter.

A gel stands on a frame that moves with its body, as on a robot's link. What it touches is a body of
newton's that is prescribed here (a kinematic body for each of its shapes), or, if it moves freely
and shall be inside, an affine body; and the endless planes of the world.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import newton  # pyright: ignore[reportMissingImports]
import numpy as np

from taccel_lab.errors import InputError, SimulationError
from taccel_lab.model.embedding import control_positions, embed_vertices
from taccel_lab.newton_bridge.importing import world_planes
from taccel_lab.newton_bridge.newton_model import NewtonModel, rigid_motion, unit_poses
from taccel_lab.newton_bridge.shapes import affine_body, collision_shapes, touching_shapes
from taccel_lab.outputs import Outputs
from taccel_lab.robots.mounts import Mount, make_mount
from taccel_lab.robots.transforms import matrix_of, pose_of
from taccel_lab.scene import AffineBody, KinematicBody, Scene, SoftBody, TimeStepping
from taccel_lab.solvers import Control, SolverConfig, SolverIPC, StepReport
from taccel_lab.state import State, initial_state

if TYPE_CHECKING:
    from taccel_lab.profile import SensorProfile


@dataclass(frozen=True)
class BodyGel:
    """A gel on a body of newton's."""

    body: str
    """Name or label of the body."""
    gel: SensorProfile | SoftBody
    """A sensor, or a gel in its own frame."""
    pose: Any = field(default_factory=lambda: np.array([0.0, 0, 0, 0, 0, 0, 1]))
    """body_from_gel, [7]."""
    name: str = ""
    """Name of the soft body; "gel of" the body when empty."""


class GelScene:
    """The bodies of ours that stand for newton's, and which is which."""

    def __init__(
        self,
        source: NewtonModel,
        gels: Sequence[BodyGel],
        touched: Sequence[str],
        inside: bool,
        dt_s: float,
    ) -> None:
        """
        Args:
            source: The model; each of its worlds is an environment.
            gels: On which bodies.
            touched: Names or labels of the bodies that gels may touch.
            inside: Whether those that move freely are unknowns of the scene.
            dt_s: Length of a step; each may have its own.

        Raises:
            InputError: No gel, an unknown body, one that carries a gel and is touched, a shape that
                cannot be taken over.
        """
        if not gels:
            raise InputError("at least one gel is needed")
        self.source = source
        self.mounts: list[Mount] = []
        """Gels on their frames, whose ``link`` is the name of newton's body."""
        self.frames: list[tuple[int, np.ndarray]] = []
        """Newton's body that each kinematic body moves with, and body_from_frame [4, 4]."""
        self.affine: list[int] = []
        """Newton's body of each affine body."""
        kinematic: list[KinematicBody] = []
        starts = source.body_q.reshape(source.world_count, -1, 7)
        free = source.free_bodies() if inside else []
        others = [source.body_id(label) for label in touched]
        for item in gels:
            carrier = source.body_id(item.body)
            if carrier in others:
                raise InputError(f"body {item.body!r} carries a gel: it cannot be touched, too")
            pose = np.asarray(item.pose, dtype=np.float64)
            name = item.name or f"gel of {item.body}"
            mount = make_mount("newton", source.bodies[carrier], item.gel, pose, name)
            self.mounts.append(mount)
            self.frames.append((carrier, mount.link_from_gel))
            kinematic.append(KinematicBody(None, name=str(mount.gel.mount)))
        affine: list[AffineBody] = []
        for body in others:
            if body in free and not source.is_kinematic(body):
                self.affine.append(body)
                affine.append(affine_body(source, body, starts[:, body]))
                continue
            rows = touching_shapes(source, body)
            for row, shape in zip(rows, collision_shapes(source, body), strict=True):
                surface, offset = shape.surface()
                friction = float(source.array("shape_material_mu")[row])
                name = source.model.shape_label[row]
                kinematic.append(KinematicBody(surface, friction, name=name))
                self.frames.append((body, offset))
        x, y, z = source.array("gravity")[-1].tolist()
        self.scene = Scene(
            [mount.gel for mount in self.mounts],
            kinematic,
            source.world_count,
            affine_bodies=affine,
            planes=world_planes(source),
            time=TimeStepping(quasi_static=False, dt_s=dt_s, gravity_m_s2=(x, y, z)),
        )

    def carried(self) -> list[int]:
        """Newton's body, of a world, that each of our bodies is, or rides on, in the order of their
        ids; -1 for planes."""
        soft = [body for body, _ in self.frames[: len(self.mounts)]]
        kinematic = [body for body, _ in self.frames]
        return [*soft, *self.affine, *kinematic, *(-1 for _ in self.scene.planes)]

    def targets(self, body_q: np.ndarray) -> np.ndarray:
        """Poses of the kinematic bodies, [world, frame, 7], of newton's bodies [world, body, 7]."""
        places = matrix_of(body_q[:, [body for body, _ in self.frames]])
        offsets = np.stack([offset for _, offset in self.frames])
        return pose_of(places @ offsets)


class Coupling(StrEnum):
    """How bodies that gels touch and newton's solver share a step."""

    LAGGED = "lagged"
    INSIDE = "inside"


class SolverGel(newton.solvers.SolverBase):
    """Steps a newton model with gels on its bodies; ``step`` as of any solver of newton's."""

    def __init__(
        self,
        model: Any,
        gels: Sequence[BodyGel],
        touched: Sequence[str],
        *,
        rigid: Any = None,
        coupling: Coupling = Coupling.INSIDE,
        config: SolverConfig | None = None,
    ) -> None:
        """
        Args:
            model: ``newton.Model``; worlds are alike (``ModelBuilder.replicate``), and each is an
                environment of ours.
            gels: On which bodies of a world.
            touched: Names or labels of the bodies of a world that gels may touch.
            rigid: Newton's solver of the bodies, of the same model. Without one bodies stay where
                the state has them, and gels follow whatever moves them between steps.
            coupling: Of bodies that move freely and are touched.
            config: Of our solver.

        Raises:
            InputError: A body that is not there, shapes that cannot be taken over, worlds that
                are not alike.
        """
        source = NewtonModel(model, worlds=True)
        super().__init__(model)
        if coupling not in list(Coupling):
            raise InputError(f"coupling must be {' or '.join(Coupling)}, got {coupling!r}")
        inside = coupling == Coupling.INSIDE
        self.rigid = rigid
        self.gel_scene = GelScene(source, gels, touched, inside, 0.01)
        self.gel_model = self.gel_scene.scene.finalize(model.device)
        """Model of our bodies: gels, bodies inside, frames."""
        self.gel_solver = SolverIPC(self.gel_model, config)
        self.outputs = Outputs(self.gel_solver)
        """Outputs of the gels after each step."""
        self.wrenches = np.zeros((model.body_count, 6))
        """Loads of the latest step: force [N] and torque about the centre of mass [N m] that gels
        and what they touch put on newton's bodies, world axes, float64, [body, 6]. Of bodies inside
        too, where they have acted already."""
        self.gel_state: State | None = None
        """State of our bodies; made from newton's by the first step, or ``reset``."""
        self.report: StepReport | None = None
        """Report of the latest step."""
        self._worlds = source.world_count
        self._centers = source.array("body_com").reshape(-1, 3)
        self._written: tuple[np.ndarray, np.ndarray] | None = None
        self._free_rows = [
            [_free_joint(source, w * source.body_count + body) for w in range(self._worlds)]
            for body in self.gel_scene.affine
        ]

    def step(
        self,
        state_in: Any,
        state_out: Any,
        control: Any,
        contacts: Any,
        dt: float,
        *,
        observables: Any = None,
    ) -> None:
        """Bodies from ``state_in`` to ``state_out``, and the gels with them, in ``dt`` [s].

        Raises SimulationError where the gels' step fails.
        """
        self.validate_observables(observables, contacts)
        if self.gel_state is None:
            self.reset(state_in)
        assert self.gel_state is not None
        scene = self.gel_scene
        loads = self._by_world(state_in.body_f.numpy().astype(np.float64))
        if self.rigid is None:
            _keep_bodies(state_in, state_out)
        else:
            self._step_rigid(state_in, state_out, control, contacts, dt, loads)
        if scene.affine:
            self._follow_bodies_inside(state_in)
        body_q = self._by_world(unit_poses(state_out.body_q.numpy()))
        wanted = Control(target_poses=scene.targets(body_q), dt_s=float(dt))
        if scene.affine:
            wanted.wrenches = loads[:, scene.affine].reshape(self._worlds, -1, 2, 3)
        self.report = self.gel_solver.step(self.gel_state, wanted)
        if not self.report.converged.all():
            raise SimulationError(f"the gels' step failed: {self.report.describe()}")
        if scene.affine:
            self._write_back(state_out)
        self._harvest(unit_poses(state_out.body_q.numpy()))

    def reset(self, state: Any, world_mask: Any = None, flags: Any = None) -> None:
        """Gels at rest on their bodies, bodies inside where ``state`` has them, no wrenches.

        ``world_mask``: newton's, bool, [world_count + 1]; all worlds when None.
        """
        targets = self.gel_scene.targets(self._by_world(unit_poses(state.body_q.numpy())))
        if self.gel_state is None:
            self.gel_state = initial_state(self.gel_model, targets)
            world_mask = None
        who = np.ones(self._worlds, dtype=bool)
        if world_mask is not None:
            who = np.array(world_mask.numpy(), dtype=bool)[: self._worlds]
        self.gel_solver.reset(self.gel_state, who, targets)
        self._by_world(self.wrenches)[who] = 0.0
        if self.gel_scene.affine:
            self._put_bodies_inside(state, who)

    def _by_world(self, rows: np.ndarray) -> np.ndarray:
        """Rows of newton's bodies, [body, k], as [world, body, k]: a view."""
        return rows.reshape(self._worlds, -1, rows.shape[-1])

    def _step_rigid(
        self, state_in: Any, state_out: Any, control: Any, contacts: Any, dt: float, loads: Any
    ) -> None:
        """Newton's solver, with the wrenches of the last step on the bodies that it moves."""
        pushed = loads + self._by_world(self.wrenches)
        pushed[:, self.gel_scene.affine] = loads[:, self.gel_scene.affine]
        state_in.body_f.assign(pushed.reshape(-1, 6).astype(np.float32))
        self.rigid.step(state_in, state_out, control, contacts, dt)
        state_in.body_f.assign(loads.reshape(-1, 6).astype(np.float32))

    def _follow_bodies_inside(self, state: Any) -> None:
        """Put bodies inside where newton's state has them, if somebody else has moved them: what
        was written there in single precision is known here in double."""
        moved = np.ones(self._worlds, dtype=bool)
        if self._written is not None:
            same = [
                (now == before).all(axis=(1, 2))
                for now, before in zip(self._inside(state), self._written, strict=True)
            ]
            moved = ~(same[0] & same[1])
        if moved.any():
            self._put_bodies_inside(state, moved)

    def _inside(self, state: Any) -> tuple[np.ndarray, np.ndarray]:
        """Poses and rates of bodies inside in newton's state, [world, body, 7] and [.., 6]."""
        rows = self.gel_scene.affine
        arrays = (state.body_q, state.body_qd)
        poses, rates = (self._by_world(array.numpy())[:, rows] for array in arrays)
        return poses, rates

    def _put_bodies_inside(self, state: Any, who: np.ndarray) -> None:
        """Bodies inside go where newton's state has them, in the worlds of ``who`` (bool)."""
        assert self.gel_state is not None
        positions = self.gel_state.positions.numpy()
        velocities = self.gel_state.velocities.numpy()
        found = self._inside(state)
        poses, rates = unit_poses(found[0]), found[1].astype(np.float64)
        for k, solid in enumerate(self.gel_model.affine.properties):
            first = self.gel_model.affine.first_control + 4 * k
            for world in np.flatnonzero(who):
                control = control_positions(solid, poses[world, k])
                positions[world, first : first + 4] = control
                velocities[world, first] = rates[world, k, :3]
                turned = np.cross(rates[world, k, 3:], control[1:])
                velocities[world, first + 1 : first + 4] = turned
        for array, value in (
            (self.gel_state.positions, positions),
            (self.gel_state.velocities, velocities),
        ):
            array.assign(value)
            embed_vertices(self.gel_model, array)
        self.gel_state.moved(who)
        if self._written is not None:
            for now, before in zip(found, self._written, strict=True):
                before[who] = now[who]

    def _write_back(self, state_out: Any) -> None:
        """Poses and velocities of bodies inside into newton's state."""
        assert self.gel_state is not None
        body_q, body_qd = state_out.body_q.numpy(), state_out.body_qd.numpy()
        positions, velocities = self.gel_state.positions.numpy(), self.gel_state.velocities.numpy()
        solids = self.gel_model.affine.properties
        for k, (body, solid) in enumerate(zip(self.gel_scene.affine, solids, strict=True)):
            first = self.gel_model.affine.first_control + 4 * k
            y, v = positions[:, first : first + 4], velocities[:, first : first + 4]
            motion = rigid_motion(y, v, solid)
            self._by_world(body_q)[:, body], self._by_world(body_qd)[:, body] = motion
        state_out.body_q.assign(body_q)
        state_out.body_qd.assign(body_qd)
        self._written = self._inside(state_out)
        if state_out.joint_q is not None and state_out.joint_q.size:
            joint_q, joint_qd = state_out.joint_q.numpy(), state_out.joint_qd.numpy()
            for body, rows in zip(self.gel_scene.affine, self._free_rows, strict=True):
                for world, row in enumerate(rows):
                    if row is not None:
                        joint_q[row[0] :][:7] = self._by_world(body_q)[world, body]
                        joint_qd[row[1] :][:6] = self._by_world(body_qd)[world, body]
            state_out.joint_q.assign(joint_q)
            state_out.joint_qd.assign(joint_qd)

    def _harvest(self, body_q: np.ndarray) -> None:
        """Sum the wrenches of contact and friction on what stands for each of newton's bodies."""
        assert self.gel_state is not None
        self.outputs.update(self.gel_state)
        totals = self.outputs.contact_wrenches().totals().numpy()
        totals = totals + self.outputs.friction_wrenches().totals().numpy()
        self.wrenches[:] = 0.0
        for k, body in enumerate(self.gel_scene.carried()):
            if body >= 0:
                self._by_world(self.wrenches)[:, body] += totals[:, k]
        turns = matrix_of(body_q)
        centers = np.einsum("bij,bj->bi", turns[:, :3, :3], self._centers) + turns[:, :3, 3]
        self.wrenches[:, 3:] -= np.cross(centers, self.wrenches[:, :3])


def _keep_bodies(state_in: Any, state_out: Any) -> None:
    """Bodies stay where they are."""
    for name in ("body_q", "body_qd", "joint_q", "joint_qd"):
        array = getattr(state_in, name)
        if array is not None:
            getattr(state_out, name).assign(array)


def _free_joint(source: NewtonModel, body: int) -> tuple[int, int] | None:
    """Where the coordinates and the rates of a free body's joint begin; None for one without.

    Raises InputError where the coordinates are not the body's pose.
    """
    for row in np.flatnonzero(source.array("joint_child") == body):
        for name in ("joint_X_p", "joint_X_c"):
            if not np.array_equal(source.array(name)[row], [0, 0, 0, 0, 0, 0, 1]):
                raise InputError(
                    f"the free joint of body {source.model.body_label[body]!r} has its own "
                    "frames: a body inside needs one without"
                )
        return int(source.array("joint_q_start")[row]), int(source.array("joint_qd_start")[row])
    return None
