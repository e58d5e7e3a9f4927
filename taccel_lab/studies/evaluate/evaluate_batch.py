# SPDX-License-Identifier: Apache-2.0
"""A batch of designs evaluated and their rows written: what one process of a study does."""

from __future__ import annotations

import traceback
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from taccel_lab.errors import InputError, SimulationError, is_of_a_file
from taccel_lab.progress import Progress, silent
from taccel_lab.studies.evaluate.design_batch import DesignBatch
from taccel_lab.studies.evaluate.design_files import write_design_files
from taccel_lab.studies.evaluate.design_row import DesignRow, row_of
from taccel_lab.studies.evaluate.study_folder import StudyFolder
from taccel_lab.studies.metrics.design_point import DesignFigures, DesignPoint
from taccel_lab.studies.spec.study import Study
from taccel_lab.version import __version__


def evaluate_batch(
    study: Study, root: Path, device: str, batch: DesignBatch, progress: Progress = silent
) -> None:
    """Evaluate designs as one batch and write each one's result.

    When a batch raises, its designs go one by one, so that only the one to blame is lost: an
    ``InputError`` or ``SimulationError`` makes a failed row, any other error a broken one with its
    traceback beside it. A full disk and the like are no design's fault: they are raised.
    """
    folder = StudyFolder(root)
    for design in batch.designs:
        folder.design(design.id).mkdir(parents=True, exist_ok=True)
    try:
        results = study.kit.evaluate(
            batch.designs,
            [study.presses[name] for name in batch.presses],
            [study.metrics[name] for name in batch.metrics],
            device=device,
            progress=progress,
            folder=folder.designs if study.spec.output.records else None,
            unit_spread=0.01 * study.spec.study.unit_spread_percent,
        )
        found = {result.point.id: result for result in results}
        if missing := [design.id for design in batch.designs if design.id not in found]:
            raise RuntimeError(f"the evaluation left out {', '.join(missing)}")
    except Exception as error:
        if is_of_a_file(error):
            raise
        if len(batch.designs) > 1:
            for single in batch.one_by_one():
                evaluate_batch(study, root, device, single, progress)
        else:
            folder.add_row(_lost_row(folder, batch, error))
        return
    for design in batch.designs:
        folder.add_row(_row(folder, study, batch, found[design.id]))


def _row(folder: StudyFolder, study: Study, batch: DesignBatch, result: DesignFigures) -> DesignRow:
    row = row_of(
        result,
        {name: study.figure_keys[name] for name in batch.metrics},
        {name: study.press_keys[name] for name in batch.presses},
        __version__,
        now(),
    )
    if row.unbuildable:
        return row
    try:
        name = study.name_of(row.parameters)
        files, causes = write_design_files(folder, result, study.spec.output, name)
    except Exception as error:
        if is_of_a_file(error):
            raise
        files, causes = {}, {"files": _note(folder, row.id, error)}
    return replace(row, files=files, causes={**row.causes, **causes})


def _lost_row(folder: StudyFolder, batch: DesignBatch, error: Exception) -> DesignRow:
    design = batch.designs[0]
    ours = isinstance(error, (InputError, SimulationError))
    cause = str(error) if ours else _note(folder, design.id, error)
    lost = broken_row(design, batch.metrics, cause)
    return replace(lost, status="failed") if ours else lost


def _note(folder: StudyFolder, design_id: str, error: Exception) -> str:
    """Keep the traceback; returns the error in one line."""
    folder.write_text(
        f"designs/{design_id}/traceback.txt", "".join(traceback.format_exception(error))
    )
    return f"{type(error).__name__}: {error}"


def broken_row(design: DesignPoint, metrics: tuple[str, ...], cause: str) -> DesignRow:
    """The row of a design that was lost for another reason."""
    return DesignRow(
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
