# SPDX-License-Identifier: Apache-2.0
"""The solver: the potentials that a scene needs, and steps of all environments.

A step that fails in some environments is taken there in halves, again and again, while the others
have arrived (``newton`` takes the parts). Orchestration only: formulas are in ``ipc``.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.ipc.broad_phase.candidates import Candidates
from taccel_lab.ipc.capacity import GrowingList, grow_all, initial_capacity
from taccel_lab.ipc.collisions import Collisions
from taccel_lab.ipc.kinematics import place_poses_between
from taccel_lab.ipc.linear.system import LinearSystem
from taccel_lab.ipc.potentials.contact import ContactPotential
from taccel_lab.ipc.potentials.elastic import ElasticPotential
from taccel_lab.ipc.potentials.energy import Potential, share_buffer
from taccel_lab.ipc.potentials.external import ExternalLoad
from taccel_lab.ipc.potentials.friction import FrictionPotential
from taccel_lab.ipc.potentials.inertia import InertiaPotential
from taccel_lab.ipc.potentials.inversion import BEARS_INVERSION, may_hide_inversion
from taccel_lab.ipc.scratch import Scratch
from taccel_lab.model import Model
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.solvers.newton import StepRun
from taccel_lab.solvers.plan import Plan, make_plan
from taccel_lab.solvers.progress import ProgressArrays, make_rules
from taccel_lab.solvers.report import EnvStatus, StepReport
from taccel_lab.solvers.step_graph import StepGraphs
from taccel_lab.state import State, as_poses, initial_state

HALVING_HELPS = [
    EnvStatus.NO_CONVERGENCE,
    EnvStatus.LINE_SEARCH,
    EnvStatus.FRICTION,
    EnvStatus.JOINT,
    EnvStatus.NOT_A_NUMBER,
]
"""Failures that a shorter step may avoid."""


class SolverIPC:
    """Steps a model; parts that the scene does not need are not built."""

    def __init__(self, model: Model, config: SolverConfig | None = None) -> None:
        self.model = model
        self.config = config or SolverConfig()
        scene = model.scene
        self.elastic = [ElasticPotential(model, group) for group in model.elastic]
        """One for each group of elements that share a law and a kind."""
        self.invertible = [part for part in self.elastic if part.group.law in BEARS_INVERSION]
        """Those that may start with elements inside out, as their energy bears it."""
        self.silent = [part for part in self.elastic if may_hide_inversion(part)]
        """Those whose energy does not tell that a step has turned an element inside out."""
        self.inertia = None if scene.time.quasi_static else InertiaPotential(model)
        self.viscosity = self._viscosity()
        self.affine = None
        if scene.affine_bodies:
            from taccel_lab.ipc.potentials.affine import AffinePotential

            self.affine = AffinePotential(model)
        self.joints = None
        if scene.joints:
            from taccel_lab.ipc.potentials.joints import JointPotential

            self.joints = JointPotential(model)
        self.load: ExternalLoad | None = None
        """Built by the first step of a state with external forces."""
        limit = self.config.max_collisions
        self.candidates = Candidates(model, limit=limit)
        self.collisions = Collisions(model, self.config.kappa_pa, self.config.dhat_m, limit=limit)
        self.contact = ContactPotential(model, self.collisions)
        static_range = self.config.static_range_m(scene.time)
        self.friction = (
            FrictionPotential(model, self.collisions, static_range) if model.rubs else None
        )
        # Where gels make up most of the unknowns CG is quicker, stiff bodies or not.
        stiff = 8 * model.affine.count >= model.free_count
        first = model.free_count - 4 * model.affine.count
        self.linear = LinearSystem(
            model.pattern,
            model.env_count,
            model.device,
            stiff,
            method=self.config.linear_method,
            clusters=[(first + 4 * i, first + 4 * i + 4) for i in range(model.affine.count)],
            extra_capacity=self._extra_capacity(),
            scratch=self._scratch(),
        )
        shape, device = (model.env_count, model.node_count), model.device

        def nodal() -> wp.array:
            return wp.zeros(shape, dtype=wp.vec3d, device=device)

        self.gradient, self.trial, self.previous = nodal(), nodal(), nodal()
        self.displacements = nodal()
        self.origin = nodal()
        """Where the nodes were when the step began [m]: sliding counts from there. Other than
        ``previous`` in a step that is taken again from where it had ended."""
        self.contact_gradient = nodal()
        """d(barrier)/dx at the end of the step [N]; the force on a node is its negative."""
        self.friction_gradient = nodal()
        """d(friction)/dx at the end of the step [N]; the force on a node is its negative."""
        self.path = nodal() if model.kinematic or self.affine else self.trial
        """Way of a trial in which a body turns [m]."""
        pivots = (model.env_count, model.affine.count)
        self.pivots = wp.zeros(pivots, dtype=wp.vec3d, device=device)
        """What each affine body turns about in a step, from its centre [m]."""
        self.reduced = wp.zeros((model.env_count, model.free_count), dtype=wp.vec3d, device=device)
        """Gradient of the total energy by the unknowns [N]."""
        self.dts = wp.zeros(model.env_count, dtype=wp.float64, device=device)
        self._dt = 0.0
        self._who = np.zeros(model.env_count, dtype=bool)
        self._separate = np.zeros(model.env_count, dtype=bool)
        """Environments known to have started without overlaps."""
        poses = (model.env_count, len(model.kinematic))
        self.trial_poses = wp.zeros(poses, dtype=wp.transformd, device=device)
        self.target_poses = wp.zeros_like(self.trial_poses)
        self.start_poses = wp.zeros_like(self.trial_poses)
        self.end_poses = wp.zeros_like(self.trial_poses)
        self.origin_poses = wp.zeros_like(self.trial_poses)
        self.body_rows = wp.array(model.body_rows(), dtype=wp.vec2i, device=device)
        """Range of each body in ``reduced``, vec2i, shape [body_count]."""
        ranges = [body.nodes for body in model.bodies]
        self.body_nodes = wp.array(ranges, dtype=wp.vec2i, device=device)
        """Range of each body in the nodes, vec2i, shape [body_count]."""
        self.progress = ProgressArrays(
            model.env_count,
            len(model.bodies),
            model.kinematic_radii_m,
            self._energy_rounding(),
            device,
        )
        self.rules = make_rules(
            self.config,
            self.affine.rounding_n if self.affine else 0.0,
            self.joints.tolerance_m if self.joints else None,
            self.friction is not None,
        )
        self.graphs = StepGraphs(self)
        self._share_energies()

    @property
    def captures(self) -> bool:
        """Whether steps become graphs."""
        return self.graphs.captures

    @property
    def active(self) -> wp.array:
        """Mask of the environments that a step works on, int32, shape [env_count]."""
        return self.progress.data.active

    def _scratch(self) -> Scratch:
        """Memory of the elements, which are idle during a solve."""
        idle = [part.idle_memory for part in [*self.elastic, *self.viscosity]]
        return Scratch(max(idle, key=lambda memory: memory.capacity) if idle else None)

    def _extra_capacity(self) -> int:
        """Room for contact of two free bodies that does not fit the pattern of the matrix."""
        model = self.model
        if model.affine.count and model.scene.soft_bodies and not model.contact_in_pattern:
            return initial_capacity(model.env_count)
        return 32 if model.affine.count or model.plan.soft_to_soft else 1

    def _energy_rounding(self) -> np.ndarray:
        """2e-17 of the shear modulus times the volume: a block of 20 mm and 1 MPa, turned, shows
        about a sixth of that."""
        model = self.model
        total = np.zeros(model.rest_count)
        for group in model.elastic:
            total += (group.volumes.numpy() * group.mu.numpy()).sum(axis=1)
        return 2e-17 * np.tile(total, model.env_count // model.rest_count)

    def _share_energies(self) -> None:
        model = self.model
        self.energies = share_buffer(list(self.potentials.values()), model.env_count, model.device)
        """Energies of all items of ``potentials`` [J], [env_count, all items]."""
        self.graphs.clear()

    def _viscosity(self) -> list:
        groups = [group for group in self.model.elastic if group.damped]
        if not groups:
            return []
        from taccel_lab.ipc.potentials.viscosity import ViscousPotential

        return [ViscousPotential(self.model, group) for group in groups]

    @property
    def plan(self) -> Plan:
        """Which parts run, and why; ``solver.plan.describe()`` prints it."""
        return make_plan(self)

    @property
    def potentials(self) -> dict[str, Potential]:
        """Terms of the energy by name, without contact and friction."""
        terms: dict[str, Potential | None] = {}
        for i, part in enumerate(self.elastic):
            terms["elastic" if i == 0 else f"elastic {i + 1}"] = part
        for i, part in enumerate(self.viscosity):
            terms["viscous" if i == 0 else f"viscous {i + 1}"] = part
        terms |= {
            "inertia": self.inertia,
            "affine": self.affine,
            "joints": self.joints,
            "external": self.load,
        }
        return {name: term for name, term in terms.items() if term is not None}

    def step(
        self,
        state: State,
        target_poses: np.ndarray | wp.array | None = None,
        *,
        who: np.ndarray | None = None,
        again: bool = False,
    ) -> StepReport:
        """Advance ``state`` in place by dt; kinematic bodies end at ``target_poses``.

        ``target_poses``: [env_count, kinematic_count, 7]; where they are when None. An array that
        is on the solver's device already (transformd, [env_count, kinematic_count]) is not checked.
        ``who``: environments to step, bool, [env_count]; all when None. The others, their forces
        too, stay as they are, with status SKIPPED.
        ``again``: take the latest step again to other targets. ``state`` is where it ended, which
        is where the search starts; friction counts sliding from where it began, or where its last
        part did if it was halved. For quasi-static scenes without joints.
        Environments that fail are tried in halves of the step, up to ``max_substep_halvings``
        times; one that fails even so is rolled back to the start of the whole step and flagged.
        Before their first step, environments are searched for bodies that overlap: these are
        flagged and not stepped (``scene.checks.check_start`` says what is wrong).
        """
        started = time.perf_counter()
        if again and (self.inertia is not None or self.joints is not None):
            raise InputError("only a step of a quasi-static scene without joints is taken again")
        who = np.ones(self.model.env_count, dtype=bool) if who is None else who
        if target_poses is None:
            wp.copy(self.end_poses, state.poses)
        elif isinstance(target_poses, wp.array):
            expected = self.end_poses
            if target_poses.shape != expected.shape or target_poses.dtype is not expected.dtype:
                raise InputError(
                    f"target poses are {target_poses.dtype.__name__} {target_poses.shape}, "
                    f"expected {expected.dtype.__name__} {expected.shape}"
                )
            wp.copy(self.end_poses, target_poses)
        else:
            end = as_poses(self.model, target_poses)
            self.end_poses.assign(end.reshape(self.end_poses.shape + (7,)))
        self._check_starts(state)
        dt = self.model.scene.time.dt_s
        self.progress.data.again.fill_(int(again))
        report = self._attempt(state, self._separate & who, dt)
        report.status[~self._separate & who] = EnvStatus.OVERLAP
        if not report.converged.all() and self.config.max_substep_halvings > 0:
            report = self._in_halves(state, report, dt, 1)
        if not report.converged[who].all():
            self.refresh_forces(state, ~report.converged & who)
        return replace(report, seconds=time.perf_counter() - started)

    def reset(self, state: State, mask: np.ndarray, poses: np.ndarray | None = None) -> None:
        """Put the environments of ``mask`` (bool, [env_count]) back to their initial state.

        ``poses``: of the kinematic bodies, [env_count, kinematic_count, 7]; those of other
        environments are ignored. The other environments are not touched.
        """
        mask = np.asarray(mask, dtype=bool)
        if poses is None:
            poses = state.poses.numpy().reshape(self.model.env_count, -1, 7)
        state.restore(initial_state(self.model, poses), mask)
        self._separate[mask] = False
        if self.joints is not None:
            self.joints.reset(mask)

    def _check_starts(self, state: State) -> None:
        """Look for overlaps where no step has been taken yet."""
        if not self.config.check_start:
            self._separate[:] = True
        elif not self._separate.all():
            from taccel_lab.scene.checks import overlapping

            self._separate |= ~overlapping(self.model, state, ~self._separate)

    # Parts of a step -----------------------------------------------------------------------------

    def _attempt(self, state: State, who: np.ndarray, dt: float) -> StepReport:
        """One undivided step of length dt in the environments ``who``, to ``end_poses``.

        Where the lists of contacts are too short it is taken again when they have grown, and where
        BDF2 met an impact by implicit Euler.
        """
        if (state.external_forces is not None or state.wrenches is not None) and self.load is None:
            self.load = ExternalLoad(self.model)
            self._share_energies()
        if dt != self._dt:
            self._dt = dt
            self.dts.fill_(dt)
        report: StepReport | None = None
        while True:
            if not np.array_equal(who, self._who):
                self._who = who.copy()
                self.progress.data.who.assign(who.astype(np.int32))
            self.graphs.launch(state)
            part = self._read_report(who)
            report = part if report is None else report.retaken(part, who)
            short = part.status == EnvStatus.CONTACT_OVERFLOW
            grown = bool(short.any()) and grow_all(self.lists)
            if grown:
                self.graphs.clear()
            impacts = part.status == EnvStatus.IMPACT
            if impacts.any():
                assert state.history is not None
                state.history.forget(impacts)
            who = impacts | short if grown else impacts
            if not who.any():
                return report

    @property
    def lists(self) -> list[GrowingList]:
        """Lists of contacts, which grow when they are too short."""
        return [*self.candidates.lists, self.collisions, self.linear.extra]

    def _read_report(self, who: np.ndarray) -> StepReport:
        found = self.progress.read()
        converged = who & (found["status"] == EnvStatus.CONVERGED)
        return StepReport(
            status=found["status"],
            newton_iterations=found["newton"].astype(np.int64),
            cg_iterations=found["cg"].astype(np.int64),
            friction_lags=found["lags"].astype(np.int64),
            residual_n=found["residual"],
            residual_ratio=found["excess"],
            contact_force_n=found["contact_force"],
            min_distance_m=found["min_distance"],
            smallest_step=found["smallest_step"],
            joint_violation_m=found["violation"],
            substeps=converged.astype(np.int64),
            seconds=0.0,
        )

    def _in_halves(self, state: State, failed: StepReport, dt: float, level: int) -> StepReport:
        """The step of length dt to ``end_poses`` again, in two halves, where it failed."""
        who = np.isin(failed.status, HALVING_HELPS)
        if not who.any():
            return failed
        before = state.copy()
        end, middle = wp.clone(self.end_poses), wp.empty_like(self.end_poses)
        ones = wp.full(len(who), 1, dtype=wp.int32, device=self.model.device)
        half = wp.full(len(who), 0.5, dtype=wp.float64, device=self.model.device)
        place_poses_between(ones, before.poses, end, half, middle)
        report = failed
        for target in (middle, end):
            wp.copy(self.end_poses, target)
            part = self._attempt(state, who, dt / 2)
            if (who & ~part.converged).any() and level < self.config.max_substep_halvings:
                part = self._in_halves(state, part, dt / 2, level + 1)
            report = report.followed_by(part)
            lost = who & ~part.converged
            if lost.any():
                state.restore(before, lost)
            who = who & part.converged
            if not who.any():
                break
        wp.copy(self.end_poses, end)
        return report

    def refresh_forces(self, state: State, who: np.ndarray) -> None:
        """Forces where ``who`` (bool, [env_count]) was rolled back, put back or never stepped."""
        run = StepRun(self, state)
        mask = run.p.active
        mask.assign(who.astype(np.int32))
        self.displacements.zero_()
        self.candidates.update(
            mask, state.positions, self.displacements, state.poses, state.poses, self.config.dhat_m
        )
        self.collisions.update(mask, state.positions, self.candidates)
        if self.friction is not None:
            self.friction.lag(mask, state.positions, self.origin)
        run.evaluate_forces(mask)
