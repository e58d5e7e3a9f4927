# SPDX-License-Identifier: Apache-2.0
"""A batch of designs evaluated and written down: what one process of a study does."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from taccel_lab.errors import InputError, SimulationError
from taccel_lab.studies.design_point import DesignPoint, DesignResult
from taccel_lab.studies.folder import StudyFolder
from taccel_lab.studies.keep import keep_files
from taccel_lab.studies.metrics.base import Metric
from taccel_lab.studies.plan import Evaluate
from taccel_lab.studies.spec import Output
from taccel_lab.studies.stored import StoredDesign, stored_of
from taccel_lab.version import __version__

Tell = Callable[[str, int, int], None]
"""Told what is being done, how many of the batch's simulations are over, and how many there are."""


@dataclass(frozen=True)
class Batch:
    """Designs that are evaluated together, all for the same metrics."""

    designs: tuple[DesignPoint, ...]
    metrics: tuple[str, ...]
    presses: tuple[str, ...]

    def one_by_one(self) -> list[Batch]:
        """A batch of each design."""
        return [replace(self, designs=(design,)) for design in self.designs]


@dataclass(frozen=True)
class Job:
    """What is done with the designs of a study; goes to other processes."""

    root: Path
    presses: dict[str, Any]
    metrics: dict[str, Metric]
    press_keys: dict[str, str]
    figure_keys: dict[str, str]
    output: Output
    device: str
    load_n: float
    evaluate: Evaluate


def work_off(job: Job, batch: Batch, tell: Tell | None = None) -> None:
    """Evaluate designs as one batch and write each one's result.

    When a batch raises, its designs go one by one, so that only the one to blame is lost: an
    ``InputError`` or ``SimulationError`` makes a failed row, any other error a broken one with its
    traceback beside it.
    """
    folder = StudyFolder(job.root)
    for design in batch.designs:
        folder.design(design.id).mkdir(parents=True, exist_ok=True)
    try:
        results = job.evaluate(
            batch.designs,
            [job.presses[name] for name in batch.presses],
            [job.metrics[name] for name in batch.metrics],
            device=job.device,
            progress=tell,
            folder=folder.designs if job.output.records else None,
            load_n=job.load_n,
        )
        found = {result.point.id: result for result in results}
        if missing := [design.id for design in batch.designs if design.id not in found]:
            raise RuntimeError(f"the evaluation left out {', '.join(missing)}")
    except Exception as error:
        if len(batch.designs) > 1:
            for single in batch.one_by_one():
                work_off(job, single, tell)
        else:
            folder.add_result(_lost(folder, batch, error))
        return
    for design in batch.designs:
        folder.add_result(_kept(folder, job, batch, found[design.id]))


def _kept(folder: StudyFolder, job: Job, batch: Batch, result: DesignResult) -> StoredDesign:
    stored = stored_of(
        result,
        {name: job.figure_keys[name] for name in batch.metrics},
        {name: job.press_keys[name] for name in batch.presses},
        __version__,
        now(),
    )
    if stored.unbuildable:
        return stored
    try:
        files, causes = keep_files(folder, result, job.output)
    except Exception as error:
        files, causes = {}, {"files": _note(folder, stored.id, error)}
    return replace(stored, files=files, causes={**stored.causes, **causes})


def _lost(folder: StudyFolder, batch: Batch, error: Exception) -> StoredDesign:
    design = batch.designs[0]
    ours = isinstance(error, (InputError, SimulationError))
    cause = str(error) if ours else _note(folder, design.id, error)
    lost = broken_design(design, batch.metrics, cause)
    return replace(lost, status="failed") if ours else lost


def _note(folder: StudyFolder, design_id: str, error: Exception) -> str:
    """Keep the traceback; returns the error in one line."""
    folder.write_text(
        f"designs/{design_id}/traceback.txt", "".join(traceback.format_exception(error))
    )
    return f"{type(error).__name__}: {error}"


def broken_design(design: DesignPoint, metrics: tuple[str, ...], cause: str) -> StoredDesign:
    """The row of a design that was lost through no fault of its own."""
    return StoredDesign(
        id=design.id,
        family=design.family,
        parameters=dict(design.parameters),
        status="broken",
        figures=dict.fromkeys(metrics),
        causes={"design": cause},
        tool_version=__version__,
        finished=now(),
    )


def now() -> str:
    """UTC, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")
