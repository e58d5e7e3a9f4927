# SPDX-License-Identifier: Apache-2.0
"""Many designs of a sensor through the same presses, with figures of merit."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from taccel_lab.files.inner_path import file_or_example
from taccel_lab.model.launches import require_device
from taccel_lab.processes.start_warp import start_warp
from taccel_lab.report.page import first_figure
from taccel_lab.studies.evaluate.runner import Listener, StudyOutcome, default_kit, run_study
from taccel_lab.studies.report import write_study_report
from taccel_lab.studies.report.page import study_page
from taccel_lab.studies.spec.study import read_study
from taccel_lab.studies.spec.study_table import Swept, study_text
from taccel_lab.typed import typed

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from taccel_lab.files.shard import Shard
    from taccel_lab.studies.spec.study import Study

Accuracy = Literal["fast", "default", "reference"]


@dataclass(repr=False)
class StudyResult(StudyOutcome):
    """Where a study stands after a run, ready to be drawn."""

    def plot(self) -> Figure:
        """Draw the first figure of the report.

        Raises:
            InputError: No design has figures yet.
        """
        return first_figure([study_page(self)])


@typed
def study(
    file: Path | str,
    out: Path | str | None = None,
    *,
    processes: int | None = None,
    device: str | None = None,
    accuracy: Accuracy | None = None,
    limit: int | None = None,
    listener: Listener | None = None,
    swept: Swept | None = None,
) -> StudyResult:
    """Evaluate the designs of a study file; write their rows as they come, table and report.

    The same call goes on with a study that was stopped.

    Args:
        file: TOML, see docs/studies.md; or the name of an example.
        out: Folder of the study, new or begun; ``out/NAME-OF-THE-FILE`` when None.
        processes: How many; the file's, or one a core, when None. 0 works in this process.
        device: Of the solver; the file's when None.
        accuracy: Of the presses; the file's when None.
        limit: New designs at most.
        listener: Receives how it goes.
        swept: Values by parameter in place of the file's, such as ``{"thickness_mm": [3, 4]}``.

    Raises:
        InputError: A file or a folder that cannot be used.
    """
    file = file_or_example(Path(file), "studies")
    root = Path("out") / file.stem if out is None else Path(out)
    outcome = evaluate_study(
        plan_study(file, accuracy, swept), file, root,
        processes=processes, device=device, limit=limit, listener=listener, swept=swept,
    )  # fmt: skip
    write_study_report(outcome)
    return StudyResult(**vars(outcome))


def plan_study(
    file: Path | str, accuracy: Accuracy | None = None, swept: Swept | None = None
) -> Study:
    """The study of a file, checked; see ``study``."""
    start_warp()
    return read_study(Path(file), default_kit(), accuracy, swept)


def evaluate_study(
    planned: Study,
    file: Path | str,
    root: Path,
    *,
    processes: int | None = None,
    device: str | None = None,
    limit: int | None = None,
    shard: Shard | None = None,
    listener: Listener | None = None,
    swept: Swept | None = None,
) -> StudyOutcome:
    """Evaluate the designs of a planned study, or a shard of them, without a report."""
    require_device(device or planned.spec.run.device)
    return run_study(
        planned,
        root,
        device=device,
        processes=processes,
        limit=limit,
        shard=shard,
        source=study_text(Path(file), swept),
        listener=listener,
    )
