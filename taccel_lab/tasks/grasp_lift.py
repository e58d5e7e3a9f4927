# SPDX-License-Identifier: Apache-2.0
"""Grasp an object that lies on a plane, and lift it.

Fingers with a gel each close on a free body, stiff or soft, until all push with a force, and
rise. The fingers follow their targets exactly (gels stand on kinematic bodies); the force comes
from closing in small steps until it is measured. The gripper aims at the middle; the body lies
beside it.

Driven fingers are on links with mass, which slide on the base and which drives of limited force
push: these say how hard the gels grip. Once both grip, their targets lie far inside of the object.
The base goes where it is commanded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from taccel_lab.files.strict_model import Number, StrictModel
from taccel_lab.files.tet_file import read_tet_file
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.geometry.tet_mesh import boundary_faces
from taccel_lab.robots import drive
from taccel_lab.robots.transforms import matrix_of, pose_of
from taccel_lab.scene import AffineBody, Element, Material, PositionDrive, Scene, SoftBody
from taccel_lab.solvers import Control
from taccel_lab.tasks.bodies import contact_config, free_body, pad_body, pad_mesh, solid
from taccel_lab.tasks.episode import TaskEpisode
from taccel_lab.tasks.grasp_scene import grasp_scene
from taccel_lab.tasks.lift_record import LiftGoal, LiftRecord
from taccel_lab.tasks.parameters import (
    Contact,
    FreeBody,
    LearningParameters,
    NotNegative,
    PadParameters,
    PlanarStart,
    Positive,
    TaskParameters,
)


class Object(FreeBody):
    """What is grasped."""

    shape: Literal["box", "cylinder", "sphere"]
    size_mm: Annotated[tuple[Positive, ...], Field(min_length=1, max_length=3)]
    """Sides of a box; radius and height of an upright cylinder; radius of a sphere."""

    @property
    def half_height_m(self) -> float:
        """Height of its middle over its lowest point."""
        return -float(solid(self.shape, self.size_mm).vertices_m[:, 2].min())

    def at(self, poses: np.ndarray) -> AffineBody:
        """It at ``poses``, [env, 7]."""
        return free_body(self, solid(self.shape, self.size_mm), "object", poses)


class SoftBox(PadParameters):
    """What is grasped, a box of gel that nothing holds; the stress in it is measured."""

    @property
    def half_height_m(self) -> float:
        """Height of its middle over its lowest point."""
        return 1e-3 * self.size_mm[2] / 2

    def at(self, poses: np.ndarray) -> SoftBody:
        """It, about its middle, at ``poses``, [env, 7]."""
        block = pad_mesh(self)
        middle = (block.nodes_m.min(axis=0) + block.nodes_m.max(axis=0)) / 2
        sides = np.full(len(block.faces), int(Region.SIDE))
        free = TetMesh(block.nodes_m - middle, block.tets, block.faces, sides)
        return replace(pad_body(self, free, "object"), initial_pose=poses)


class SoftShape(StrictModel):
    """What is grasped, a soft body of free form; the stress in it is measured."""

    mesh: Literal["bear"]
    """A mesh of the package, ``NAME.vtk`` beside the files of tasks."""
    young_modulus_pa: Positive
    poisson_ratio: Number
    density_kg_m3: Positive
    friction: NotNegative
    element: Element

    def shape(self) -> TetMesh:
        """It about the mean of its nodes [m]."""
        nodes, tets = read_tet_file(Path(__file__).parent / "files" / f"{self.mesh}.vtk")
        faces = boundary_faces(tets)
        return TetMesh(
            nodes - nodes.mean(axis=0), tets, faces, np.full(len(faces), int(Region.SIDE))
        )

    @property
    def half_height_m(self) -> float:
        """Height of its middle over its lowest point."""
        return -float(self.shape().nodes_m[:, 2].min())

    def at(self, poses: np.ndarray) -> SoftBody:
        """It at ``poses``, [env, 7]."""
        return SoftBody(
            self.shape(),
            Material(self.young_modulus_pa, self.poisson_ratio, self.density_kg_m3),
            name="object",
            friction_coefficient=self.friction,
            element=self.element,
            initial_pose=poses,
        )


class GraspPolicy(StrictModel):
    """The scripted baseline."""

    open_mm: Positive
    """Distance of each gel's seat from the middle, at the start."""
    closed_mm: NotNegative
    """Where closing ends, whatever the force."""
    close_mm_s: Positive
    grip_n: Positive
    """Closing ends when all gels push as hard."""
    lift_mm_s: Positive
    lift_mm: Positive


class GraspLearning(LearningParameters):
    """What a learned policy may do: it moves the joints of the fingers, too."""

    joint_actions: Literal["delta", "target"]
    """What actions of joints mean: a step of the coordinate, or where it is to go."""
    joint_speed: Positive
    """Speed of each joint, of an action of 1 [mm/s or degrees/s]."""
    joint_reach: Positive
    """How far from its start each joint may go [mm or degrees], within its limits."""


class GraspParameters(TaskParameters):
    """What the files of grasps have in common."""

    robot: Literal["parallel_gripper", "three_finger_hand"]
    plane_friction: NotNegative
    gel: PadParameters
    contact: Contact
    start: PlanarStart
    """Start of the object, from the middle between the fingers."""
    policy: GraspPolicy
    goal: LiftGoal


class GraspLiftParameters(GraspParameters):
    """The file of a grasp and lift."""

    kind: Literal["grasp-lift"]
    object: Object
    learning: GraspLearning


