# SPDX-License-Identifier: Apache-2.0
"""A press: a rigid indenter comes down on a gel pad, then may shear and twist. Batched.

Depth counts from first touch of the surface at rest. Steps that do not converge are halved, only
in the environments that need it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from taccel_lab.envs.indenter import Indenter
from taccel_lab.envs.touch import first_touch_m
from taccel_lab.errors import InputError, SimulationError
from taccel_lab.geometry import Region, TetMesh
from taccel_lab.ipc.intersection import require_separated
from taccel_lab.scene import Element, KinematicBody, Material, Scene, SoftBody
from taccel_lab.signals.forces import resultant_wrench
from taccel_lab.solvers import EnvStatus, SolverConfig, SolverIPC, StepReport
from taccel_lab.state import initial_state

MAX_DEPTH_FRACTION = 0.9
"""Deepest press as a part of the gel's thickness."""
START_CLEARANCE_M = 5e-6
"""Gap between first touch and the start, on top of two dhat."""
MAX_STEPS = 10_000
"""Longest path: a step length mistaken for another unit would keep a machine busy for days."""


@dataclass(frozen=True)
class PressPath:
    """Where the indenter goes: down, then sideways and about its vertical axis."""

    depth_mm: float
    """Depth past first touch."""
    shear_mm: tuple[float, float] = (0.0, 0.0)
    """Sideways motion at full depth, gel x and y."""
    twist_deg: float = 0.0
    """Turn about +z at full depth, right-handed in the gel frame."""
    step_mm: float = 0.2
    """Largest motion in one step."""
    step_deg: float = 2.0
    """Largest turn in one step."""

    def __post_init__(self) -> None:
        values = (self.depth_mm, *self.shear_mm, self.twist_deg, self.step_mm, self.step_deg)
        if not all(math.isfinite(v) for v in values):
            raise InputError(f"a press path must be finite numbers, got {values}")
        if self.depth_mm <= 0:
            raise InputError(f"depth must be above 0 mm, got {self.depth_mm:g} mm")
        if self.depth_mm > 100:
            raise InputError(f"depth must be at most 100 mm, got {self.depth_mm:g} mm")
        if max(abs(v) for v in self.shear_mm) > 20:
            raise InputError(f"shear must lie within +-20 mm, got {self.shear_mm}")
        if abs(self.twist_deg) > 180:
            raise InputError(f"twist must lie within +-180 deg, got {self.twist_deg:g}")
        if self.step_mm <= 0 or self.step_deg <= 0:
            raise InputError(
                f"step_mm and step_deg must be above 0, got {self.step_mm:g} and {self.step_deg:g}"
            )
        motion_mm = max(self.depth_mm, math.hypot(*self.shear_mm))
        least_mm, least_deg = motion_mm / MAX_STEPS, abs(self.twist_deg) / MAX_STEPS
        if self.step_mm < least_mm or self.step_deg < least_deg:
            raise InputError(
                f"step_mm {self.step_mm:g} and step_deg {self.step_deg:g} make more than "
                f"{MAX_STEPS} steps of this path; at least {least_mm:.3g} mm and {least_deg:.3g} "
                "deg are needed"
            )

    def waypoints(self) -> list[tuple[float, tuple[float, float], float]]:
        """(depth [mm], shear [mm], twist [deg]) at the end of each step."""
        down = max(1, math.ceil(self.depth_mm / self.step_mm - 1e-9))
        side = max(
            math.ceil(math.hypot(*self.shear_mm) / self.step_mm - 1e-9),
            math.ceil(abs(self.twist_deg) / self.step_deg - 1e-9),
            int(any((*self.shear_mm, self.twist_deg))),
        )
        path = [(self.depth_mm * ((i + 1) / down), (0.0, 0.0), 0.0) for i in range(down)]
        for i in range(side):
            t = (i + 1) / side
            shear = (self.shear_mm[0] * t, self.shear_mm[1] * t)
            path.append((self.depth_mm, shear, self.twist_deg * t))
        return path


