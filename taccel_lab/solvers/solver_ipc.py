# SPDX-License-Identifier: Apache-2.0
"""The solver: steps of all environments.

A step that fails in some environments is taken there in halves, again and again, while the others
have arrived (``step`` takes the parts). Orchestration only: formulas are in ``ipc``.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from threading import get_ident
from typing import TYPE_CHECKING, Any
from weakref import ref

import numpy as np
import warp as wp

from taccel_lab.bodies.scene_description import LONGEST_HOLD_S, check_dt
from taccel_lab.errors import InputError
from taccel_lab.ipc.contact.blocked_ways import BlockedWays
from taccel_lab.ipc.device.ragged_lists import grow_all
from taccel_lab.ipc.potentials.external import ExternalLoad
from taccel_lab.model import Model
from taccel_lab.model.env_rows import checked_mask, copy_rows, device_mask, given_array, on_device
from taccel_lab.model.kinematics import place_poses_between
from taccel_lab.model.launches import CapturedWork
from taccel_lab.model.turns import TURNS, in_turn
from taccel_lab.solvers.config import Control, SolverConfig
from taccel_lab.solvers.env_progress import NO_LIMIT
from taccel_lab.solvers.measure import evaluate_forces
from taccel_lab.solvers.one_writer import writing
from taccel_lab.solvers.plan import Plan, make_plan
from taccel_lab.solvers.solver_parts import SolverParts
from taccel_lab.solvers.starts import Starts
from taccel_lab.solvers.step_graph import launch_step
from taccel_lab.solvers.step_launches import StepLaunches
from taccel_lab.solvers.step_report import EnvStatus, StepReport, flagged_blocked
from taccel_lab.state import State, as_poses, check_state, poses_array
from taccel_lab.typed import typed

wp.set_module_options({"enable_backward": False})

if TYPE_CHECKING:
    from taccel_lab.ipc.contact.overlap_search import OverlapSearch

HALVING_HELPS = [
    EnvStatus.NO_CONVERGENCE,
    EnvStatus.STALLED,
    EnvStatus.LINE_SEARCH,
    EnvStatus.FRICTION,
    EnvStatus.JOINT,
    EnvStatus.NOT_A_NUMBER,
    EnvStatus.CONTACT_OVERFLOW,
]
"""Failures that a shorter step may avoid. A list is too short for good where a whole step may meet
too much on its way."""


@typed
class SolverIPC(SolverParts):
    """Steps a model.

    What a step depends on stands in the ``State`` that it is given: states may take turns on one
    solver, and solvers on one state. Here is nothing but room to work in, what the last step says
    of forces, and the pairs near each other that it found, which are checked before they are used.
    """

    @in_turn
    def __init__(self, model: Model, config: SolverConfig | None = None) -> None:
        super().__init__(model, config)
        self.graph = CapturedWork(model.device, self.config.capture)
        self.everyone = np.ones(model.env_count, dtype=bool)
        """Masks of all environments and of none, bool, [env_count]; not to be changed."""
        self.nobody = np.zeros(model.env_count, dtype=bool)
        self._starts: Starts | None = None
        """Made by the first reset."""
        self.ways = BlockedWays(model)
        """What is held in the way of kinematic bodies."""
        self._overlaps: OverlapSearch | None = None
        """Made by the first check of starts."""
        self._changes = -1
        """Count of changes of the model's parameters, as they were followed last."""
        self._torn = False
        """Whether a step is at work, or was interrupted."""
        self._latest: Callable[[], State | None] | None = None
        """The state that forces and contacts are those of; None before the first step."""
        self._thread: dict[str, int] = {}
        """The thread that is at work."""

    def __repr__(self) -> str:
        return f"solver of a {self.model!r}"

    @property
    def plan(self) -> Plan:
        """Which parts run, and why; ``solver.plan.describe()`` prints it."""
        return make_plan(self)

    def step(
        self,
        state: State,
        control: Control | Any = None,
        *,
        who: np.ndarray | None = None,
        again: bool = False,
        ahead: Callable[[wp.array], None] | None = None,
    ) -> StepReport:
        """Advance ``state`` in place by dt.

        ``control``: targets and loads of the step; an array is taken for ``Control.target_poses``.
        ``who``: environments to step, bool, [env_count]; all when None. The others, their forces
        too, stay as they are, with status SKIPPED.
        ``again``: take the latest step again to other targets. ``state`` is where it ended, which
        is where the search starts; friction counts sliding from where it began, or where its last
        part did if it was halved. For quasi-static scenes without joints.
        ``ahead``: writes where free nodes of gels may be once the kinematic bodies have arrived
        [m], vec3d, [env_count, node_count]. The search starts there where no element is inside out;
        that no node is inside a body, the caller sees to.
        Environments that fail are tried in halves of the step, up to ``max_substep_halvings``
        times and ``max_step_iterations`` Newton iterations; one that fails even so is rolled back
        to the start of the whole step and flagged.
        Environments whose bodies overlap before their first step are flagged and not stepped
        (``ipc.contact.overlap_search.require_separated`` says what is wrong). Those that fail are
        not tried in parts where ``ways`` has what is held in their way.

        The host waits once, for the report, 80 bytes an environment: it says what is taken again.
        """
        started = time.perf_counter()
        with self.at_work(state):
            if self.progress.underway.any():
                raise InputError("some environments are in their own step: see ReadySteps")
            if again:
                self._require_again(state)
            # A copy, as masks that the device holds are compared with the next ones.
            who = self.everyone if who is None else checked_mask(who, self.model.env_count).copy()
            dt = self.take(control, state)
            self.follow_parameters()
            self.search_overlaps(state)
            self.begin(state)
            self.orders.tell("again", self.everyone if again else self.nobody)
            self.orders.look(ahead)
            self.limit_rounds(NO_LIMIT)
            report = self._attempt(who, dt, whole=True)
            self.orders.look(None)
            report = self.find_blocked(state, report, who)
            if not report.converged.all() and self.config.max_substep_halvings > 0:
                report = self._in_halves(report, dt, 1, np.zeros(len(who), dtype=np.int64))
            if not report.converged[who].all():
                self._evaluate_forces(~report.converged & who)
            if (report.substeps > 1).any():
                self._write(report.converged)
            self.end(state)
        return report.timed(time.perf_counter() - started)

    def reset(self, state: State, mask: Any, poses: Any = None) -> None:
        """Put the environments of ``mask`` back to their initial state, on the device.

        ``mask``: bool, [env_count]; on the solver's device also int32 (see ``device_mask``).
        ``poses``: of the kinematic bodies, as ``target_poses`` of ``step``; those of other
        environments are ignored. They stay where they are when None. The other environments are not
        touched. A step that is underway there (``ReadySteps``) is given up.
        """
        with self.at_work(state):
            check_state(state, self.model)
            if self._starts is None:
                self._starts = Starts(self.model, self.joints, self.config.capture)
            start = state.poses if poses is None else poses_array(self.model, poses)
            self._starts.choose(mask)
            if self.progress.underway.any():
                # A mask of the host is not read back: the host would wait.
                who = self._starts.mask.numpy() != 0 if on_device(mask) else np.asarray(mask)
                self.progress.drop(who, self._starts.mask)
            self._starts.put(state, start)

    def refresh_forces(self, state: State, who: np.ndarray) -> None:
        """Compute contacts and forces of a state where ``who`` (bool, [env_count]) was put
        somewhere and not stepped."""
        with self.at_work(state):
            check_state(state, self.model)
            self.begin(state)
            self._evaluate_forces(checked_mask(who, self.model.env_count))
            self.end(state)

    def require_latest(self, state: State) -> None:
        """Refuse to read forces of a state when the last step was one of another state.

        Raises:
            InputError: It was, or was interrupted; or the state is one of another model.
        """
        check_state(state, self.model)
        if self._latest is not None and self._latest() is not state:
            raise InputError(
                "the solver's last step was of another state, or was interrupted, and forces and "
                "contacts are those of the last step: step this state, then read"
            )

    def _require_again(self, state: State) -> None:
        if self.inertia is not None or self.joints is not None:
            raise InputError("only a step of a quasi-static scene without joints is taken again")
        if self._latest is None or self._latest() is not state:
            raise InputError(
                "only the latest step of a solver is taken again, and that was not one of this "
                "state: step it first"
            )

    # Before and after ----------------------------------------------------------------------------

    @contextmanager
    def at_work(self, state: State | None = None) -> Iterator[None]:
        """Take the turn of this thread, at a solver that no other one is using and nothing is left
        in of a step that was interrupted; and ``state``, if any, until its steps are over.

        Raises:
            InputError: Another thread is stepping it, another solver steps the state, or this one
                has steps of another state underway.
        """
        if self._thread.setdefault("at work", get_ident()) != get_ident():
            raise InputError(
                "another thread is stepping this solver: give each thread its own solver and "
                "state; models may be shared"
            )
        try:
            with nullcontext() if state is None else writing(state, self), TURNS:
                self.recover()
                yield
        finally:
            self._thread.pop("at work", None)

    @property
    def underway(self) -> bool:
        """Whether steps are underway that the next call goes on with."""
        return not self._torn and bool(self.progress.underway.any())

    def recover(self) -> None:
        """Forget what a step that was interrupted has left: steps underway, pairs, rooms."""
        if not self._torn:
            return
        mask = device_mask(self.everyone, self.model.env_count, self.model.device)
        self.progress.drop(self.everyone, mask)
        for part in self.lists:
            part.renew()
        self.pairs.forget(mask)
        self.graph.clear()
        self.orders.repeat()
        self._dt, self._changes, self._rounds = math.nan, -1, 0
        self._torn = False

    def begin(self, state: State) -> None:
        """Step ``state`` from now on."""
        self._torn = True
        self._latest = lambda: None
        state.complete(self.model)
        if self.rows.point(state, self.config.check_start):
            self.graph.clear()

    def end(self, state: State) -> None:
        """Nothing is left to do: contacts and forces are those of ``state``."""
        self._latest = ref(state)
        self._torn = False

    def follow_parameters(self) -> None:
        """Update what depends on parameters of bodies that were set since the last step."""
        if self._changes != self.model.changes:
            rounding = self.progress.search.energy_rounding
            rounding.zero_()
            everyone = wp.full(self.model.env_count, 1, dtype=wp.int32, device=self.model.device)
            for part in self.elastic:
                part.add_energy_rounding(everyone, rounding)
            self._changes = self.model.changes

    def search_overlaps(self, state: State) -> None:
        """Search for bodies that overlap where nobody has looked yet; no step begins there."""
        state.complete(self.model)
        if state.searched or not self.config.check_start:
            return
        if self._overlaps is None:
            from taccel_lab.ipc.contact.overlap_search import OverlapSearch

            self._overlaps = OverlapSearch(self.model, self.config.capture)
        assert state.unsearched is not None
        self._overlaps.mark(state.positions, state.unsearched)
        state.searched = True

    def find_blocked(self, state: State, report: StepReport, who: np.ndarray) -> StepReport:
        """Flag environments of ``who`` (bool, [env_count]) whose step from ``state`` failed as
        something held is in its way."""
        failed = who & ~report.converged & (report.status != int(EnvStatus.OVERLAP))
        return flagged_blocked(report, self.ways.of_step(state, self.end_poses, failed))

    def take(self, control: Control | Any, state: State, mask: np.ndarray | None = None) -> float:
        """Check targets and loads of a step, then copy them to where the step reads them, in the
        environments of ``mask`` (bool, [env_count]), in all when None; returns dt [s]. Targets are
        copied in all: only steps that begin read them."""
        model = self.model
        check_state(state, model)
        if not isinstance(control, Control):
            control = Control(target_poses=control)
        poses = control.target_poses
        targets = state.poses
        if poses is not None:
            targets = poses_array(model, poses) if on_device(poses) else as_poses(model, poses)
        dt = model.scene.time.dt_s
        if control.dt_s is not None:
            if self.inertia is None and not self.maxwell:
                raise InputError(
                    "dt_s of a step needs quasi_static=False or a material with Maxwell branches: "
                    "otherwise it has none"
                )
            check_dt(control.dt_s, 10.0 if self.inertia is not None else LONGEST_HOLD_S)
            dt = float(control.dt_s)
        drives = None
        if control.joint_targets is not None:
            if self.joints is None:
                raise InputError("joint_targets are given, but the scene has no joints")
            shape = self.joints.state.targets.shape
            values = control.joint_targets
            drives = given_array(values, "joint_targets", shape, wp.float64, model.device)
        if control.forces is not None or control.wrenches is not None:
            state.load(model, control.forces, control.wrenches, mask)
        if drives is not None:
            state.complete(model)
            assert state.joints is not None
            those = None if mask is None else device_mask(mask, model.env_count, model.device)
            copy_rows(those, drives, state.joints.targets)
        self.orders.aim(targets)
        return dt

    def set_dt(self, dt: float, mask: np.ndarray | None = None, whole: bool = True) -> None:
        """Set the length [s] of steps that begin from now on, ``whole`` ones or parts of one, in
        the environments of ``mask`` (bool, [env_count]), in all when None."""
        changed = [self.dts] if dt != self._dt else []
        self._dt = dt if mask is None or not changed else math.nan
        if whole and self.inertia is None and self.maxwell:
            changed.append(self.whole_dts)
        for array in changed:
            if mask is None:
                array.fill_(dt)
            else:
                one = wp.full(1, dt, dtype=wp.float64, device=self.model.device)
                copy_rows(device_mask(mask, len(mask), self.model.device), one, array)

    # Parts of a step -----------------------------------------------------------------------------

    def _attempt(self, who: np.ndarray, dt: float, whole: bool = False) -> StepReport:
        """One undivided step of length dt in the environments ``who``, to ``end_poses``: the
        ``whole`` step, from the user's state to it, or a part, from and to ``work``.

        Where the lists of contacts are too short it is taken again when they have grown, and where
        BDF2 met an impact by implicit Euler.
        """
        report: StepReport | None = None
        self.set_dt(dt, whole=whole)
        reads, writes = (who, self.everyone) if whole else (self.nobody, self.nobody)
        while True:
            part = self.attempt_once(who, reads, writes)
            report = part if report is None else report.retaken(part, who)
            who = self.prepare_again(part.status)
            reads = self.nobody
            if not who.any():
                return report

    def prepare_again(self, status: np.ndarray) -> np.ndarray:
        """Find the environments whose attempt has to be repeated, by its ``status``; bool,
        [env_count]. They are those whose lists of contacts were too short, which are longer now,
        and those that met an impact, which forget the step before."""
        short = status == int(EnvStatus.CONTACT_OVERFLOW)
        if short.any():
            short &= ~grow_all(self.lists)
        impacts = status == int(EnvStatus.IMPACT)
        if impacts.any():
            assert self.work.history is not None
            self.work.history.forget(impacts)
        return impacts | short

    def attempt_once(self, who: np.ndarray, reads: np.ndarray, writes: np.ndarray) -> StepReport:
        """Try one undivided step in the environments ``who``; lists may be too short. Those of
        ``reads`` are read from the user's state first, those of ``writes`` written to it where they
        converge; masks all, bool, [env_count]."""
        if self.work.external_forces is not None and self.load is None:
            self.load = ExternalLoad(self.model)
            self.share_energies()
            self.graph.clear()
        for name, mask in (("who", who), ("reads", reads), ("writes", writes)):
            self.orders.tell(name, mask)
        self.orders.send(self.trial)
        self.progress.report.outdate()
        launch_step(self.graph, self)
        self.progress.report.fetch()
        TURNS.wait_for(self.model.device)
        return StepReport.of_block(self.progress.report)

    def _in_halves(
        self, failed: StepReport, dt: float, level: int, spent: np.ndarray
    ) -> StepReport:
        """The step of length dt to ``end_poses`` again, in two halves, where it failed. ``spent``:
        Newton iterations of the whole step before it, [env_count]."""
        budget = self.config.max_step_iterations
        who = np.isin(failed.status, HALVING_HELPS)
        who &= spent + failed.newton_iterations < budget
        if not who.any():
            return failed
        before = self.work.copy()
        end, middle = wp.clone(self.end_poses), wp.empty_like(self.end_poses)
        ones = wp.full(len(who), 1, dtype=wp.int32, device=self.model.device)
        half = wp.full(len(who), 0.5, dtype=wp.float64, device=self.model.device)
        place_poses_between(ones, before.poses, end, half, middle)
        report = failed
        for target in (middle, end):
            wp.copy(self.end_poses, target)
            part = self._attempt(who, dt / 2)
            if (who & ~part.converged).any() and level < self.config.max_substep_halvings:
                before_part = spent + report.newton_iterations
                part = self._in_halves(part, dt / 2, level + 1, before_part)
            report = report.followed_by(part)
            lost = who & ~part.converged
            if lost.any():
                self.work.restore(before, lost)
            who = who & part.converged
            if not who.any():
                break
        wp.copy(self.end_poses, end)
        return report

    def _write(self, who: np.ndarray) -> None:
        """Write ``work`` to the user's state where ``who`` (bool, [env_count]); wait for it, as the
        stream may be another one later."""
        mask = device_mask(who, len(who), self.model.device)
        self.rows.write(mask, mask)
        if self.model.device.is_cuda:
            wp.synchronize_stream(self.model.device)

    def _evaluate_forces(self, who: np.ndarray) -> None:
        """Forces of the user's state where ``who``, bool, [env_count]."""
        run, work = StepLaunches(self), self.work
        # The smallest gap, for one, is found anew.
        self.progress.report.outdate()
        mask = run.p.phases.active
        mask.assign(who.astype(np.int32))
        self.rows.read(mask)
        self.find_contacts(mask, work)
        if self.friction is not None:
            self.friction.lag(mask, work.positions, self.origin)
        evaluate_forces(run, mask)