class SoftGraspParameters(GraspParameters):
    """The file of a grasp and lift of what is soft."""

    kind: Literal["soft-grasp"]
    object: SoftBox | SoftShape


class GraspLift(TaskEpisode):
    """Grasp and lift of some seeds."""

    def __init__(
        self,
        parameters: GraspLiftParameters | SoftGraspParameters,
        seeds: Sequence[int],
        device: str | None = None,
    ) -> None:
        self.parameters = parameters
        count, policy = len(seeds), parameters.policy
        starts, pose = parameters.start.draw(seeds)
        built = grasp_scene(
            parameters.robot,
            parameters.gel,
            parameters.object.at,
            parameters.object.half_height_m,
            pose,
            closed_m=1e-3 * policy.closed_mm,
            plane_friction=parameters.plane_friction,
            dhat_mm=parameters.contact.dhat_mm,
            dt_s=parameters.dt_s,
        )
        self.robot, self._base = built.robot, built.base
        self._grasper, self._pads = built.grasper, list(built.grasper.pads)
        self.gel = self._pads[0]
        self.seat = np.full(count, 1e-3 * policy.open_mm)
        """Distance of the gels from the middle between them [m]."""
        self.raised = np.zeros(count)
        """How far the gripper has risen [m]."""
        shape = (count, len(self._pads))
        self._record = LiftRecord(parameters.goal, parameters.dt_s, built.rest_height_m, shape)
        config = contact_config(parameters.contact)
        scene = self._in_scene(built.scene)
        super().__init__(parameters, seeds, starts, scene, config, self._targets(), device)
        self._soft = not isinstance(parameters.object, Object)
        self._peak = np.zeros(count)
        """Largest equivalent stress of a soft body so far [Pa]."""

    def _targets(self) -> np.ndarray:
        base = np.tile(self._base, (len(self.seat), 1))
        base[:, 2] += self.raised
        links = self.robot.targets(self._grasper.closed(self.seat))
        return pose_of(matrix_of(base)[:, None] @ matrix_of(links))

    def control(self) -> Control:
        policy, dt = self.parameters.policy, self.parameters.dt_s
        closing = ~self._record.gripping
        closer = np.maximum(self.seat - 1e-3 * policy.close_mm_s * dt, 1e-3 * policy.closed_mm)
        self.seat = np.where(closing, closer, self.seat)
        higher = np.minimum(self.raised + 1e-3 * policy.lift_mm_s * dt, 1e-3 * policy.lift_mm)
        self.raised = np.where(closing, self.raised, higher)
        return Control(target_poses=self._targets())

    def measure(self) -> None:
        policy, record = self.parameters.policy, self._record
        record.grip_n = self.forces_on("object", self._pads, friction=False)
        closed = self.seat <= 1e-3 * policy.closed_mm
        firm = record.grip_n.min(axis=1) >= policy.grip_n
        begins = self.running & ~record.gripping & (firm | closed)
        record.look(self.running, begins, self._middle(), self.raised)

    def _middle(self) -> np.ndarray:
        """Middle of the object [m], [env, 3]; and the stress in it is looked at."""
        if not self._soft:
            return self.affine_frame()[0]
        nodes = self.model.bodies[self.model.body_id("object")].node_slice
        stress = self.outputs.von_mises.numpy()[:, nodes].max(axis=1)
        self._peak[self.running] = np.maximum(self._peak, stress)[self.running]
        return self.state.positions.numpy()[:, nodes].mean(axis=1)

    def _in_scene(self, scene: Scene) -> Scene:
        """The scene with the gripper in it as it is moved."""
        return scene

    def judge(self, env: int) -> tuple[str, dict[str, float]]:
        figures = self._record.figures(env)
        if self._soft:
            figures["peak_stress_kpa"] = float(1e-3 * self._peak[env])
        return self._record.missed(env), figures

    def forces(self) -> dict[str, float]:
        return {pad: float(self._record.grip_n[0, i]) for i, pad in enumerate(self._pads)}


class FingerDrive(StrictModel):
    """Drive of each finger."""

    stiffness_n_m: Positive
    damping_n_s_m: NotNegative
    max_force_n: Positive


class DrivenGraspParameters(GraspParameters):
    """The file of a grasp and lift by drives."""

    kind: Literal["driven-grasp"]
    object: Object
    drive: FingerDrive


class DrivenGraspLift(GraspLift):
    """Grasp and lift of some seeds."""

    parameters: DrivenGraspParameters

    def _in_scene(self, scene: Scene) -> Scene:
        has = self.parameters.drive
        servo = PositionDrive(has.stiffness_n_m, has.damping_n_s_m, max_effort=has.max_force_n)
        drives = {joint.name: servo for joint in self.robot.joints if joint.moves}
        placed = self.robot.placed(self._base)
        self._driven = driven = drive(placed, drives, [float(self.seat[0])])
        return Scene(
            driven.soft_bodies,
            driven.kinematic_bodies,
            scene.env_count,
            scene.time,
            affine_bodies=[*scene.affine_bodies, *driven.affine_bodies],
            joints=driven.joints,
            planes=scene.planes,
        )

    def _targets(self) -> np.ndarray:
        bases = np.tile(self._base, (len(self.seat), 1))
        bases[:, 2] += self.raised
        return self._driven.poses(len(self.seat), bases)

    def control(self) -> Control:
        asked = super().control()
        inside = 1e-3 * self.parameters.policy.closed_mm
        fingers = np.where(self.raised > 0, inside, self.seat)
        return replace(asked, joint_targets=self._driven.joint_targets(fingers[:, None]))
