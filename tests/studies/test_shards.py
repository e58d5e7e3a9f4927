# SPDX-License-Identifier: Apache-2.0
"""A study that is killed at any time goes on; several runs share one: by shards, by jobs."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from taccel_lab.errors import InputError, SimulationError
from taccel_lab.files.shard import Shard
from taccel_lab.studies.evaluate.batches import sharing_key
from taccel_lab.studies.evaluate.cluster import JOBS, ShardJob, submit_shards
from taccel_lab.studies.evaluate.design_row import DesignRow
from taccel_lab.studies.evaluate.optimise_optuna import JOURNAL
from taccel_lab.studies.evaluate.runner import run_study
from taccel_lab.studies.evaluate.study_folder import CSV_NAME, RESULT, STUDY_MARKER, StudyFolder
from tests.support.fake_kit import evaluate_and_crash, logged, study
from tests.support.strangers import SECRET, lure

ROOT = Path(__file__).parents[2]
CHANGES = {
    "parameters": {
        "thickness_mm": {"min": 3.0, "max": 8.0, "count": 6},
        "young_modulus_mpa": {"min": 0.1, "max": 0.4, "count": 2, "scale": "log"},
    }
}
SEARCH = {
    "parameters": {
        "thickness_mm": {"min": 3, "max": 8},
        "young_modulus_mpa": {"min": 0.05, "max": 1, "scale": "log"},
    },
    "sweep": {"kind": "optimize", "count": 14, "method": "TPE"},
    "objectives": [{"minimize": "blur"}, {"maximize": "range"}],
}


def start(folder: Path, *words: str, hold_at: int = 1_000_000) -> subprocess.Popen[bytes]:
    """A fake study in a process of its own: processes, shard, what searches."""
    command = [sys.executable, "-m", "tests.studies.test_shards", str(folder), *words]
    environment = {**os.environ, "FAKE_HOLD_AT": str(hold_at), "PYTHONPATH": str(ROOT)}
    return subprocess.Popen(command, cwd=ROOT, env=environment)


@pytest.mark.thorough
def test_a_killed_sweep_goes_on(tmp_path: Path) -> None:
    """Its processes end with it; the same study evaluates what has no row yet, and nothing else."""
    folder = StudyFolder(tmp_path)
    process = start(tmp_path, "2", hold_at=8)
    try:
        while len(folder.ids()) < 4:
            assert process.poll() is None
            time.sleep(0.02)
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
        workers = children.read_text().split() if children.is_file() else ["none"]
    finally:
        process.kill()
        process.wait()
    while any(Path(f"/proc/{pid}").exists() for pid in workers):
        time.sleep(0.02)
    before = {name: (folder.design(name) / RESULT).read_bytes() for name in folder.ids()}
    assert workers and 4 <= len(before) < 12
    outcome = run_study(study(**CHANGES), tmp_path, processes=0)
    assert outcome.complete and outcome.new == 12 - len(before)
    assert {row.id for row in outcome.rows} == {point.id for point in study(**CHANGES).points()}
    for name, content in before.items():
        assert (folder.design(name) / RESULT).read_bytes() == content
        assert logged(tmp_path).count(name) == 1


def test_leftovers_of_a_killed_write_are_removed(tmp_path: Path) -> None:
    outcome = run_study(study(), tmp_path, processes=0)
    design = outcome.folder.design(outcome.rows[0].id)
    leftovers = [tmp_path / ".designs.x1.csv", design / ".result.y2.json"]
    (tmp_path / "meshes").mkdir()
    leftovers.append(tmp_path / "meshes" / ".half.vtu")
    for path in leftovers:
        path.write_text("half")
    run_study(study(), tmp_path, processes=0)
    assert not any(path.exists() for path in leftovers)


def test_a_merged_row_keeps_what_only_one_knows() -> None:
    old = DesignRow(
        "x", "gelsight", {}, "done", {"a": 1.0, "b": None}, {"b": "no edge", "press ball": "stuck"},
        2.0, 3, {"ball": [1]}, {"a": "k", "b": "k"}, {"ball": "k"}, {"mesh": "mesh.vtu"},
    )  # fmt: skip
    new = DesignRow(
        "x", "gelsight", {}, "failed", {"c": None}, {"c": "why"}, 1.0, 1, {}, {"c": "k"},
        {"ball": "k2"},
    )  # fmt: skip
    merged = old.merged(new)
    assert (merged.status, merged.seconds, merged.simulations) == ("done", 3.0, 4)
    assert merged.figures == {"a": 1.0, "b": None, "c": None}
    assert merged.causes == {"b": "no edge", "c": "why"}
    assert merged.figure_keys == {"a": "k", "b": "k", "c": "k"}
    assert (merged.press_keys, merged.files) == ({"ball": "k2"}, {"mesh": "mesh.vtu"})


# Shards -------------------------------------------------------------------------------------------


def test_a_shard_takes_designs_that_share_simulations_together(tmp_path: Path) -> None:
    """A run of the whole merges them."""
    planned, owners = study(**CHANGES), dict[str, set[int]]()
    points = {point.id: point for point in planned.points()}
    for number in (1, 2, 3):
        outcome = run_study(planned, tmp_path, processes=0, shard=Shard(number, 3))
        assert outcome.new == outcome.total == 4
        for row in outcome.rows:
            owners.setdefault(sharing_key(planned.family, points[row.id]), set()).add(number)
    assert all(len(numbers) == 1 for numbers in owners.values())
    assert not (tmp_path / CSV_NAME).exists()
    outcome = run_study(planned, tmp_path, processes=0)
    assert outcome.complete and outcome.new == 0 and len(outcome.rows) == 12
    assert sorted(logged(tmp_path)) == sorted(points) and (tmp_path / CSV_NAME).is_file()


def test_a_shard_runs_once_and_never_beside_a_whole_run(tmp_path: Path) -> None:
    folder = StudyFolder(tmp_path)
    with folder.locked(Shard(1, 2)):
        with folder.locked(Shard(2, 2)):
            pass
        for other in (Shard(1, 2), None):
            with pytest.raises(InputError, match="another run works in"), folder.locked(other):
                pass
    with folder.locked(), pytest.raises(InputError, match="another run"):
        run_study(study(), tmp_path, processes=0, shard=Shard(1, 2))
    for text in ("0/2", "3/2", "1", "a/b", "-1/2", "1/0", "1/2/3", "1/99999"):
        with pytest.raises(InputError, match="shard"):
            Shard.parse(text)
    one = {"sweep": {"kind": "optimize", "count": 9}, "objectives": [{"minimize": "blur"}]}
    with pytest.raises(InputError, match="shards need several objectives"):
        run_study(study(**{**SEARCH, **one}), tmp_path, processes=0, shard=Shard(1, 2))


@pytest.mark.parametrize("kind", ["link out", "link to a folder", "device", "pipe"])
@pytest.mark.parametrize(
    "place",
    [
        ".taccel_lab_study", ".shard_1_of_2", "designs", "designs/a", "designs/a/result.json",
        "figures", "figures/pareto.png", "meshes", "steps", "designs.csv", JOURNAL,
    ],
)  # fmt: skip
@pytest.mark.parametrize("begun", [True, False])
def test_a_study_that_leads_elsewhere_is_not_gone_on_with(
    tmp_path: Path, place: str, kind: str, begun: bool
) -> None:
    """A run truncates its locks, clears away what killed ones left and draws its figures anew."""
    folder = StudyFolder(tmp_path / "study")
    folder.root.mkdir()
    if begun:
        (folder.root / STUDY_MARKER).touch()
    secret = lure(folder.root / place, kind, tmp_path / "outside")
    for shard in (None, Shard(1, 2)):
        with (
            pytest.raises(InputError, match=r"is a link|no regular file|no study"),
            folder.locked(shard),
        ):
            (folder.root / "figures").mkdir(exist_ok=True)
    assert secret.read_text() == SECRET and list(secret.parent.iterdir()) == [secret]


@pytest.mark.thorough
def test_two_processes_ask_one_journal(tmp_path: Path) -> None:
    runs = [start(tmp_path, "0", f"{number}/2", "optuna") for number in (1, 2)]
    assert [run.wait(120) for run in runs] == [0, 0]
    outcome = run_study(study(**SEARCH), tmp_path, processes=0)
    # Both may be at their last design at once.
    assert outcome.complete and outcome.new == 0 and 14 <= len(outcome.rows) <= 15
    assert len(set(logged(tmp_path))) == len(outcome.rows)
    (tmp_path / JOURNAL).unlink()
    again = run_study(study(**SEARCH), tmp_path, processes=0)
    assert again.complete and again.new == 0


def test_a_journal_is_no_link(tmp_path: Path) -> None:
    run_study(study(**SEARCH), tmp_path, processes=0, limit=2, shard=Shard(1, 2))
    journal, other = tmp_path / JOURNAL, tmp_path / "other"
    journal.replace(other)
    journal.symlink_to(other.name)
    before = other.read_bytes()
    with pytest.raises(InputError, match=f"{JOURNAL} is a link"):
        run_study(study(**SEARCH), tmp_path, processes=0, limit=1, shard=Shard(1, 2))
    assert other.read_bytes() == before


def test_a_journal_whose_writer_was_killed_amid_a_line_goes_on(tmp_path: Path) -> None:
    run_study(study(**SEARCH), tmp_path, processes=0, limit=3, shard=Shard(1, 2))
    with open(tmp_path / JOURNAL, "ab") as journal:
        journal.write(b'{"op_code":5,"worker_id":"x","trial_id":3,"para')
    left = tmp_path / f"{JOURNAL}.lock"
    left.symlink_to(JOURNAL)  # Optuna's own, of the killed one.
    outcome = run_study(study(**SEARCH), tmp_path, processes=0, shard=Shard(1, 2))
    assert outcome.complete and len(outcome.rows) == 14
    assert left.is_symlink()  # Optuna would have waited for half a minute, and then removed it.
    for line in (tmp_path / JOURNAL).read_text().splitlines():
        json.loads(line)


@pytest.mark.slow
def test_a_shard_that_lost_designs_says_so(tmp_path: Path) -> None:
    planned = study(evaluate_and_crash)
    outcome = run_study(planned, tmp_path, processes=1, shard=Shard(1, 1))
    with pytest.raises(SimulationError, match=r"4 of 6 designs were lost, the first one as .* the"):
        outcome.require_whole()
    run_study(study(), tmp_path, processes=0, shard=Shard(1, 1)).require_whole()


# Jobs of submitit on this machine, and of SLURM where there is one --------------------------------


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


@pytest.mark.thorough
def test_jobs_of_submitit_do_their_shards(file: Path, tmp_path: Path) -> None:
    (tmp_path / "out" / JOBS).mkdir(parents=True)
    (tmp_path / "out" / STUDY_MARKER).touch()
    jobs = submit_shards(file, tmp_path / "out", 2, "local", processes=0)
    # Where no pickle of an earlier study, or of somebody else, can be taken for theirs.
    (place,) = {Path(job.paths.folder) for job in jobs}
    assert place.parent == tmp_path / "out" / JOBS
    assert sum(job.result() for job in jobs) == 4
    assert len(StudyFolder(tmp_path / "out").ids()) == 4


@pytest.mark.parametrize(
    ("cluster", "settings", "words"),
    [
        ("local", {"partition_of": "x"}, "submitit cannot submit to local: "),
        ("local", {"timeout_min": "soon"}, "submitit cannot submit to local: "),
        ("slurm", {}, "say how long a job may take: --job timeout_min"),
        ("slurm", {**SOON, "slurm_time": "1"}, "time"),
        ("slurm", SOON, "submit to slurm: sbatch: error: invalid partition"),
    ],
)
def test_what_a_cluster_refuses_is_said(
    cluster: str, settings: dict[str, int | str], words: str, file: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    if settings is SOON:
        for name in ("srun", "sbatch"):
            (tmp_path / "bin").mkdir(exist_ok=True)
            command = tmp_path / "bin" / name
            command.write_text("#!/bin/sh\necho sbatch: error: invalid partition >&2\nexit 1\n")
            command.chmod(0o755)
        monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}:{os.environ['PATH']}")
    with pytest.raises(InputError, match=words):
        submit_shards(file, tmp_path / "out", 2, cluster, settings=settings)


def test_a_job_ends_when_asked_and_is_queued_again_as_it_was(
    file: Path, tmp_path: Path, own_signals: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def asked_to_end(*_: object, **options: object) -> int:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(60)
        return 0

    job = ShardJob(str(file), str(tmp_path / "out"), Shard(1, 2), None, None, None)
    assert job.checkpoint().function == job
    monkeypatch.setattr("taccel_lab.studies.evaluate.cluster.run_study", asked_to_end)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)  # As submitit does.
    with pytest.raises(SystemExit) as ended:
        job()
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


if __name__ == "__main__":
    root, processes, *rest = sys.argv[1:]
    planned = study(**(SEARCH if "optuna" in rest else CHANGES))
    shard = Shard.parse(rest[0]) if rest else None
    run_study(planned, root, processes=int(processes), shard=shard)
