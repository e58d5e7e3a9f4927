# SPDX-License-Identifier: Apache-2.0
"""A grasp and lift whose fingers are pushed by drives: these say how hard the gels grip.

The gels are on links with mass, which slide on the base and which drives of limited force push.
The fingers close as those of ``grasp_lift`` do; once both grip, their targets lie far inside of the
object. The base goes where it is commanded.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from taccel_lab.files.strict_model import StrictModel
from taccel_lab.robots import drive
from taccel_lab.scene import PositionDrive, Scene
from taccel_lab.solvers import Control
from taccel_lab.tasks.grasp_lift import GraspLift, GraspParameters, Object
from taccel_lab.tasks.parameters import NotNegative, Positive


class FingerDrive(StrictModel):
    """Of each finger."""

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
