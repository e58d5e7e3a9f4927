# SPDX-License-Identifier: Apache-2.0
"""Batches of designs that share simulations: what one process of a study evaluates and writes."""

from __future__ import annotations

import traceback
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from taccel_lab.errors import InputError, SimulationError, is_of_a_file
from taccel_lab.progress import Progress, silent
from taccel_lab.sensors.base import SensorFamily
from taccel_lab.studies.evaluate.design_files import write_design_files
from taccel_lab.studies.evaluate.design_row import DesignRow, row_of
from taccel_lab.studies.evaluate.study_folder import StudyFolder
from taccel_lab.studies.metrics.design_point import DesignFigures, DesignPoint
from taccel_lab.studies.spec.study import Study
from taccel_lab.version import __version__

Needs = tuple[tuple[str, ...], tuple[str, ...]]
"""Metrics and presses."""
MAX_BATCH = 32
"""Designs in a batch: what is lost at most, with every process, when a run is killed."""
GROUPS_ON_GPU = 16
"""Groups of designs in a batch on a GPU, which wants many environments at once. On a CPU each
group goes alone, so that rows appear early and cores share the work evenly."""


@dataclass(frozen=True)
class DesignBatch:
    """Designs that are evaluated together, all for the same metrics."""

    designs: tuple[DesignPoint, ...]
    metrics: tuple[str, ...]
    presses: tuple[str, ...]

    def one_by_one(self) -> list[DesignBatch]:
        """A batch of each design."""
        return [replace(self, designs=(design,)) for design in self.designs]


def sharing_key(family: SensorFamily, design: DesignPoint) -> str:
    """Equal for designs whose presses are the same but for the scale of the forces.

    Quasi-static presses scale with Young's modulus, and optics do not touch them: what counts is
    the pad, the camera's view (it places the presses), and the layers' other properties.
    """
    try:
        parameters = family.parameters(design.parameters)
    except InputError:
        return f"cannot be built: {design.id}"
    layers = parameters.layer_materials()
    modulus = layers[0].young_modulus_pa
    return repr(
        (
            parameters.pad(),
            parameters.grid(),
            [
                (m.young_modulus_pa / modulus, m.poisson_ratio, m.friction_coefficient)
                for m in layers
            ],
        )
    )


def gather_batches(
    family: SensorFamily, wanted: Sequence[DesignBatch], device: str
) -> list[DesignBatch]:
    """Batches made of others, in the order of each one's first design."""
    groups: dict[tuple[str, Needs], list[DesignPoint]] = {}
    for batch in wanted:
        for design in batch.designs:
            key = sharing_key(family, design)
            groups.setdefault((key, (batch.metrics, batch.presses)), []).append(design)
    merged = GROUPS_ON_GPU if device.startswith("cuda") else 1
    batches: list[DesignBatch] = []
    room = 0
    for (_, needs), group in groups.items():
        for start in range(0, len(group), MAX_BATCH):
            part = DesignBatch(tuple(group[start : start + MAX_BATCH]), *needs)
            if room and (batches[-1].metrics, batches[-1].presses) == needs:
                batches[-1] = replace(part, designs=batches[-1].designs + part.designs)
                room -= 1
            else:
                batches.append(part)
                room = merged - 1
    return batches


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
