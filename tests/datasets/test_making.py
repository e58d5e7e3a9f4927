# SPDX-License-Identifier: Apache-2.0
"""Data sets are the same whoever makes them, and lose nothing when they are killed."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from taccel_lab.datasets import runner
from taccel_lab.datasets.check import check_dataset
from taccel_lab.datasets.folder import DatasetFolder
from taccel_lab.datasets.reading import Dataset
from taccel_lab.errors import InputError
from taccel_lab.files.output_marker import OUTPUT_MARKER
from tests.support.small_data_sets import make, parts_of, plan
from tests.support.strangers import SECRET, lure

ROOT = Path(__file__).parents[2]


def started(*words: object) -> subprocess.Popen[bytes]:
    """A run of its own: profile, folder, shard, processes, and at which part it is killed."""
    command = [sys.executable, "-m", "tests.support.small_data_sets", *map(str, words)]
    return subprocess.Popen(command, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)})


def test_equal_bytes_by_shards_and_folders(profile: Path, made: Path, tmp_path: Path) -> None:
    """Two shards in folders of their own, one of them by another process, give what one run gave;
    together they are read as one."""
    other = started(profile, tmp_path / "b", "2/2", "1")
    first = make(profile, tmp_path / "a", (1, 2))
    assert other.wait() == 0 and first.complete
    one, two = parts_of(tmp_path / "a"), parts_of(tmp_path / "b")
    assert one and two and not set(one) & set(two)
    assert {**one, **two} == parts_of(made)
    both, whole = Dataset([tmp_path / "a", tmp_path / "b"]), Dataset(made)
    assert len(both) == len(whole)
    assert sorted(row["episode"] for row in both.episodes) == list(range(6))
    assert not check_dataset([tmp_path / "a", tmp_path / "b"])


def test_a_killed_run_goes_on_and_ends_the_same(profile: Path, made: Path, tmp_path: Path) -> None:
    folder = DatasetFolder(tmp_path / "k")
    assert started(profile, folder.root, "1/1", "0", "2").wait() == -signal.SIGKILL
    before = parts_of(folder.root)
    assert len(folder.part_folders()) == 1 and set(before) < set(parts_of(made))
    hidden = [path for path in (folder.root / "parts").iterdir() if path.name.startswith(".")]
    assert hidden, "it was killed while it wrote"
    outcome = make(profile, folder.root)
    assert outcome.complete and outcome.parts_there == len(folder.part_folders()) - len(
        outcome.done
    )
    assert parts_of(folder.root) == parts_of(made)
    hidden = [path for path in (folder.root / "parts").iterdir() if path.name.startswith(".")]
    assert not hidden
    assert make(profile, folder.root).done == []


def test_a_full_disk_loses_nothing(
    profile: Path, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write, calls = runner.write_part, []

    def full(*arguments: Any) -> None:
        calls.append(arguments)
        if len(calls) > 1:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(tmp_path))
        write(*arguments)

    monkeypatch.setattr(runner, "write_part", full)
    with pytest.raises(OSError, match="No space left"):
        make(profile, tmp_path / "d")
    assert len(DatasetFolder(tmp_path / "d").part_folders()) == 1
    monkeypatch.undo()
    assert make(profile, tmp_path / "d").complete
    assert parts_of(tmp_path / "d") == parts_of(made)


def test_other_data_sets_and_files_are_left_alone(profile: Path, tmp_path: Path) -> None:
    begun = tmp_path / "begun"
    make_plan = plan(profile)
    DatasetFolder(begun).begin(make_plan, "small")
    with pytest.raises(InputError, match=r"another data set: its spec.dataset differ.*several are"):
        DatasetFolder(begun).require_usable(plan(profile, dataset={"seed": 9}))
    DatasetFolder(begun).require_usable(make_plan)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="holds files and no data set"):
        make(profile, tmp_path / "mine")
    with (
        DatasetFolder(begun).locked("1/2"),
        pytest.raises(InputError, match="another run makes shard 1/2"),
        DatasetFolder(begun).locked("1/2"),
    ):
        pass


def test_shards_may_begin_a_folder_at_the_same_time(profile: Path, tmp_path: Path) -> None:
    folder = DatasetFolder(tmp_path / "shared")
    folder.root.mkdir()
    (folder.root / ".dataset.another.json").write_text("{")  # Another shard is writing it.
    with folder.locked("2/2"):
        folder.begin(plan(profile), "small")


def test_timing_writes_nothing(profile: Path, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    outcome = runner.make_dataset(plan(profile), None, processes=0, limit=1)
    record = outcome.record()
    assert record["images"] > 2 and not record["written"] and record["bytes"] == 0
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("sizes", ["kept", "of an earlier version"])
def test_damaged_parts_are_made_again_and_told(
    sizes: str, profile: Path, made: Path, copied: Path
) -> None:
    """By a look at their files: missing, cut short; a part beside them is not touched."""
    gone, cut, *sound = DatasetFolder(copied).part_folders()
    chunks = [
        next(path for path in (part / "data.zarr" / "rgb" / "c").rglob("*") if path.is_file())
        for part in (gone, cut)
    ]
    chunks[0].unlink()
    chunks[1].write_bytes(chunks[1].read_bytes()[:10] if sizes == "kept" else b"")
    if sizes != "kept":
        for part in (gone, cut):
            marker = json.loads((part / OUTPUT_MARKER).read_text())
            (part / OUTPUT_MARKER).write_text(json.dumps({"files": marker["files"]}))
    stamps = [(part / "steps.parquet").stat().st_mtime_ns for part in sound]
    said: list[str] = []
    outcome = make(profile, copied, say=said.append)
    assert outcome.complete and [done.part for done in outcome.done] == [0, 1]
    assert parts_of(copied) == parts_of(made)
    assert [(part / "steps.parquet").stat().st_mtime_ns for part in sound] == stamps
    missing = chunks[0].relative_to(gone).as_posix()
    assert said[0] == f"part 000000 is damaged and made again: {missing} is missing"
    assert "000001" in said[1] and ("has 10 bytes of" if sizes == "kept" else "is empty") in said[1]
    assert make(profile, copied, say=said.append).done == [] and len(said) == 2


def test_a_damaged_part_with_files_of_somebody_else_is_left_alone(
    profile: Path, made: Path, copied: Path
) -> None:
    part = DatasetFolder(copied).part_folders()[0]
    (part / "episodes.parquet").unlink()
    (part / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"holds notes\.txt, which .*; delete the part, and"):
        make(profile, copied)
    (part / "notes.txt").unlink()
    marker = (part / OUTPUT_MARKER).read_bytes()
    (part / OUTPUT_MARKER).write_bytes(marker[:50])
    with pytest.raises(InputError, match=r"no list of its files, .*; delete the part, and"):
        make(profile, copied)
    (part / OUTPUT_MARKER).write_bytes(marker)
    assert make(profile, copied).complete
    assert parts_of(copied) == parts_of(made)


@pytest.mark.parametrize("name", ["{0}/thesis.tex", "../../../thesis.tex", "C:\\x", "a\0b", "up/x"])
def test_the_list_of_a_part_names_nothing_outside(
    profile: Path, tmp_path: Path, name: str, copied: Path
) -> None:
    """A data set of somebody else, one part of which misses a file."""
    part = DatasetFolder(copied).part_folders()[0]
    (tmp_path / "thesis.tex").write_text(SECRET)
    marker = json.loads((part / OUTPUT_MARKER).read_text())
    marker["files"] |= {name.format(tmp_path): "0" * 64, "up": "link"}
    (part / OUTPUT_MARKER).write_text(json.dumps(marker))
    (part / "up").symlink_to(tmp_path)
    (part / "steps.parquet").unlink()
    if name != "up/x":
        with pytest.raises(InputError, match=r"no list of its files, .*; delete the part, and"):
            make(profile, copied)
    else:
        (tmp_path / "x").write_text(SECRET)
        assert make(profile, copied).complete
        assert (tmp_path / "x").read_text() == SECRET
    assert (tmp_path / "thesis.tex").read_text() == SECRET


@pytest.mark.parametrize("kind", ["link out", "link to a folder", "device", "pipe"])
@pytest.mark.parametrize(
    "place",
    ["parts", "parts/000001", "profiles/0", "steps.parquet", "dataset.json", ".lock-1-of-1"],
)
def test_a_folder_that_leads_elsewhere_is_not_gone_on_with(
    profile: Path, tmp_path: Path, place: str, kind: str, copied: Path
) -> None:
    secret = lure(copied / place, kind, tmp_path / "outside")
    with pytest.raises(InputError, match=r"is a link|no regular file"):
        make(profile, copied)
    assert secret.read_text() == SECRET and os.listdir(secret.parent) == [secret.name]
