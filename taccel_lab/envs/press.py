# SPDX-License-Identifier: Apache-2.0
"""A press: a rigid indenter comes down on a gel pad, then may shear and twist. Batched.

Depth counts from first touch of the surface at rest. Steps that do not converge are halved, only
in the environments that need it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from taccel_lab.envs.indenter import Indenter
from taccel_lab.envs.press_frame import PressFrames
from taccel_lab.envs.press_path import PressPath
from taccel_lab.envs.touch import first_touch_m, gel_below_m
from taccel_lab.errors import InputError, SimulationError
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.ipc.intersection import require_separated
from taccel_lab.scene import Element, KinematicBody, Material, MaterialField, Scene, SoftBody
from taccel_lab.signals.forces import resultant_wrench
from taccel_lab.solvers import EnvStatus, SolverConfig, SolverIPC, StepReport
from taccel_lab.state import initial_state

MAX_DEPTH_FRACTION = 0.9
"""Deepest press as a part of the gel's thickness."""
START_CLEARANCE_M = 5e-6
"""Gap between first touch and the start, on top of two dhat."""


class PressEnv:
    """One gel and one indenter in ``env_count`` environments that differ in place and rest shape.

    ``positions`` and ``wrench`` are read after ``move_to``.
    """

    def __init__(
        self,
        mesh: TetMesh,
        material: Material | MaterialField,
        indenter: Indenter,
        at_mm: np.ndarray,
        *,
        friction_coefficient: float = 0.0,
        rest_positions_m: np.ndarray | None = None,
        gel_from_press: np.ndarray | None = None,
        element: Element = Element.LINEAR,
        config: SolverConfig | None = None,
        device: str = "cpu",
    ) -> None:
        """
        Args:
            mesh: Gel pad in the gel frame.
            material: Of the gel, uniform or by tet.
            indenter: Rigid body that is pressed.
            at_mm: xy of the indenter's axis in the press frame [mm], shape [env_count, 2].
            friction_coefficient: Between indenter and gel.
            rest_positions_m: Rest shape of each environment [m], [env_count, node_count, 3].
            gel_from_press: Frames in which the indenters come down along -z, shear and twist
                [env_count, 7], see ``press_frame``; the gel frame when None.
            element: Of the gel. With quadratic ones ``positions`` and forces are those of the nodes
                of ``mesh`` here, which has more than the one passed in.
            config: Tolerances of the solver.
            device: Warp device.

        Raises:
            InputError: An indenter that would not come down on the pad, or bad material.
        """
        self.at_m = np.asarray(at_mm, dtype=np.float64).reshape(-1, 2) * 1e-3
        if not np.isfinite(self.at_m).all():
            raise InputError("the place of a press must be finite numbers in mm")
        env_count = len(self.at_m)
        body = KinematicBody(indenter.shape, friction_coefficient, name=indenter.name)
        soft = SoftBody(mesh, material, rest_positions_m=rest_positions_m, element=element)
        self.mesh = soft.nodal_mesh
        """The gel with all its nodes: what ``positions`` belong to."""
        self.model = Scene(soft, (body,), env_count).finalize(device)
        # Overlaps at the start are looked for below, with the place in the message.
        self.solver = SolverIPC(self.model, replace(config or SolverConfig(), check_start=False))
        rest = self.model.rest_positions.numpy()[:, : self.model.soft_count]
        contact = self.mesh.region_faces(Region.CONTACT)
        bonded = self.mesh.region_faces(Region.BOND, Region.WINDOW)
        self._frames = PressFrames(gel_from_press, env_count)
        points = [self._frames.points_in_press(i, rest[i % len(rest)]) for i in range(env_count)]
        self.touch_m = np.array(
            [
                first_touch_m(indenter.shape, seen, contact, at)
                for seen, at in zip(points, self.at_m, strict=True)
            ]
        )
        """z of the indenter's origin in the press frame at first touch [m], shape [env_count]."""
        if not np.isfinite(self.touch_m).all():
            env = int(np.flatnonzero(~np.isfinite(self.touch_m))[0])
            x, y = self.at_m[env] * 1e3
            low, high = points[env].min(axis=0)[:2] * 1e3, points[env].max(axis=0)[:2] * 1e3
            raise InputError(
                f"at ({x:g}, {y:g}) mm the indenter {indenter.name} misses the gel; x must lie in "
                f"[{low[0]:g}, {high[0]:g}] mm and y in [{low[1]:g}, {high[1]:g}] mm"
            )
        self.thickness_m = np.array(
            [
                gel_below_m(seen, contact, bonded, at)
                for seen, at in zip(points, self.at_m, strict=True)
            ]
        )
        """Gel along the press between contact face and bond [m], shape [env_count]."""
        clearance = 2 * self.solver.config.dhat_m + START_CLEARANCE_M
        self._start = self._poses(np.full(env_count, -clearance), np.zeros((env_count, 2)), 0.0)
        self.state = initial_state(self.model, self._start)
        require_separated(self.model, self.state)

    def _poses(self, depth_m: np.ndarray, shear_m: np.ndarray, twist_rad: float) -> np.ndarray:
        place = np.column_stack([self.at_m + shear_m, self.touch_m - depth_m])
        return self._frames.poses_in_gel(place, twist_rad)[:, None]

    def reset(self) -> None:
        """Back to rest, the indenter above the gel."""
        self.state = initial_state(self.model, self._start)

    def checked_depth_m(self, depth_mm: np.ndarray | float) -> np.ndarray:
        """Depths [m], shape [env_count]; raises InputError for one past the gel's thickness."""
        depth_m = np.broadcast_to(np.asarray(depth_mm, dtype=np.float64), (len(self.at_m),)) * 1e-3
        if not np.isfinite(depth_m).all():
            raise InputError("the depth of a press must be finite numbers in mm")
        limit = MAX_DEPTH_FRACTION * self.thickness_m
        if (depth_m > limit).any():
            env = int(np.argmax(depth_m - limit))
            raise InputError(
                f"depth {depth_m[env] * 1e3:g} mm goes past the gel, which is "
                f"{self.thickness_m[env] * 1e3:g} mm thick there; at most "
                f"{limit[env] * 1e3:.3g} mm ({MAX_DEPTH_FRACTION:.0%}) is allowed"
            )
        return depth_m

    def move_to(
        self,
        depth_mm: np.ndarray | float,
        shear_mm: np.ndarray | tuple[float, float] = (0.0, 0.0),
        twist_deg: float = 0.0,
    ) -> StepReport:
        """Move the indenters to a depth [mm] (scalar or [env_count]), sideways and turned.

        Raises:
            InputError: A depth past the gel's thickness.
            SimulationError: An environment did not converge even in small steps.
        """
        report = self.try_to(depth_mm, shear_mm, twist_deg)
        if not report.converged.all():
            env = int(np.flatnonzero(~report.converged)[0])
            raise SimulationError(self.failure(env, report, depth_mm))
        return report

    def try_to(
        self,
        depth_mm: np.ndarray | float,
        shear_mm: np.ndarray | tuple[float, float] = (0.0, 0.0),
        twist_deg: float = 0.0,
        stay: np.ndarray | None = None,
    ) -> StepReport:
        """As ``move_to``, but an environment that does not converge is left where it was, for the
        caller to see in the report. Those of ``stay`` (bool, [env_count]) are not moved."""
        count = len(self.at_m)
        depth_m = self.checked_depth_m(depth_mm)
        shear_m = np.broadcast_to(np.asarray(shear_mm, dtype=np.float64), (count, 2)) * 1e-3
        target = self._poses(depth_m, shear_m, math.radians(twist_deg))
        if stay is not None:
            target[stay] = self.poses[stay]
        return self.solver.step(self.state, target)

    def failure(self, env: int, report: StepReport, depth_mm: np.ndarray | float) -> str:
        """Why an environment did not converge on its way to a depth, in words."""
        depth = float(np.broadcast_to(depth_mm, (len(self.at_m),))[env])
        return (
            f"the press at ({self.at_m[env, 0] * 1e3:.3g}, {self.at_m[env, 1] * 1e3:.3g}) mm, "
            f"depth {depth:.4g} mm did not converge: "
            f"{EnvStatus(report.status[env]).name}, residual {report.residual_n[env]:.2e} N of "
            f"{report.contact_force_n[env]:.3g} N after {report.newton_iterations[env]} Newton "
            f"iterations and {self.solver.config.max_substep_halvings} halvings of the step"
        )

    def follow(
        self, path: PressPath, progress: Callable[[int, int, StepReport], None] | None = None
    ) -> list[StepReport]:
        """Go along a path in all environments; ``progress`` gets step, step count and report."""
        self.checked_depth_m(path.depth_mm)
        waypoints = path.waypoints()
        reports = []
        for i, (depth, shear, twist) in enumerate(waypoints):
            reports.append(self.move_to(depth, shear, twist))
            if progress is not None:
                progress(i + 1, len(waypoints), reports[-1])
        return reports

    # What can be read --------------------------------------------------------------------------

    @property
    def poses(self) -> np.ndarray:
        """gel_from_indenter, [env_count, 1, 7]: position [m] and quaternion x, y, z, w."""
        return self.state.poses.numpy().reshape(len(self.at_m), 1, 7).copy()

    @property
    def positions(self) -> np.ndarray:
        """Gel node positions [m], shape [env_count, node_count, 3]."""
        return self.state.positions.numpy()[:, : self.model.soft_count]

    @property
    def contact_forces(self) -> np.ndarray:
        """Normal and tangential force of the indenter on each gel node [N], [env, node, 3]."""
        total = self.solver.contact_gradient.numpy() + self.solver.friction_gradient.numpy()
        return -total[:, : self.model.soft_count]

    @property
    def wrench(self) -> np.ndarray:
        """Force [N] and moment about the origin [N m] of the gel on the indenter, [env, 6]."""
        return -resultant_wrench(self.positions, self.contact_forces)

    @property
    def press_force(self) -> np.ndarray:
        """Force of the gel on the indenter [N] in the press frame, shape [env_count, 3]."""
        return self._frames.vectors_in_press(self.wrench[:, :3])
