# SPDX-License-Identifier: Apache-2.0
"""Shards of a study as jobs of submitit: on a SLURM cluster, or as processes of this machine."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from taccel_lab.errors import InputError
from taccel_lab.reading.shard import Shard
from taccel_lab.studies.runner import run_study
from taccel_lab.studies.study import default_kit, read_study
from taccel_lab.studies.study_folder import StudyFolder

Where = Literal["slurm", "local"]
JOBS = ".jobs"
"""Folder of submitit's scripts and logs in that of the study."""


def run_shard(
    file: str, root: str, shard: Shard, device: str | None, processes: int | None,
    accuracy: str | None,
) -> int:  # fmt: skip
    """Work of one job: its part of the study. Returns the number of new designs."""
    study = read_study(Path(file), default_kit(), accuracy)
    source = Path(file).read_text(encoding="utf-8")
    outcome = run_study(
        study, root, device=device, processes=processes, shard=shard, source=source
    )  # fmt: skip
    return outcome.new


def submit_shards(
    file: Path,
    root: Path,
    count: int,
    where: Where,
    *,
    device: str | None = None,
    processes: int | None = None,
    accuracy: str | None = None,
    settings: Mapping[str, Any] | None = None,
) -> list[Any]:
    """Submit a study as ``count`` jobs, on SLURM one array.

    Args:
        file: Study file; every job reads it again, so it has to be seen by all nodes, as ``root``.
        root: Folder of the study.
        count: Shards.
        where: Cluster, or processes of this machine.
        device: As of ``run_study``.
        processes: As of ``run_study``.
        accuracy: As of ``read_study``.
        settings: Of submitit's executor, such as ``slurm_partition`` and ``timeout_min``.

    Returns:
        submitit's jobs; ``job.result()`` waits for one.

    Raises:
        InputError: submitit is missing, or a setting that it does not have.
    """
    try:
        import submitit
    except ImportError as error:
        raise InputError("jobs need submitit: pip install taccel-lab[slurm]") from error
    read_study(file, default_kit(), accuracy)
    folder = StudyFolder(root)
    with folder.locked():
        (folder.root / JOBS).mkdir(exist_ok=True)
    try:
        executor = submitit.AutoExecutor(folder.root / JOBS, cluster=where)
        executor.update_parameters(**{"name": f"study-{file.stem}", **(settings or {})})
    except (NameError, TypeError, ValueError, RuntimeError) as error:
        raise InputError(f"submitit refuses to submit to {where}: {error}") from error
    shards = [Shard(number + 1, count) for number in range(count)]
    texts = (str(file.resolve()), str(folder.root))
    with executor.batch():
        return [
            executor.submit(run_shard, *texts, shard, device, processes, accuracy)
            for shard in shards
        ]
