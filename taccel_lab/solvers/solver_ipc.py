# SPDX-License-Identifier: Apache-2.0
"""The solver: steps of all environments.

A step that fails in some environments is taken there in halves, again and again, while the others
have arrived (``step`` takes the parts). Orchestration only: formulas are in ``ipc``.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.ipc.capacity import grow_all
from taccel_lab.ipc.potentials.external import ExternalLoad
from taccel_lab.model import Model
from taccel_lab.model.embedding import embed_vertices
from taccel_lab.model.env_rows import copy_rows, device_mask
from taccel_lab.model.kinematics import place_at_start, place_poses_between
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.solvers.measure_and_judge import evaluate_forces
from taccel_lab.solvers.plan import Plan, make_plan
from taccel_lab.solvers.report import EnvStatus, StepReport
from taccel_lab.solvers.solver_parts import SolverParts
from taccel_lab.solvers.step_graph import StepGraphs
from taccel_lab.solvers.step_launches import StepLaunches
from taccel_lab.state import State, initial_state, poses_array

if TYPE_CHECKING:
    from taccel_lab.ipc.overlap_search import OverlapSearch

HALVING_HELPS = [
    EnvStatus.NO_CONVERGENCE,
    EnvStatus.LINE_SEARCH,
    EnvStatus.FRICTION,
    EnvStatus.JOINT,
    EnvStatus.NOT_A_NUMBER,
]
"""Failures that a shorter step may avoid."""


class SolverIPC(SolverParts):
    """Steps a model."""

    def __init__(self, model: Model, config: SolverConfig | None = None) -> None:
        super().__init__(model, config)
        self.graphs = StepGraphs(self)
        self._start: State | None = None
        """Where environments are put back to; made by the first reset."""
        self._overlaps: OverlapSearch | None = None
        """Made by the first check of starts."""

    @property
    def plan(self) -> Plan:
        """Which parts run, and why; ``solver.plan.describe()`` prints it."""
        return make_plan(self)

    def step(
        self,
        state: State,
        target_poses: Any = None,
        *,
        who: np.ndarray | None = None,
        again: bool = False,
    ) -> StepReport:
        """Advance ``state`` in place by dt; kinematic bodies end at ``target_poses``.

        ``target_poses``: [env_count, kinematic_count, 7]; where they are when None. What is on the
        solver's device already, a torch tensor of float64, say, is not checked for its values.
        ``who``: environments to step, bool, [env_count]; all when None. The others, their forces
        too, stay as they are, with status SKIPPED.
        ``again``: take the latest step again to other targets. ``state`` is where it ended, which
        is where the search starts; friction counts sliding from where it began, or where its last
        part did if it was halved. For quasi-static scenes without joints.
        Environments that fail are tried in halves of the step, up to ``max_substep_halvings``
        times; one that fails even so is rolled back to the start of the whole step and flagged.
        Before their first step, environments are searched for bodies that overlap: these are
        flagged and not stepped (``ipc.start_checks.check_start`` says what is wrong).
        """
        started = time.perf_counter()
        if self.progress.underway.any():
            raise InputError("some environments are in a step of their own: see ReadySteps")
        if again and (self.inertia is not None or self.joints is not None):
            raise InputError("only a step of a quasi-static scene without joints is taken again")
        who = np.ones(self.model.env_count, dtype=bool) if who is None else who
        targets = state.poses if target_poses is None else poses_array(self.model, target_poses)
        wp.copy(self.end_poses, targets)
        separate = self.find_separate(state)
        dt = self.model.scene.time.dt_s
        self.progress.data.again.fill_(int(again))
        report = self._attempt(state, separate & who, dt)
        report.status[~separate & who] = EnvStatus.OVERLAP
        if not report.converged.all() and self.config.max_substep_halvings > 0:
            report = self._in_halves(state, report, dt, 1)
        if not report.converged[who].all():
            self.refresh_forces(state, ~report.converged & who)
        return replace(report, seconds=time.perf_counter() - started)

    def reset(self, state: State, mask: np.ndarray, poses: Any = None) -> None:
        """Put the environments of ``mask`` (bool, [env_count]) back to their initial state.

        ``poses``: of the kinematic bodies, as ``target_poses`` of ``step``; those of other
        environments are ignored. They stay where they are when None. The other environments are not
        touched. A step that is underway there (``ReadySteps``) is given up.
        """
        chosen = device_mask(mask, self.model.env_count, self.model.device)
        if self.progress.underway.any():
            self.progress.drop(np.asarray(mask), chosen)
        if poses is not None:
            copy_rows(chosen, poses_array(self.model, poses).to(self.model.device), state.poses)
        if self._start is None:
            self._start = initial_state(self.model).shared()
        start = replace(self._start, poses=state.poses)
        state.restore(start, chosen)
        place_at_start(self.model, state.poses, state.positions, chosen)
        embed_vertices(self.model, state.positions)
        self._separate[mask] = False
        if self.joints is not None:
            self.joints.reset(chosen)

    def find_separate(self, state: State) -> np.ndarray:
        """Environments whose bodies did not overlap before their first step, bool, [env_count]."""
        if not self.config.check_start:
            self._separate[:] = True
        elif not self._separate.all():
            if self._overlaps is None:
                from taccel_lab.ipc.overlap_search import OverlapSearch

                self._overlaps = OverlapSearch(self.model)
            new = device_mask(~self._separate, self.model.env_count, self.model.device)
            self._separate[:] |= self._overlaps.find(state, new).numpy() == 0
        return self._separate

    # Parts of a step -----------------------------------------------------------------------------

    def _attempt(self, state: State, who: np.ndarray, dt: float) -> StepReport:
        """One undivided step of length dt in the environments ``who``, to ``end_poses``.

        Where the lists of contacts are too short it is taken again when they have grown, and where
        BDF2 met an impact by implicit Euler.
        """
        report: StepReport | None = None
        while True:
            part = self.attempt_once(state, who, dt)
            report = part if report is None else report.retaken(part, who)
            short = part.status == EnvStatus.CONTACT_OVERFLOW
            if short.any():
                short &= ~grow_all(self.lists)
                if short.any():
                    self.graphs.clear()
            impacts = part.status == EnvStatus.IMPACT
            if impacts.any():
                assert state.history is not None
                state.history.forget(impacts)
            who = impacts | short
            if not who.any():
                return report

    def attempt_once(self, state: State, who: np.ndarray, dt: float) -> StepReport:
        """One undivided step in the environments ``who``; lists may be too short."""
        if (state.external_forces is not None or state.wrenches is not None) and self.load is None:
            self.load = ExternalLoad(self.model)
            self.share_energies()
            self.graphs.clear()
        if dt != self._dt:
            self._dt = dt
            self.dts.fill_(dt)
        if not np.array_equal(who, self._who):
            self._who = who.copy()
            self.progress.data.who.assign(who.astype(np.int32))
        self.graphs.launch(state)
        return self._read_report(who)

    def _read_report(self, who: np.ndarray) -> StepReport:
        found = self.progress.read()
        converged = who & (found["status"] == EnvStatus.CONVERGED)
        return StepReport(
            status=found["status"],
            newton_iterations=found["newton"].astype(np.int64),
            cg_iterations=found["cg"].astype(np.int64),
            friction_lags=found["lags"].astype(np.int64),
            searches=found["searches"].astype(np.int64),
            ccd_passes=found["ccd_passes"].astype(np.int64),
            starts_tried=found["starts_tried"].astype(np.int64),
            starts_taken=found["starts_taken"].astype(np.int64),
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
        run = StepLaunches(self, state)
        mask = run.p.active
        mask.assign(who.astype(np.int32))
        self.displacements.zero_()
        self.candidates.update(
            mask, state.positions, self.displacements, state.poses, state.poses, self.config.dhat_m
        )
        self.pairs.forget(mask)
        self.collisions.update(mask, state.positions, self.candidates)
        if self.friction is not None:
            self.friction.lag(mask, state.positions, self.origin)
        evaluate_forces(run, mask)
