# SPDX-License-Identifier: Apache-2.0
"""Runs a study: evaluates the designs that have no row yet, and writes the table as rows come."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from taccel_lab.errors import InputError, SimulationError
from taccel_lab.files.shard import Shard
from taccel_lab.processes.process_pool import Died, Finished, ProcessPool, Underway, usable_cores
from taccel_lab.studies.evaluate.batches import (
    DesignBatch,
    broken_row,
    evaluate_batch,
    gather_batches,
    sharing_key,
)
from taccel_lab.studies.evaluate.design_row import DesignRow, directed, ranked
from taccel_lab.studies.evaluate.optimise import OptimiserState, optimise
from taccel_lab.studies.evaluate.optimise_optuna import JOURNAL, optimise_with_optuna
from taccel_lab.studies.evaluate.study_folder import StudyFolder, write_table
from taccel_lab.studies.metrics.design_point import DesignPoint
from taccel_lab.studies.spec.study import Kit, Study
from taccel_lab.summary import Summary

TABLE_EVERY_S = 2.0
"""The table is rewritten at most this often while designs come in, and at the end."""


class Listener(Protocol):
    """Receives how a run goes; what is left out here does nothing."""

    def begins(self, total: int, there: int, to_do: int) -> None:
        """Designs in all (an optimiser's: at most), those with a row already, and to do now."""

    def finished(self, design: DesignRow) -> None:
        """A design's row has been written."""

    def underway(self, worker: int, what: str, done: int, total: int) -> None:
        """What one process is doing."""


class _Nobody(Listener): ...


@dataclass(repr=False)
class StudyOutcome(Summary):
    """Where a study stands after a run."""

    study: Study
    folder: StudyFolder
    rows: list[DesignRow]
    """Rows in the order of the sweep; designs without a row are left out."""
    total: int
    """Designs of the sweep; of an optimiser, those that it tried."""
    new: int = 0
    """Rows of this run."""
    seconds: float = 0.0
    """Wall time of this run."""
    processes: int = 0
    device: str = "cpu"
    optimiser: OptimiserState | None = None
    """None for other sweeps, and for an optimiser that was interrupted."""
    others: int = 0
    """Designs with a row that this study file does not ask for."""

    @property
    def done(self) -> list[DesignRow]:
        """Designs that have figures."""
        return [row for row in self.rows if row.status == "done"]

    def summary(self) -> tuple[str, list[tuple[str, str]]]:
        """How many designs have figures, and the first goal's best."""
        spec = self.study.spec
        rows = [
            ("designs", f"{len(self.done)} of {self.total} with figures, {self.new} new"),
            ("folder", str(self.folder.root)),
        ]
        for goal in directed(spec.goals, self.study.metrics)[:1]:
            for row in ranked(self.rows, goal, spec.constraints)[:1]:
                name = self.study.name_of(row.parameters)
                rows.append((goal.text(), f"{row.figures[goal.metric]:.4g}: {name}"))
        return f"study {spec.study.name} of {self.study.family.name}", rows

    def require_whole(self) -> None:
        """Raise SimulationError where designs were lost, to a process that died or to a fault."""
        lost = [row for row in self.rows if row.status == "broken"]
        if lost:
            raise SimulationError(
                f"{len(lost)} of {len(self.rows)} designs were lost, the first one as "
                f"{lost[0].causes['design']}; the others are kept, and the next run tries again"
            )

    @property
    def complete(self) -> bool:
        """Whether the sweep has finished."""
        if self.study.spec.sweep.kind == "optimize":
            return self.optimiser is not None
        return len(self.rows) == self.total


Pool = ProcessPool[DesignBatch, None]


class _LimitReached(Exception):
    """Stops a study after as many new designs as the caller wanted."""


def default_kit() -> Kit:
    """The standard presses and metrics on our solver."""
    from taccel_lab.studies.evaluate.evaluate import evaluate_designs
    from taccel_lab.studies.metrics import METRICS
    from taccel_lab.studies.presses.standard import STANDARD_PRESSES

    return Kit(STANDARD_PRESSES, METRICS, evaluate_designs)


def default_processes(device: str) -> int:
    """One a core this process may use; one for a GPU."""
    return 1 if device.startswith("cuda") else usable_cores()


def run_study(
    study: Study,
    root: Path | str,
    *,
    device: str | None = None,
    processes: int | None = None,
    limit: int | None = None,
    shard: Shard | None = None,
    source: str = "",
    listener: Listener | None = None,
) -> StudyOutcome:
    """Evaluate what has no row yet; rows, files and the table stand in the folder ``root``.

    Args:
        study: What to run.
        root: Folder of the study, new or begun.
        device: Warp device; the study file's when None.
        processes: How many; 0 works in this process. The study file's, or one a core, when None.
        limit: New designs at most.
        shard: Which part of the designs, of several runs that share the folder; each takes designs
            that share simulations together, and none writes the table. Shards of an optimiser of
            several objectives ask one journal what to try next.
        source: Text of the study file, kept beside the results.
        listener: Receives how it goes.

    Raises:
        InputError: A folder with other files, in use, or of a study of another sensor.
    """
    device = study.spec.run.device if device is None else device
    if processes is None:
        processes = study.spec.run.processes or default_processes(device)
    folder = StudyFolder(root)
    folder.require_usable()
    begun = time.perf_counter()
    if shard is not None and study.spec.sweep.kind == "optimize" and not _by_optuna(study):
        raise InputError("NLopt goes on from what it saw; shards need several objectives")
    with folder.locked(shard):
        _require_same_sensor(study, folder)
        if source:
            folder.write_text("study.toml", source)
        run = _Run(study, folder, device, processes, limit, listener or _Nobody(), shard)
        outcome = run.go()
        outcome.seconds = time.perf_counter() - begun
        return outcome


def read_outcome(study: Study, root: Path | str) -> StudyOutcome:
    """Where a study stands, without evaluating anything. Raises InputError where there is none."""
    folder = StudyFolder(root)
    if not folder.is_study():
        raise InputError(f"{folder.root} holds no study; run it first")
    _require_same_sensor(study, folder)
    return _Run(study, folder, study.spec.run.device, 0, 0, _Nobody()).go()


def _by_optuna(study: Study) -> bool:
    return len(study.spec.goals) > 1


def _require_same_sensor(study: Study, folder: StudyFolder) -> None:
    for design_id in folder.ids()[:1]:
        found = folder.read(design_id)
        if found is not None and found.family != study.family.name:
            raise InputError(
                f"{folder.root} holds a study of the sensor {found.family!r}, not of "
                f"{study.family.name!r}; name another folder"
            )


def _part(study: Study, points: list[DesignPoint], shard: Shard) -> list[DesignPoint]:
    """Designs of a shard: every n-th group of those that share simulations, whatever has a row."""
    groups: dict[str, int] = {}
    return [
        point
        for point in points
        if groups.setdefault(sharing_key(study.family, point), len(groups)) % shard.count
        == shard.number - 1
    ]


class _Run:
    """One run of a study."""

    def __init__(
        self,
        study: Study,
        folder: StudyFolder,
        device: str,
        processes: int,
        limit: int | None,
        listener: Listener,
        shard: Shard | None = None,
    ) -> None:
        self._study, self._folder, self._listener = study, folder, listener
        self._shard = shard
        self._device, self._processes, self._limit = device, processes, limit
        self._rows: dict[str, DesignRow] = {}
        self._order: list[str] = []
        self._new = 0
        self._table_at = 0.0
        self._figure_keys, self._press_keys = study.figure_keys, study.press_keys

    def go(self) -> StudyOutcome:
        optimiser = None
        try:
            work = partial(evaluate_batch, self._study, self._folder.root, self._device)
            with ProcessPool(work, self._processes) as pool:
                if self._study.spec.sweep.kind == "optimize":
                    total, optimiser = self._optimise(pool)
                else:
                    total = self._sweep(pool)
        finally:
            self._write_table()
        return StudyOutcome(
            study=self._study,
            folder=self._folder,
            rows=self._in_order(),
            total=total,
            new=self._new,
            processes=self._processes,
            device=self._device,
            optimiser=optimiser,
            others=len(set(self._folder.ids()) - set(self._order)),
        )

    def _sweep(self, pool: Pool) -> int:
        points = self._study.points()
        if self._shard is not None:
            points = _part(self._study, points, self._shard)
        self._order = [point.id for point in points]
        to_do = [self._wanted(point) for point in points if not self._take_row(point)]
        to_do = to_do[: self._limit]
        self._listener.begins(len(points), len(self._rows), len(to_do))
        self._evaluate(pool, gather_batches(self._study.family, to_do, self._device))
        return len(points)

    def _optimise(self, pool: Pool) -> tuple[int, OptimiserState | None]:
        spec = self._study.spec
        count = spec.sweep.count or 1
        self._listener.begins(count, 0, count)

        def prepare(designs: Sequence[dict[str, Any]]) -> None:
            points = [self._study.point(swept) for swept in designs]
            there = [point for point in points if self._take_row(point)]
            for point in there:
                self._listener.finished(self._rows[point.id])
            to_do = [self._wanted(point) for point in points if point not in there]
            if self._limit is not None:
                to_do = to_do[: self._limit - self._new]
            self._evaluate(pool, gather_batches(self._study.family, to_do, self._device))
            self._order += [p.id for p in points if p.id in self._rows and p.id not in self._order]

        def attempt(swept: dict[str, Any]) -> dict[str, float | None]:
            point = self._study.point(swept)
            if point.id not in self._order:
                if (
                    self._limit is not None
                    and self._new >= self._limit
                    and not self._take_row(point)
                ):
                    raise _LimitReached
                prepare([swept])
            return self._rows[point.id].figures

        try:
            if _by_optuna(self._study):
                state = optimise_with_optuna(
                    self._study.axes,
                    spec.goals,
                    spec.constraints,
                    spec.sweep,
                    spec.study.seed + (self._shard.number if self._shard else 0),
                    attempt,
                    journal=self._folder.root / JOURNAL,
                    known=self._known,
                )
                self._take_tried(state)
            else:
                state = optimise(
                    self._study.axes, spec.goals[0], spec.constraints, spec.sweep, attempt, prepare
                )
        except _LimitReached:
            if _by_optuna(self._study):
                self._take_tried(OptimiserState([swept for swept, _ in self._known()]))
            return count, None
        return len(self._order), state

    def _known(self) -> list[tuple[dict[str, Any], dict[str, float | None]]]:
        """Rows of the folder that serve this study."""
        names = [axis.name for axis in self._study.axes]
        found = []
        for design_id in self._folder.ids():
            row = self._folder.read(design_id)
            if row is None or row.status == "broken" or any(self._missing(row)):
                continue
            swept = {name: row.parameters.get(name) for name in names}
            if None not in swept.values() and self._study.point(swept).id == row.id:
                found.append((swept, row.figures))
        return found

    def _take_tried(self, state: OptimiserState) -> None:
        """Take over designs that other processes tried."""
        for swept in state.tried:
            point = self._study.point(swept)
            if point.id not in self._order and self._take_row(point):
                self._order.append(point.id)

    def _take_row(self, point: DesignPoint) -> bool:
        """Whether the design has a row that serves; takes it over."""
        if point.id in self._rows:
            return True
        row = self._folder.read(point.id)
        if row is None or any(self._missing(row)):
            return False
        self._rows[point.id] = row
        return True

    def _missing(self, row: DesignRow) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Metrics and presses that a row lacks."""
        return row.missing(self._figure_keys), row.missing_presses(self._press_keys)

    def _wanted(self, point: DesignPoint) -> DesignBatch:
        """What has to be found out about a design."""
        row = self._folder.read(point.id)
        if row is None:
            return DesignBatch((point,), tuple(self._study.metrics), tuple(self._study.presses))
        metrics, presses = self._missing(row)
        read = {press for name in metrics for press in self._study.metrics[name].presses}
        needed = tuple(n for n in self._study.presses if n in presses or n in read)
        return DesignBatch((point,), metrics, needed)

    def _evaluate(self, pool: Pool, batches: list[DesignBatch]) -> None:
        """Evaluate batches; those whose process dies again design by design, then given up."""
        singles: list[DesignBatch] = []
        for event in pool.run(batches):
            if isinstance(event, Underway):
                self._listener.underway(event.worker, event.what, event.done, event.total)
                continue
            self._collect(event.item)
            lost = [b for b in event.item.one_by_one() if b.designs[0].id not in self._rows]
            if isinstance(event, Died) and len(event.item.designs) > 1:
                singles += lost
            elif isinstance(event, Died) and lost:
                broken = broken_row(lost[0].designs[0], event.item.metrics, event.cause)
                self._folder.add_row(broken)
                self._collect(event.item, broken=True)
            elif isinstance(event, Finished) and lost:
                self._collect(event.item, broken=True)
        if singles:
            self._evaluate(pool, singles)

    def _collect(self, batch: DesignBatch, *, broken: bool = False) -> None:
        """Take over rows that were written."""
        for point in batch.designs:
            if point.id in self._rows:
                continue
            if broken:
                row = self._folder.read(point.id)
                if row is not None:
                    self._rows[point.id] = row
            elif not self._take_row(point):
                continue
            self._new += 1
            self._listener.finished(self._rows[point.id])
        if time.monotonic() - self._table_at > TABLE_EVERY_S:
            self._write_table()

    def _in_order(self) -> list[DesignRow]:
        """All rows there are, broken ones that were not tried again among them."""
        found = []
        for name in self._order:
            row = self._rows.get(name) or self._folder.read(name)
            if row is not None and (name in self._rows or row.status == "broken"):
                found.append(row)
        return found

    def _write_table(self) -> None:
        if self._shard is None and (rows := self._in_order()):
            write_table(self._folder.root, self._study, rows)
        self._table_at = time.monotonic()
