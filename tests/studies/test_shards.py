# SPDX-License-Identifier: Apache-2.0
"""Several runs share a study: by shards, by one journal."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from taccel_lab.errors import InputError, SimulationError
from taccel_lab.reading.shard import Shard
from taccel_lab.studies.design_batch import sharing_key
from taccel_lab.studies.optimise_optuna import JOURNAL
from taccel_lab.studies.runner import run_study
from taccel_lab.studies.study_folder import STUDY_MARKER, StudyFolder
from taccel_lab.studies.table import CSV_NAME
from tests.studies.run_fake import CHANGES, GP
from tests.support.fake_kit import evaluate_and_crash, logged, study
from tests.support.strangers import SECRET, lure

ROOT = Path(__file__).parents[2]


def start(folder: Path, shard: str, *words: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "tests.studies.run_fake", str(folder), "0", shard, *words]
    return subprocess.Popen(command, cwd=ROOT)


def test_two_processes_share_a_grid_and_a_third_run_merges(tmp_path: Path) -> None:
    runs = [start(tmp_path, f"{number}/2") for number in (1, 2)]
    assert [run.wait(120) for run in runs] == [0, 0]
    assert not (tmp_path / CSV_NAME).exists()
    planned = study(**CHANGES)
    outcome = run_study(planned, tmp_path, processes=0)
    assert outcome.complete and outcome.new == 0 and len(outcome.rows) == 12
    assert sorted(logged(tmp_path)) == sorted(point.id for point in planned.points())
    assert (tmp_path / CSV_NAME).is_file()


def test_a_shard_takes_designs_that_share_simulations_together(tmp_path: Path) -> None:
    planned = study(**CHANGES)
    owners: dict[str, set[int]] = {}
    for number in (1, 2, 3):
        outcome = run_study(planned, tmp_path, processes=0, shard=Shard(number, 3))
        assert outcome.new == outcome.total == 4
        for row in outcome.rows:
            (point,) = (p for p in planned.points() if p.id == row.id)
            owners.setdefault(sharing_key(planned.family, point), set()).add(number)
    assert all(len(numbers) == 1 for numbers in owners.values())


def test_what_a_lost_shard_left_is_done_by_the_merging_run(tmp_path: Path) -> None:
    run_study(study(**CHANGES), tmp_path, processes=0, shard=Shard(1, 2), limit=2)
    outcome = run_study(study(**CHANGES), tmp_path, processes=0)
    assert outcome.complete and outcome.new == 10


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


@pytest.mark.parametrize("text", ["0/2", "3/2", "1", "a/b", "-1/2", "1/0", "1/2/3", "1/99999"])
def test_what_is_no_shard_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="shard"):
        Shard.parse(text)


def test_cobyla_has_no_shards(tmp_path: Path) -> None:
    planned = study(**{**GP, "sweep": {"kind": "optimize", "count": 9}})
    with pytest.raises(InputError, match="shards need GP, TPE or NSGA2"):
        run_study(planned, tmp_path, processes=0, shard=Shard(1, 2))


def test_two_processes_ask_one_journal(tmp_path: Path) -> None:
    runs = [start(tmp_path, f"{number}/2", "optuna") for number in (1, 2)]
    assert [run.wait(120) for run in runs] == [0, 0]
    outcome = run_study(study(**GP), tmp_path, processes=0)
    assert outcome.complete and outcome.new == 0
    # Both may be at their last design at once.
    assert 14 <= len(outcome.rows) <= 15
    assert len(set(logged(tmp_path))) == len(outcome.rows)
    (tmp_path / JOURNAL).unlink()
    again = run_study(study(**GP), tmp_path, processes=0)
    assert again.complete and again.new == 0


def test_a_journal_whose_writer_was_killed_amid_a_line_goes_on(tmp_path: Path) -> None:
    run_study(study(**GP), tmp_path, processes=0, limit=3, shard=Shard(1, 2))
    with open(tmp_path / JOURNAL, "ab") as journal:
        journal.write(b'{"op_code":5,"worker_id":"x","trial_id":3,"para')
    left = tmp_path / f"{JOURNAL}.lock"
    left.symlink_to(JOURNAL)  # Optuna's own, of the killed one.
    outcome = run_study(study(**GP), tmp_path, processes=0, shard=Shard(1, 2))
    assert outcome.complete and len(outcome.rows) == 14
    assert left.is_symlink()  # Optuna would have waited for half a minute, and then removed it.
    for line in (tmp_path / JOURNAL).read_text().splitlines():
        json.loads(line)


def test_a_shard_that_lost_designs_says_so(tmp_path: Path) -> None:
    planned = study(evaluate_and_crash)
    outcome = run_study(planned, tmp_path, processes=1, shard=Shard(1, 1))
    with pytest.raises(SimulationError, match=r"4 of 6 designs were lost, the first one as .* the"):
        outcome.require_whole()
    run_study(study(), tmp_path, processes=0, shard=Shard(1, 1)).require_whole()
