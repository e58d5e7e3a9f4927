# SPDX-License-Identifier: Apache-2.0
"""A press: a rigid indenter comes down on a gel pad, then may shear and twist. Batched.

Depth counts from first touch of the surface at rest. Steps that do not converge are halved, only
in the environments that need it.

Contact begins at a gap of dhat: left alone, an indenter acts as if it had gone deeper by the mean
gap, which at a depth of ten dhat is a tenth of the force and more. It is therefore held back by
that gap (``outputs.contact_layer``): forces and heights depend on dhat to second order only.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import warp as wp

from taccel_lab.bodies.scene_description import SHORTEST_STEP_S
from taccel_lab.errors import InputError, SimulationError
from taccel_lab.geometry import QuadraticMesh, Region, TetMesh
from taccel_lab.ipc.contact.overlap_search import require_separated
from taccel_lab.model.env_rows import copy_rows, device_mask
from taccel_lab.outputs.contact_layer import gap_work
from taccel_lab.outputs.guard_share import guard_force
from taccel_lab.presses.ahead import WayAhead, goes_on
from taccel_lab.presses.frame import PressFrames
from taccel_lab.presses.path import SPEED_MM_S, PressPath
from taccel_lab.presses.physics import PressError, expected_error
from taccel_lab.presses.places import Places
from taccel_lab.presses.setup import PressSetup
from taccel_lab.presses.touch import (
    MAX_DEPTH_FRACTION,
    first_touch_m,
    gel_below_m,
    require_resolved,
)
from taccel_lab.scene import (
    Ball,
    KinematicBody,
    Scene,
    SoftBody,
    TriangleMesh,
)
from taccel_lab.signals.forces import resultant_wrench
from taccel_lab.solvers import Control, EnvStatus, SolverConfig, SolverIPC, StepReport
from taccel_lab.solvers.env_phase import STALL_AFTER
from taccel_lab.state import initial_state

START_CLEARANCE_M = 5e-6
"""Gap between first touch and the start, on top of two dhat."""
SETBACK_TOLERANCE = 2e-3
"""How far the mean gap may be from what the indenter was held back by, as a part of the depth: a
ball's force is off by 1.5 times as much."""
FIRST_SETBACK = 0.8
"""What an indenter is held back by in the step that brings it into contact, as a part of dhat: the
mean gap of balls of 1.5 to 8 mm, 0.2 mm deep, is 0.77 to 0.83. What comes out else is corrected."""
SETBACK_ROUNDS = 4
"""How often a step is corrected for the mean gap that it had."""
_CAUSES = {
    EnvStatus.STALLED: f"STALLED, neither residual nor energy fell in {STALL_AFTER} iterations",
    EnvStatus.BLOCKED: "BLOCKED, the way leads through what holds the gel",
}
"""What a status does not say by itself."""


def _reach(shape: Ball | TriangleMesh) -> str:
    """Where a mesh lies about the origin that is placed, in words; nothing for a ball."""
    if isinstance(shape, Ball):
        return ""
    low, high = 1e3 * shape.vertices_m.min(axis=0), 1e3 * shape.vertices_m.max(axis=0)
    return (
        f"; about its own origin, which is put there, it reaches over x [{low[0]:g}, {high[0]:g}] "
        f"and y [{low[1]:g}, {high[1]:g}] mm"
    )


