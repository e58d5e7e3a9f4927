# SPDX-License-Identifier: Apache-2.0
"""Sweeps of several objectives with Optuna: constraints, several processes at once.

Methods are a Gaussian process with log expected improvement (GP), a tree-structured Parzen
estimator (TPE) and the genetic algorithm NSGA-II (NSGA2).

The trials stand in a journal file that processes share (``JournalStorage``); each asks it what to
try next and tells it what came out. What is known of a design is its row: a row without a trial
becomes one, so that a lost journal costs nothing but its order.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taccel_lab.errors import InputError
from taccel_lab.files.inner_path import own_place
from taccel_lab.studies.evaluate.optimise import Figures, OptimiserState, Try
from taccel_lab.studies.spec.axis import Axis
from taccel_lab.studies.spec.study_file import Constraint, Objective, Sweep

if TYPE_CHECKING:
    import optuna
    from optuna.storages.journal import JournalFileOpenLock

JOURNAL = "optuna.journal"
MOST_REPEATS = 30
"""Proposals of known designs in a row after which a search is over."""
_EXCESS = "excess"


def optimise_with_optuna(
    axes: Sequence[Axis],
    objectives: Sequence[Objective],
    constraints: Sequence[Constraint],
    sweep: Sweep,
    seed: int,
    attempt: Try,
    *,
    journal: Path,
    known: Callable[[], Sequence[tuple[Mapping[str, Any], Figures]]] = tuple,
) -> OptimiserState:
    """Try designs until ``sweep.count`` different ones are tried, by all processes together.

    Args:
        axes: What may be varied.
        objectives: Trials spread along their front.
        constraints: Kept as far as can be.
        sweep: Method and count.
        seed: Of the sampler; processes of one study need their own seeds.
        attempt: Figures of a design.
        journal: File of the trials, shared by processes.
        known: Values and figures of designs with a row.

    Raises InputError where Optuna is not installed, and for a journal that is a link.
    """
    try:
        import optuna
        from optuna.storages import JournalStorage
        from optuna.storages.journal import JournalFileBackend
    except ImportError as error:
        raise InputError(
            f"method {sweep.method!r} needs Optuna: pip install taccel-lab[optuna]"
        ) from error
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    problem = _Problem(axes, objectives, constraints)
    own_place(journal.parent, journal.name)
    study = optuna.create_study(
        storage=JournalStorage(JournalFileBackend(str(journal), _lock_of(journal))),
        study_name=problem.name,
        directions=["minimize" if o.sign > 0 else "maximize" for o in objectives],
        sampler=_sampler(sweep.method, seed, bool(constraints)),
        load_if_exists=True,
    )
    there = {_place(trial.params) for trial in study.get_trials(deepcopy=False)}
    for values, figures in known():
        params = {axis.name: values[axis.name] for axis in axes}
        if _place(params) not in there and problem.holds(params):
            study.add_trial(problem.trial(params, figures, study))
    state, repeats = OptimiserState(), 0
    count = sweep.count or 1
    while True:
        tried = _tried(study)
        if len(tried) >= count:
            state.stopped = "the count of designs was used up"
            break
        if repeats >= MOST_REPEATS:
            state.stopped = "designs repeated themselves"
            break
        trial = study.ask(problem.distributions)
        values = {axis.name: axis.at(axis.unit_of(trial.params[axis.name])) for axis in axes}
        repeats = repeats + 1 if _place(trial.params) in tried else 0
        try:
            found = attempt(values)
        except BaseException:
            study.tell(trial, state=optuna.trial.TrialState.FAIL)
            raise
        trial.set_user_attr(_EXCESS, problem.excess(found))
        costs = problem.costs(found) or problem.worst(study)
        if costs is None:
            study.tell(trial, state=optuna.trial.TrialState.FAIL)
        else:
            study.tell(trial, costs)
    state.tried = [
        {axis.name: axis.at(axis.unit_of(params[axis.name])) for axis in axes}
        for params in _tried(study).values()
    ]
    return state


def _lock_of(journal: Path) -> JournalFileOpenLock:
    """Optuna's own lock is a link that outlives a killed process and holds the others up for half a
    minute; and the half line that one leaves would spoil the next, and with it the journal."""
    from optuna.storages.journal import JournalFileOpenLock

    class Lock(JournalFileOpenLock):
        def acquire(self) -> bool:
            self._file = open(journal, "rb+")
            fcntl.flock(self._file, fcntl.LOCK_EX)
            if self._file.seek(0, os.SEEK_END):
                self._file.seek(-1, os.SEEK_END)
                if self._file.read(1) != b"\n":
                    self._file.seek(0)
                    self._file.truncate(self._file.read().rfind(b"\n") + 1)
            return True

        def release(self) -> None:
            self._file.close()

    return Lock(str(journal))


def _tried(study: optuna.Study) -> dict[tuple[Any, ...], dict[str, Any]]:
    """Values of the trials that came to an end, of each design once."""
    trials = study.get_trials(deepcopy=False)
    ended = [t for t in trials if t.state.is_finished() and _EXCESS in t.user_attrs]
    return {_place(trial.params): trial.params for trial in ended}


def _place(params: Mapping[str, Any]) -> tuple[Any, ...]:
    """Equal for a trial and the row that came of it, whose values are rounded."""
    return tuple(sorted((name, float(f"{value:.7g}")) for name, value in params.items()))


def _sampler(method: str, seed: int, constrained: bool) -> optuna.samplers.BaseSampler:
    import warnings

    from optuna.exceptions import ExperimentalWarning
    from optuna.samplers import GPSampler, NSGAIISampler, TPESampler

    excess = _excess_of if constrained else None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        if method == "GP":
            return GPSampler(seed=seed, deterministic_objective=True, constraints_func=excess)
        if method == "TPE":
            return TPESampler(seed=seed, constraints_func=excess)
        return NSGAIISampler(seed=seed, constraints_func=excess)


def _excess_of(trial: optuna.trial.FrozenTrial) -> Sequence[float]:
    return trial.user_attrs[_EXCESS]


class _Problem:
    """The study as Optuna sees it."""

    def __init__(
        self,
        axes: Sequence[Axis],
        objectives: Sequence[Objective],
        constraints: Sequence[Constraint],
    ) -> None:
        import optuna

        self._axes, self._objectives, self._constraints = axes, objectives, constraints
        self.distributions: dict[str, optuna.distributions.BaseDistribution] = {
            axis.name: optuna.distributions.IntDistribution(int(axis.low), int(axis.high))
            if axis.whole
            else optuna.distributions.FloatDistribution(axis.low, axis.high, log=axis.log)
            for axis in axes
        }

    @property
    def name(self) -> str:
        """Name of the Optuna study: another for another question, so that trials are not mixed."""
        from taccel_lab.files.atomic_file import content_id

        return content_id(
            [
                {name: str(found) for name, found in self.distributions.items()},
                [o.model_dump() for o in self._objectives],
                [c.model_dump() for c in self._constraints],
            ]
        )

    def holds(self, params: Mapping[str, Any]) -> bool:
        """Whether values lie within the ranges."""
        return all(a.low <= float(params[a.name]) <= a.high for a in self._axes)

    def costs(self, figures: Figures) -> list[float] | None:
        """Values of the objectives; None where one is missing."""
        values = [figures.get(objective.metric) for objective in self._objectives]
        return (
            None if any(v is None for v in values) else [float(v) for v in values if v is not None]
        )

    def excess(self, figures: Figures) -> list[float]:
        """How far each constraint is broken, as a part of its bound; at most 0 where it is kept."""
        found = []
        bounds = [b for constraint in self._constraints for b in reversed(constraint.bounds)]
        for bound in bounds:
            value = figures.get(bound.metric)
            scale = abs(bound.limit) or 1.0
            found.append(1.0 if value is None else bound.beyond(value) / scale)
        return found

    def worst(self, study: optuna.Study) -> list[float] | None:
        """Worst value of each objective so far: stands for a figure that cannot be had, so that
        samplers, which pass failed trials over, go elsewhere. None where there is none yet."""
        ended = [t.values for t in study.get_trials(deepcopy=False) if t.values]
        if not ended:
            return None
        return [
            o.sign * max(o.sign * value for value in column)
            for o, column in zip(self._objectives, zip(*ended, strict=True), strict=True)
        ]

    def trial(
        self, params: Mapping[str, Any], figures: Figures, study: optuna.Study
    ) -> optuna.trial.FrozenTrial:
        """A finished trial of a design that has a row."""
        import optuna

        costs = self.costs(figures) or self.worst(study)
        states = optuna.trial.TrialState
        return optuna.trial.create_trial(
            params=dict(params),
            distributions=self.distributions,
            values=costs,
            state=states.FAIL if costs is None else states.COMPLETE,
            user_attrs={_EXCESS: self.excess(figures)},
            # What samplers note of a trial that they see end.
            system_attrs={"constraints": self.excess(figures)} if self._constraints else {},
        )
