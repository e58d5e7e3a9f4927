# SPDX-License-Identifier: Apache-2.0
"""Runs a study: evaluates the designs that have no row yet, and writes the table as rows come."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from taccel_lab.errors import InputError
from taccel_lab.studies.batches import gather
from taccel_lab.studies.design_point import DesignPoint
from taccel_lab.studies.folder import StudyFolder
from taccel_lab.studies.optimise import OptimiserState, optimise
from taccel_lab.studies.plan import Study
from taccel_lab.studies.pool import Died, Finished, Pool, Underway
from taccel_lab.studies.stored import StoredDesign
from taccel_lab.studies.table import write_table
from taccel_lab.studies.work import Batch, Job, broken_design

TABLE_EVERY_S = 2.0
"""The table is rewritten at most this often while designs come in, and at the end."""


class Listener:
    """Told how a run goes; does nothing by itself."""

    def begins(self, total: int, stored: int, to_do: int) -> None:
        """Designs in all (an optimiser's: at most), already stored, and to do now."""

    def finished(self, design: StoredDesign) -> None:
        """A design's row has been written."""

    def underway(self, worker: int, what: str, done: int, total: int) -> None:
        """What one process is doing."""


@dataclass
class Outcome:
    """Where a study stands after a run."""

    study: Study
    folder: StudyFolder
    rows: list[StoredDesign]
    """In the order of the sweep; designs without a row are left out."""
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
    """Stored designs that this study file does not ask for."""

    @property
    def complete(self) -> bool:
        """Whether the sweep is through."""
        if self.study.spec.sweep.kind == "optimize":
            return self.optimiser is not None
        return len(self.rows) == self.total


class _LimitReached(Exception):
    """As many new designs as the caller wanted."""


def default_processes(device: str) -> int:
    """One a core this process may use; one for a GPU."""
    return 1 if device.startswith("cuda") else len(os.sched_getaffinity(0))


def run_study(
    study: Study,
    root: Path | str,
    *,
    device: str | None = None,
    processes: int | None = None,
    limit: int | None = None,
    source: str = "",
    listener: Listener | None = None,
) -> Outcome:
    """Evaluate what has no row yet; rows, files and the table stand in the folder ``root``.

    Args:
        study: What to run.
        root: Folder of the study, new or begun.
        device: Warp device; the study file's when None.
        processes: How many; 0 works in this process. The study file's, or one a core, when None.
        limit: New designs at most.
        source: Text of the study file, kept beside the results.
        listener: Told how it goes.

    Raises:
        InputError: A folder with other files, in use, or of a study of another sensor.
    """
    device = study.spec.run.device if device is None else device
    if processes is None:
        processes = study.spec.run.processes or default_processes(device)
    folder = StudyFolder(root)
    folder.require_usable()
    begun = time.perf_counter()
    with folder.locked():
        _require_same_sensor(study, folder)
        if source:
            folder.write_text("study.toml", source)
        run = _Run(study, folder, device, processes, limit, listener or Listener())
        outcome = run.go()
        outcome.seconds = time.perf_counter() - begun
        return outcome


def stored_outcome(study: Study, root: Path | str) -> Outcome:
    """Where a study stands, without evaluating anything. Raises InputError where there is none."""
    folder = StudyFolder(root)
    if not folder.is_study():
        raise InputError(f"{folder.root} holds no study; run it first")
    _require_same_sensor(study, folder)
    return _Run(study, folder, study.spec.run.device, 0, 0, Listener()).go()


def _require_same_sensor(study: Study, folder: StudyFolder) -> None:
    for design_id in folder.ids()[:1]:
        found = folder.read(design_id)
        if found is not None and found.family != study.family.name:
            raise InputError(
                f"{folder.root} holds a study of the sensor {found.family!r}, not of "
                f"{study.family.name!r}; name another folder"
            )


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
    ) -> None:
        self._study, self._folder, self._listener = study, folder, listener
        self._device, self._processes, self._limit = device, processes, limit
        self._rows: dict[str, StoredDesign] = {}
        self._order: list[str] = []
        self._new = 0
        self._table_at = 0.0
        self._job = Job(
            folder.root,
            study.presses,
            study.metrics,
            study.press_keys,
            study.figure_keys,
            study.spec.output,
            device,
            study.spec.study.load_n,
            study.kit.evaluate,
        )

    def go(self) -> Outcome:
        optimiser = None
        try:
            with Pool(self._job, self._processes) as pool:
                if self._study.spec.sweep.kind == "optimize":
                    total, optimiser = self._optimise(pool)
                else:
                    total = self._sweep(pool)
        finally:
            self._write_table()
        return Outcome(
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
        self._order = [point.id for point in points]
        to_do = [self._wanted(point) for point in points if not self._take_stored(point)]
        to_do = to_do[: self._limit]
        self._listener.begins(len(points), len(self._rows), len(to_do))
        self._evaluate(pool, gather(self._study.family, to_do, self._device))
        return len(points)

    def _optimise(self, pool: Pool) -> tuple[int, OptimiserState | None]:
        spec = self._study.spec
        assert spec.objective is not None
        count = spec.sweep.count or 1
        self._listener.begins(count, 0, count)

        def attempt(swept: dict[str, Any]) -> dict[str, float | None]:
            point = self._study.point(swept)
            if not self._take_stored(point):
                if self._limit is not None and self._new >= self._limit:
                    raise _LimitReached
                self._evaluate(pool, [self._wanted(point)])
            else:
                self._listener.finished(self._rows[point.id])
            if point.id not in self._order:
                self._order.append(point.id)
            return self._rows[point.id].figures

        try:
            state = optimise(
                self._study.axes,
                spec.objective,
                spec.constraints,
                spec.sweep,
                spec.study.seed,
                attempt,
            )
        except _LimitReached:
            return count, None
        return len(self._order), state

    def _take_stored(self, point: DesignPoint) -> bool:
        """Whether the design has a row that serves; takes it over."""
        if point.id in self._rows:
            return True
        stored = self._folder.read(point.id)
        if stored is None or any(self._missing(stored)):
            return False
        self._rows[point.id] = stored
        return True

    def _missing(self, stored: StoredDesign) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Metrics and presses that a stored design lacks."""
        job = self._job
        return stored.missing(job.figure_keys), stored.missing_presses(job.press_keys)

    def _wanted(self, point: DesignPoint) -> Batch:
        """What has to be found out about a design."""
        stored = self._folder.read(point.id)
        if stored is None:
            return Batch((point,), tuple(self._study.metrics), tuple(self._study.presses))
        metrics, presses = self._missing(stored)
        read = {press for name in metrics for press in self._study.metrics[name].presses}
        needed = tuple(n for n in self._study.presses if n in presses or n in read)
        return Batch((point,), metrics, needed)

    def _evaluate(self, pool: Pool, batches: list[Batch]) -> None:
        """Evaluate batches; those whose process dies again design by design, then given up."""
        singles: list[Batch] = []
        for event in pool.run(batches):
            if isinstance(event, Underway):
                self._listener.underway(event.worker, event.what, event.done, event.total)
                continue
            self._collect(event.batch)
            lost = [b for b in event.batch.one_by_one() if b.designs[0].id not in self._rows]
            if isinstance(event, Died) and len(event.batch.designs) > 1:
                singles += lost
            elif isinstance(event, Died) and lost:
                broken = broken_design(lost[0].designs[0], event.batch.metrics, event.cause)
                self._folder.add_result(broken)
                self._collect(event.batch, broken=True)
            elif isinstance(event, Finished) and lost:
                self._collect(event.batch, broken=True)
        if singles:
            self._evaluate(pool, singles)

    def _collect(self, batch: Batch, *, broken: bool = False) -> None:
        """Take over rows that were written."""
        for point in batch.designs:
            if point.id in self._rows:
                continue
            if broken:
                stored = self._folder.read(point.id)
                if stored is not None:
                    self._rows[point.id] = stored
            elif not self._take_stored(point):
                continue
            self._new += 1
            self._listener.finished(self._rows[point.id])
        if time.monotonic() - self._table_at > TABLE_EVERY_S:
            self._write_table()

    def _in_order(self) -> list[StoredDesign]:
        """All rows there are, broken ones that were not tried again among them."""
        found = []
        for name in self._order:
            row = self._rows.get(name) or self._folder.read(name)
            if row is not None and (name in self._rows or row.status == "broken"):
                found.append(row)
        return found

    def _write_table(self) -> None:
        if rows := self._in_order():
            write_table(self._folder.root, self._study, rows)
        self._table_at = time.monotonic()
