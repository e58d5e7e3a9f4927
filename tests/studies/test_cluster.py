# SPDX-License-Identifier: Apache-2.0
"""Shards of a study as jobs: of submitit on this machine, and of SLURM where there is one."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from taccel_lab.errors import InputError
from taccel_lab.reading.shard import Shard
from taccel_lab.studies.cluster import JOBS, ShardJob, submit_shards
from taccel_lab.studies.study_folder import STUDY_MARKER, StudyFolder

FILE = (
    'study = {name = "x", sensor = "flat_pad", metrics = ["px_per_mm"]}\n'
    "parameters.mm_per_px.values = [0.04, 0.05, 0.06, 0.07]\n"
    'sweep.kind = "grid"\noutput = {meshes = false, pictures = false}\n'
)
SOON = {"timeout_min": 5}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "a.toml"
    path.write_text(FILE)
    return path


@pytest.fixture
def own_signals() -> Iterator[None]:
    earlier = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, earlier)


def test_jobs_of_submitit_do_their_shards(file: Path, tmp_path: Path) -> None:
    (tmp_path / "out" / JOBS).mkdir(parents=True)
    (tmp_path / "out" / STUDY_MARKER).touch()
    jobs = submit_shards(file, tmp_path / "out", 2, "local", processes=0)
    # Where no pickle of an earlier study, or of somebody else, can be taken for theirs.
    (place,) = {Path(job.paths.folder) for job in jobs}
    assert place.parent == tmp_path / "out" / JOBS
    assert sum(job.result() for job in jobs) == 4
    assert len(StudyFolder(tmp_path / "out").ids()) == 4


@pytest.mark.parametrize("settings", [{"partition_of": "x"}, {"timeout_min": "soon"}])
def test_settings_that_submitit_refuses_are_told(
    file: Path, tmp_path: Path, settings: dict[str, str]
) -> None:
    with pytest.raises(InputError, match="submitit refuses to submit to local: "):
        submit_shards(file, tmp_path / "out", 2, "local", settings=settings)


def test_what_slurm_refuses_is_told(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("srun", "sbatch"):
        (tmp_path / "bin").mkdir(exist_ok=True)
        command = tmp_path / "bin" / name
        command.write_text("#!/bin/sh\necho sbatch: error: invalid partition >&2\nexit 1\n")
        command.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}:{os.environ['PATH']}")
    with pytest.raises(InputError, match="submit to slurm: sbatch: error: invalid partition"):
        submit_shards(file, tmp_path / "out", 2, "slurm", settings=SOON)


@pytest.mark.parametrize(
    ("settings", "words"),
    [({}, "say how long a job may take: --job timeout_min"), ({**SOON, "slurm_time": "1"}, "time")],
)
def test_slurm_needs_the_time_of_a_job(
    file: Path, tmp_path: Path, settings: dict[str, int | str], words: str
) -> None:
    with pytest.raises(InputError, match=words):
        submit_shards(file, tmp_path / "out", 2, "slurm", settings=settings)


def test_a_job_whose_time_is_up_is_queued_again_as_it_was(own_signals: None) -> None:
    job = ShardJob("a.toml", "/out", Shard(1, 2), None, None, None)
    assert job.checkpoint().function == job


def test_a_job_that_is_asked_to_end_ends(
    file: Path, tmp_path: Path, own_signals: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def asked_to_end(*_: object) -> int:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(60)
        return 0

    monkeypatch.setattr("taccel_lab.studies.cluster.run_shard", asked_to_end)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # As submitit does.
    with pytest.raises(SystemExit) as ended:
        ShardJob(str(file), str(tmp_path / "out"), Shard(1, 2), None, None, None)()
    assert ended.value.code == 143


def _cluster_answers() -> bool:
    """Whether there is SLURM, and not its programs alone."""
    told = shutil.which("sinfo") and subprocess.run(
        ["sinfo", "-h"], capture_output=True, timeout=60
    )
    return bool(told) and told.returncode == 0


@pytest.mark.skipif(not _cluster_answers(), reason="needs a SLURM cluster that answers sinfo")
def test_an_array_of_slurm_does_its_shards(file: Path, tmp_path: Path) -> None:
    submit_shards(file, tmp_path / "out", 2, "slurm", processes=0, settings=SOON)
    folder, until = StudyFolder(tmp_path / "out"), time.monotonic() + 240
    while len(list((folder.root / JOBS).glob("*/*_result.pkl"))) < 2 and time.monotonic() < until:
        time.sleep(1)
    logs = [path.read_text() for path in (folder.root / JOBS).glob("*/*log.err")]
    assert len(folder.ids()) == 4, logs