class PressEnv:
    """One gel and one indenter in ``env_count`` environments that differ in place and rest shape.

    ``positions`` and ``wrench`` are read after ``move_to``.
    """

    def __init__(
        self,
        mesh: TetMesh,
        material: Material,
        indenter: Indenter,
        at_mm: np.ndarray,
        *,
        friction_coefficient: float = 0.0,
        rest_positions_m: np.ndarray | None = None,
        element: Element = Element.LINEAR,
        config: SolverConfig | None = None,
        device: str = "cpu",
    ) -> None:
        """
        Args:
            mesh: Gel pad in the gel frame.
            material: Of the gel.
            indenter: Rigid body that is pressed.
            at_mm: Gel xy of the indenter's axis [mm], shape [env_count, 2].
            friction_coefficient: Between indenter and gel.
            rest_positions_m: Rest shape of each environment [m], [env_count, node_count, 3].
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
        self.touch_m = np.array(
            [
                first_touch_m(indenter.shape, rest[env % len(rest)], contact, self.at_m[env])
                for env in range(env_count)
            ]
        )
        """Height of the indenter's origin at first touch [m], shape [env_count]."""
        if not np.isfinite(self.touch_m).all():
            env = int(np.flatnonzero(~np.isfinite(self.touch_m))[0])
            x, y = self.at_m[env] * 1e3
            low, high = rest[0].min(axis=0)[:2] * 1e3, rest[0].max(axis=0)[:2] * 1e3
            raise InputError(
                f"at ({x:g}, {y:g}) mm the indenter {indenter.name} misses the gel; x must lie in "
                f"[{low[0]:g}, {high[0]:g}] mm and y in [{low[1]:g}, {high[1]:g}] mm"
            )
        self._thickness_m = self._gel_depth(rest, contact)
        clearance = 2 * self.solver.config.dhat_m + START_CLEARANCE_M
        self._start = self._poses(np.full(env_count, -clearance), np.zeros((env_count, 2)), 0.0)
        self.state = initial_state(self.model, self._start)
        require_separated(self.model, self.state)

    def _gel_depth(self, rest: np.ndarray, contact: np.ndarray) -> np.ndarray:
        """Gel below the contact face nearest to each press [m], shape [env_count]."""
        nodes = np.unique(contact)
        depth = np.zeros(len(self.at_m))
        for env, at in enumerate(self.at_m):
            points = rest[env % len(rest)]
            nearest = nodes[np.argmin(((points[nodes, :2] - at) ** 2).sum(axis=1))]
            depth[env] = points[nearest, 2] - points[:, 2].min()
        return depth

    def _poses(self, depth_m: np.ndarray, shear_m: np.ndarray, twist_rad: float) -> np.ndarray:
        poses = np.zeros((len(self.at_m), 1, 7))
        poses[:, 0, :2] = self.at_m + shear_m
        poses[:, 0, 2] = self.touch_m - depth_m
        poses[:, 0, 5] = math.sin(twist_rad / 2)
        poses[:, 0, 6] = math.cos(twist_rad / 2)
        return poses

    def reset(self) -> None:
        """Back to rest, the indenter above the gel."""
        self.state = initial_state(self.model, self._start)

    def checked_depth_m(self, depth_mm: np.ndarray | float) -> np.ndarray:
        """Depths [m], shape [env_count]; raises InputError for one past the gel's thickness."""
        depth_m = np.broadcast_to(np.asarray(depth_mm, dtype=np.float64), (len(self.at_m),)) * 1e-3
        if not np.isfinite(depth_m).all():
            raise InputError("the depth of a press must be finite numbers in mm")
        limit = MAX_DEPTH_FRACTION * self._thickness_m
        if (depth_m > limit).any():
            env = int(np.argmax(depth_m - limit))
            raise InputError(
                f"depth {depth_m[env] * 1e3:g} mm goes past the gel, which is "
                f"{self._thickness_m[env] * 1e3:g} mm thick there; at most "
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
        count = len(self.at_m)
        depth_m = self.checked_depth_m(depth_mm)
        shear_m = np.broadcast_to(np.asarray(shear_mm, dtype=np.float64), (count, 2)) * 1e-3
        target = self._poses(depth_m, shear_m, math.radians(twist_deg))
        report = self.solver.step(self.state, target)
        if not report.converged.all():
            env = int(np.flatnonzero(~report.converged)[0])
            raise SimulationError(
                f"the press at ({self.at_m[env, 0] * 1e3:.3g}, {self.at_m[env, 1] * 1e3:.3g}) mm, "
                f"depth {depth_m[env] * 1e3:.4g} mm did not converge: "
                f"{EnvStatus(report.status[env]).name}, residual {report.residual_n[env]:.2e} N of "
                f"{report.contact_force_n[env]:.3g} N after {report.newton_iterations[env]} Newton "
                f"iterations and {self.solver.config.max_substep_halvings} halvings of the step"
            )
        return report

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