class PressEnv:
    """One gel and one indenter in ``env_count`` environments that differ in place and rest shape.

    ``positions`` and ``wrench`` are read after ``move_to``.
    """

    def __init__(
        self,
        setup: PressSetup,
        at_mm: np.ndarray,
        *,
        rest_positions_m: np.ndarray | None = None,
        gel_from_press: np.ndarray | None = None,
        config: SolverConfig | None = None,
    ) -> None:
        """
        Args:
            setup: Gel, tool and physics. With quadratic elements ``positions`` and forces are those
                of the nodes of ``mesh`` here, which has more than that of the setup.
            at_mm: xy of the indenter's axis in the press frame [mm], shape [env_count, 2].
            rest_positions_m: Rest shape of each environment [m], [env_count, node_count, 3].
            gel_from_press: Frames in which the indenters come down along -z, shear and twist
                [env_count, 7], see ``frame``; the gel frame when None.
            config: The solver's settings; those of the setup's physics when None.

        Raises:
            InputError: An indenter that would not come down on the pad, or bad material.
        """
        self.at_m = np.asarray(at_mm, dtype=np.float64).reshape(-1, 2) * 1e-3
        if not np.isfinite(self.at_m).all():
            raise InputError("the place of a press must be finite numbers in mm")
        env_count, indenter, physics = len(self.at_m), setup.indenter, setup.physics
        self._frames = PressFrames(gel_from_press, env_count)
        require_resolved(indenter, setup.mesh, rest_positions_m, self._frames, self.at_m)
        body = KinematicBody(indenter.shape, setup.friction_coefficient, name=indenter.name)
        soft = SoftBody(
            setup.mesh, setup.material, rest_positions_m=rest_positions_m, element=physics.element
        )
        self.physics = physics
        self._shape = indenter.shape
        self._shear_m = np.zeros((env_count, 2))
        self.mesh = soft.nodal_mesh
        """The gel with all its nodes: what ``positions`` belong to."""
        self.model = Scene(soft, (body,), env_count).finalize(setup.device)
        self.relaxes = self.model.viscous_point_count > 0
        """Whether forces depend on how long a step takes."""
        # Overlaps at the start are looked for below, with the place in the message.
        self.solver = SolverIPC(self.model, replace(config or physics.solver(), check_start=False))
        rest = self.model.rest_positions.numpy()[:, : self.model.soft_count]
        contact = self.mesh.region_faces(Region.CONTACT)
        bonded = self.mesh.region_faces(Region.BOND, Region.WINDOW)
        points = [self._frames.points_in_press(i, rest[i % len(rest)]) for i in range(env_count)]
        self.touch_m = np.array(
            [
                first_touch_m(indenter.shape, seen, contact, at)
                for seen, at in zip(points, self.at_m, strict=True)
            ]
        )
        """z of the indenter's origin in the press frame at first touch [m], shape [env_count]."""
        if indenter.texture is not None:
            self.touch_m += indenter.texture.mean_depth_m
        if not np.isfinite(self.touch_m).all():
            env = int(np.flatnonzero(~np.isfinite(self.touch_m))[0])
            x, y = self.at_m[env] * 1e3
            low, high = points[env].min(axis=0)[:2] * 1e3, points[env].max(axis=0)[:2] * 1e3
            raise InputError(
                f"at ({x:g}, {y:g}) mm the indenter {indenter.name} misses the gel; x must lie in "
                f"[{low[0]:g}, {high[0]:g}] mm and y in [{low[1]:g}, {high[1]:g}] mm"
                f"{_reach(indenter.shape)}"
            )
        self.thickness_m = np.array(
            [
                gel_below_m(seen, contact, bonded, at)
                for seen, at in zip(points, self.at_m, strict=True)
            ]
        )
        """Gel along the press between contact face and bond [m], shape [env_count]."""
        dhat = self.solver.config.dhat_m
        self.depth_m = np.full(env_count, -dhat - START_CLEARANCE_M)
        """Where the indenters are: depth past first touch [m], shape [env_count]."""
        self.setback_m = np.full(env_count, dhat)
        """Distance by which each indenter is held back [m]: the mean gap of its contact, dhat
        without one; shape [env_count]."""
        self._last_m = np.zeros(env_count)
        """What the last step added to the depth [m]."""
        self.places = Places()
        """Ends of steps, where they are kept: those of the way before the last ``reset`` are where
        steps search from that lead there again."""
        self._ahead: WayAhead | None = None
        """Where steps straight down look ahead; None where nothing is known."""
        if isinstance(indenter.shape, Ball) and gel_from_press is None and len(rest) == 1:
            radius_m = indenter.shape.radius_m
            self._ahead = WayAhead(self.solver, contact, self.touch_m, radius_m)
        self._start = self._poses(self.depth_m, np.zeros((env_count, 2)))
        self.state = initial_state(self.model, self._start)
        require_separated(self.model, self.state)

    def _poses(
        self, depth_m: np.ndarray, shear_m: np.ndarray, twist_rad: np.ndarray | float = 0.0
    ) -> np.ndarray:
        """gel_from_indenter at depths past first touch, held back by the mean gap."""
        place = np.column_stack([self.at_m + shear_m, self.touch_m - depth_m + self.setback_m])
        return self._frames.poses_in_gel(place, twist_rad)[:, None]

    def reset(self) -> None:
        """Back to rest, the indenter above the gel."""
        dhat = self.solver.config.dhat_m
        self.setback_m[:], self.depth_m[:] = dhat, -dhat - START_CLEARANCE_M
        self._shear_m, self._last_m = 0 * self._shear_m, 0 * self._last_m
        self.places.begin_again()
        self.state = initial_state(self.model, self._start)

    def _mean_gap_m(self) -> np.ndarray:
        """Mean gap of the contacts along the press, weighted with their forces [m], [env_count];
        dhat where there is no contact."""
        work = gap_work(self.solver.collisions, self.state.positions).numpy().sum(axis=1)
        normal = self.solver.contact_gradient.numpy()[:, : self.model.soft_count].sum(axis=1)
        force = self._frames.vectors_in_press(normal)[:, 2]
        dhat = self.solver.config.dhat_m
        return np.divide(work, force, out=np.full(len(force), dhat), where=(work > 0) & (force > 0))

    def checked_depth_m(self, depth_mm: np.ndarray | float) -> np.ndarray:
        """Check depths [m], shape [env_count]; raises InputError for one past the gel's
        thickness."""
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
        dt_s: float | None = None,
    ) -> StepReport:
        """Move the indenters to a depth [mm] (scalar or [env_count]), sideways and turned.

        ``dt_s``: how long that takes, for a gel that relaxes; by ``SPEED_MM_S`` when None.

        Raises:
            InputError: A depth past the gel's thickness.
            SimulationError: An environment did not converge even in small steps.
        """
        report = self.try_to(depth_mm, shear_mm, twist_deg, dt_s=dt_s)
        if not report.converged.all():
            env = int(np.flatnonzero(~report.converged)[0])
            raise SimulationError(self.failure(env, report, depth_mm))
        return report

    def try_to(
        self,
        depth_mm: np.ndarray | float,
        shear_mm: np.ndarray | tuple[float, float] = (0.0, 0.0),
        twist_deg: np.ndarray | float = 0.0,
        stay: np.ndarray | None = None,
        dt_s: float | None = None,
    ) -> StepReport:
        """Move as ``move_to`` does, but an environment that does not converge is left where it was,
        for the caller to see in the report. Those of ``stay`` (bool, [env_count]) are not stepped.

        ``twist_deg`` may be one angle an environment, or rotation vectors of the press frame,
        [env_count, 3], about the indenter's origin."""
        shear_m = np.asarray(shear_mm, dtype=np.float64) * 1e-3
        shear_m = np.broadcast_to(shear_m, (len(self.at_m), 2))
        deep, aside = np.maximum(self.depth_m, 0.0), self._shear_m
        target_m = self.checked_depth_m(depth_mm)
        if self.relaxes and dt_s is None:
            way_m = np.hypot(target_m - deep, np.linalg.norm(shear_m - aside, axis=1))
            moving = way_m if stay is None else way_m[~stay]
            dt_s = max(1e3 * float(moving.max(initial=0.0)) / SPEED_MM_S, SHORTEST_STEP_S)
        report = self._step(target_m, shear_m, np.radians(twist_deg), stay, dt_s)
        done = report.converged & (True if stay is None else ~stay)
        if done.all():
            end = target_m, shear_m, np.radians(twist_deg)
            self.places.keep(self.state.positions, self.setback_m, *end)
        self._shear_m = np.where(done[:, None], shear_m, aside)
        return report

    def _step(
        self,
        depth_m: np.ndarray,
        shear_m: np.ndarray,
        twist_rad: np.ndarray | float,
        stay: np.ndarray | None,
        dt_s: float | None,
    ) -> StepReport:
        """One step, taken again where the mean gap came out other than the indenter was held back
        by. ``depth_m`` [env_count], ``shear_m`` [env_count, 2], ``twist_rad`` one or [env_count].

        Again means from its own start: friction then sees one step to the corrected place.
        """
        resting = np.zeros(len(self.at_m), dtype=bool) if stay is None else stay.copy()
        before, held_back = self.state.copy(), self.setback_m
        rubbing = wp.clone(self.solver.friction_gradient)
        dhat = self.solver.config.dhat_m
        touching = (self.setback_m == dhat) & (depth_m > dhat) & ~resting
        self.setback_m = np.where(touching, FIRST_SETBACK * dhat, self.setback_m)

        def put_back(lost: np.ndarray, forces: bool = True) -> None:
            """Environments of ``lost`` to where the step began, with the forces there: those of
            friction depend on the step before."""
            self.state.restore(before, lost)
            self.setback_m = np.where(lost, held_back, self.setback_m)
            if forces:
                self.solver.refresh_forces(self.state, lost)
                mask = device_mask(lost, len(lost), self.model.device)
                copy_rows(mask, rubbing, self.solver.friction_gradient)

        try:
            return self._settle(depth_m, shear_m, twist_rad, resting, put_back, dt_s)
        except BaseException as error:
            # After an interrupt what the steps before had reached is whole and can be read.
            put_back(np.ones_like(resting), forces=not isinstance(error, Exception))
            raise

    def _settle(
        self,
        depth_m: np.ndarray,
        shear_m: np.ndarray,
        twist_rad: np.ndarray | float,
        resting: np.ndarray,
        put_back: Callable[[np.ndarray], None],
        dt_s: float | None,
    ) -> StepReport:
        """Step until the mean gap is what the indenter is held back by; ``put_back`` where that
        fails. ``resting`` (bool, [env_count]) are left alone."""
        stay = resting.copy()
        ways_m = depth_m - self.depth_m, self._last_m, self.depth_m
        straight = not (shear_m.any() or self._shear_m.any() or np.any(twist_rad))
        straight = straight and goes_on(*(values[~resting] for values in ways_m))
        known = self.places.start(depth_m, shear_m, twist_rad)
        if known is not None:
            self.setback_m = np.where(resting, self.setback_m, known[1])
        report: StepReport | None = None
        for left in reversed(range(SETBACK_ROUNDS)):
            target = self._poses(depth_m, shear_m, twist_rad)
            target[resting] = self.poses[resting]
            again = report is not None
            control = Control(target, dt_s=dt_s)
            ahead = None
            if self._ahead is not None and straight and not again:
                ahead = partial(self._ahead.write, self.state, target)
            elif known is not None and not again:
                ahead = known[0]
            found = self.solver.step(self.state, control, who=~resting, again=again, ahead=ahead)
            report = report.followed_by(found) if report is not None else found
            resting |= ~found.converged
            gap = self._mean_gap_m()
            resting |= np.abs(gap - self.setback_m) <= SETBACK_TOLERANCE * np.abs(depth_m)
            if resting.all() or left == 0:
                break
            self.setback_m = np.where(resting, self.setback_m, gap)
        assert report is not None
        lost = ~report.converged & ~stay
        if lost.any():
            put_back(lost)
        came = report.converged & ~stay
        self._last_m = np.where(came, depth_m - self.depth_m, self._last_m)
        self.depth_m = np.where(report.converged, depth_m, self.depth_m)
        return report

    def failure(self, env: int, report: StepReport, depth_mm: np.ndarray | float) -> str:
        """Why an environment did not converge on its way to a depth, in words."""
        depth = float(np.broadcast_to(depth_mm, (len(self.at_m),))[env])
        config, status = self.solver.config, EnvStatus(report.status[env])
        return (
            f"the press at ({self.at_m[env, 0] * 1e3:.3g}, {self.at_m[env, 1] * 1e3:.3g}) mm, "
            f"depth {depth:.4g} mm did not converge: "
            f"{_CAUSES.get(status, status.name)}, residual {report.residual_n[env]:.2e} N of "
            f"{report.contact_force_n[env]:.3g} N after {report.newton_iterations[env]} Newton "
            f"iterations, where a step may take {config.max_substep_halvings} halvings and "
            f"{config.max_step_iterations} iterations"
        )

    def follow(
        self, path: PressPath, progress: Callable[[int, int, StepReport], None] | None = None
    ) -> list[StepReport]:
        """Go along a path in all environments; ``progress`` gets step, step count and report."""
        self._require_free(path)
        waypoints, durations = path.waypoints(), path.durations_s()
        reports = []
        for i, (depth, shear, twist) in enumerate(waypoints):
            dt_s = max(durations[i], SHORTEST_STEP_S) if self.relaxes else None
            reports.append(self.move_to(depth, shear, twist, dt_s))
            if progress is not None:
                progress(i + 1, len(waypoints), reports[-1])
        return reports

    def _require_free(self, path: PressPath) -> None:
        """Refuse a path that leads the indenter through what holds the gel, or that rolls."""
        if any(path.roll_deg):
            raise InputError("a path that rolls goes by its commands, one try_to a step")
        everyone = np.ones(len(self.at_m), dtype=bool)
        depth_m, start = self.checked_depth_m(path.depth_mm), self.poses
        aside = [way[1:] for way in path.way_there() if way[1:] != ((0.0, 0.0), 0.0)]
        for shear, twist in [((0.0, 0.0), 0.0), *aside]:
            shear_m = np.tile(np.array(shear) * 1e-3, (len(self.at_m), 1))
            end = self._poses(depth_m, shear_m, math.radians(twist))
            for env, way in self.solver.ways.find(start, end, everyone).items():
                x, y = self.at_m[env] * 1e3
                raise InputError(
                    f"the press at ({x:.3g}, {y:.3g}) mm to depth {path.depth_mm:.4g} mm, shear "
                    f"({shear[0]:.3g}, {shear[1]:.3g}) mm and twist {twist:.3g} deg cannot be "
                    f"done: {way.place()}"
                )
            start = end

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

    def nodal(self, mesh: TetMesh) -> TetMesh | QuadraticMesh:
        """``mesh``, whose connectivity is that of the gel here, with all its nodes."""
        return replace(self.mesh, base=mesh) if isinstance(self.mesh, QuadraticMesh) else mesh

    def guard_share(self) -> np.ndarray:
        """Part of the force along the press that depends on the guard against inside-out tets,
        [env_count]: what would change, to first order, if tets could be squeezed to nothing.
        Exactly 0 where none is near it; NaN where the gel is about to buckle."""
        tool = self.model.bodies[-1].node_slice
        moves = np.zeros((*self.state.positions.shape, 3))
        moves[:, tool] = self._frames.down_in_gel(len(self.at_m))[:, None]
        found = np.abs(guard_force(self.solver, self.state, moves))
        force = np.abs(self.press_force[:, 2])
        return np.divide(found, force, out=np.zeros(len(force)), where=force > 0)

    def error_estimate(self) -> PressError:
        """Largest error of force and heights in 19 of 20 such presses, on a mesh made for the
        press, see ``expected_error``."""
        return expected_error(self.physics, self._shape, self.press_force[:, 2], self.depth_m)
