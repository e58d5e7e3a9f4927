# SPDX-License-Identifier: Apache-2.0
"""Shards of a study as jobs of submitit: on a SLURM cluster, or as processes of this machine."""

from __future__ import annotations

import signal
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NoReturn

from taccel_lab.errors import InputError
from taccel_lab.files.inner_path import real_path
from taccel_lab.files.shard import Shard
from taccel_lab.studies.evaluate.runner import default_kit, run_study
from taccel_lab.studies.evaluate.study_folder import StudyFolder
from taccel_lab.studies.spec.study import read_study

Where = Literal["slurm", "local"]
JOBS = ".jobs"
"""Folder of submitit's scripts and logs in that of the study."""


@dataclass(frozen=True)
class ShardJob:
    """A part of a study as submitit runs it: a job whose time is up is queued again, and goes
    on."""

    file: str
    root: str
    shard: Shard
    device: str | None
    processes: int | None
    accuracy: str | None

    def __call__(self) -> int:
        """Run it; returns the number of new designs.

        Raises SimulationError where processes of it died, as of too little memory.
        """
        # submitit passes SIGTERM over, which SLURM sends to a job that it will kill.
        signal.signal(signal.SIGTERM, _end)
        study = read_study(Path(self.file), default_kit(), self.accuracy)
        outcome = run_study(
            study,
            self.root,
            device=self.device,
            processes=self.processes,
            shard=self.shard,
            source=Path(self.file).read_text(encoding="utf-8"),
        )
        outcome.require_whole()
        return outcome.new

    def checkpoint(self) -> Any:
        """What submitit queues again."""
        from submitit.helpers import DelayedSubmission

        # Not between this and the queue, where SLURM's second signal may come.
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        return DelayedSubmission(self)


def _end(*_: object) -> NoReturn:
    raise SystemExit(143)


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
        settings: Of submitit's executor, such as ``slurm_partition``; SLURM needs ``timeout_min``.

    Returns:
        submitit's jobs; ``job.result()`` waits for one.

    Raises:
        InputError: submitit is missing, or a setting that it or SLURM refuses.
    """
    try:
        import submitit
    except ImportError as error:
        raise InputError("jobs need submitit: pip install taccel-lab[slurm]") from error
    settings = dict(settings or {})
    if where == "slurm" and "timeout_min" not in settings:
        # submitit's own limit is 5 minutes.
        raise InputError("say how long a job may take: --job timeout_min=240, in minutes")
    if "slurm_time" in settings:
        raise InputError("a job's time is given in minutes, as timeout_min, not as slurm_time")
    read_study(file, default_kit(), accuracy)
    folder = StudyFolder(root)
    with folder.locked():
        (folder.root / JOBS).mkdir(exist_ok=True)
        # A new one each time: submitit unpickles what it finds under the names of its jobs, and the
        # folder of the study may be somebody else's.
        place = tempfile.mkdtemp(dir=folder.root / JOBS)
    texts = (str(real_path(file)), str(folder.root))
    shards = [Shard(number + 1, count) for number in range(count)]
    jobs = [ShardJob(*texts, shard, device, processes, accuracy) for shard in shards]
    try:
        executor = submitit.AutoExecutor(place, cluster=where)
        executor.update_parameters(**{"name": f"study-{file.stem}", **settings})
        return executor.submit_array(jobs)
    except (AssertionError, NameError, TypeError, ValueError, RuntimeError) as error:
        raise InputError(f"submitit cannot submit to {where}: {error}") from error
