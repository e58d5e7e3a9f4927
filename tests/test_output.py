# SPDX-License-Identifier: Apache-2.0
"""Outputs appear whole or not at all, and never in the place of somebody else's files."""

from __future__ import annotations

import json
import math
import os
import stat
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.errors import InputError
from taccel_lab.output import (
    OUTPUT_MARKER,
    atomic_directory,
    atomic_file,
    require_replaceable,
    to_jsonable,
    write_json,
)


def tree(folder: Path) -> dict[str, str]:
    """Every file below ``folder``, hidden ones too, with its contents."""
    return {
        str(path.relative_to(folder)): path.read_text() if path.is_file() else "folder"
        for path in sorted(folder.rglob("*"))
    }


def write(target: Path, text: str) -> None:
    with atomic_directory(target) as folder:
        (folder / "a.txt").write_text(text)


def test_folder_appears_at_the_end(tmp_path: Path) -> None:
    target = tmp_path / "deep" / "er" / "out"
    with atomic_directory(target) as folder:
        (folder / "a.txt").write_text("new")
        assert not target.exists()
        assert folder.parent == target.parent
    assert tree(target) == {OUTPUT_MARKER: "", "a.txt": "new"}
    assert os.listdir(target.parent) == ["out"]
    assert stat.S_IMODE(target.stat().st_mode) == 0o755


def test_earlier_output_is_replaced_as_a_whole(tmp_path: Path) -> None:
    target = tmp_path / "out"
    with atomic_directory(target) as folder:
        (folder / "old.txt").write_text("old")
    with atomic_directory(target) as folder:
        (folder / "a.txt").write_text("new")
        assert (target / "old.txt").read_text() == "old"
    assert tree(tmp_path) == {
        "out": "folder",
        f"out/{OUTPUT_MARKER}": "",
        "out/a.txt": "new",
    }


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
@pytest.mark.parametrize("earlier", [False, True])
def test_failure_leaves_nothing(tmp_path: Path, error: type[BaseException], earlier: bool) -> None:
    target = tmp_path / "out"
    if earlier:
        write(target, "old")
    before = tree(tmp_path)
    with pytest.raises(error), atomic_directory(target) as folder:
        (folder / "half.txt").write_text("half")
        (folder / "sub").mkdir()
        raise error
    assert tree(tmp_path) == before


def test_failure_leaves_no_empty_parents(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    with pytest.raises(RuntimeError), atomic_directory(tmp_path / "mine" / "a" / "b" / "out"):
        raise RuntimeError
    assert tree(tmp_path) == {"mine": "folder"}


def test_parents_that_others_use_meanwhile_stay(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError), atomic_directory(tmp_path / "a" / "b" / "out"):
        (tmp_path / "a" / "theirs.txt").write_text("theirs")
        raise RuntimeError
    assert tree(tmp_path) == {"a": "folder", "a/theirs.txt": "theirs"}


@pytest.mark.parametrize("failing_call", [1, 2])
def test_earlier_output_survives_a_failed_exchange(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing_call: int
) -> None:
    target = tmp_path / "out"
    write(target, "old")
    before = tree(tmp_path)
    replace, calls = os.replace, []

    def sometimes(source: Path, destination: Path) -> None:
        calls.append(source)
        if len(calls) == failing_call:
            raise OSError(28, "No space left on device")
        replace(source, destination)

    monkeypatch.setattr(os, "replace", sometimes)
    with pytest.raises(OSError, match="No space left"):
        write(target, "new")
    assert tree(tmp_path) == before


@pytest.mark.parametrize("foreign", ["a.txt", ".hidden", "sub/deep.txt"])
def test_foreign_files_are_refused_before_any_work(tmp_path: Path, foreign: str) -> None:
    target = tmp_path / "out"
    (target / foreign).parent.mkdir(parents=True)
    (target / foreign).write_text("mine")
    before = tree(tmp_path)
    for attempt in (require_replaceable, lambda path: atomic_directory(path).__enter__()):
        with pytest.raises(InputError, match=r"out holds files that taccel-lab did not write"):
            attempt(target)
        assert tree(tmp_path) == before


def test_empty_and_absent_folders_are_fine(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for name in ("empty", "absent"):
        require_replaceable(tmp_path / name)
        write(tmp_path / name, "new")
        require_replaceable(tmp_path / name)


def test_owner_vouches_for_the_folder(tmp_path: Path) -> None:
    (tmp_path / "profile.toml").write_text("old")
    target = tmp_path / "profile"
    target.mkdir()
    (target / "profile.toml").write_text("old")
    with atomic_directory(target, own=True) as folder:
        (folder / "profile.toml").write_text("new")
    assert tree(target) == {"profile.toml": "new"}


@pytest.mark.parametrize("name", ["file", "file/out", "file/a/b"])
def test_a_file_in_the_way_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").write_text("mine")
    for attempt in (require_replaceable, lambda path: atomic_directory(path).__enter__()):
        with pytest.raises(InputError, match=r"file is a file; an output folder is needed"):
            attempt(tmp_path / name)
    assert tree(tmp_path) == {"file": "mine"}


@pytest.mark.parametrize("name", [".", "", "../here", "sub/.."])
def test_folder_names_without_a_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    here = tmp_path / "here"
    here.mkdir()
    if name == "sub/..":
        (here / "sub").mkdir()
    monkeypatch.chdir(here)
    if name == "sub/..":
        with pytest.raises(InputError, match="did not write"):
            require_replaceable(name)
        return
    write(Path(name), "new")
    assert tree(tmp_path) == {
        "here": "folder",
        f"here/{OUTPUT_MARKER}": "",
        "here/a.txt": "new",
    }


def test_file_appears_at_the_end(tmp_path: Path) -> None:
    target = tmp_path / "new" / "a.json"
    with atomic_file(target) as staging:
        assert staging.suffix == ".json" and staging.parent == target.parent
        staging.write_text("1")
        assert not target.exists()
    assert os.listdir(target.parent) == ["a.json"]
    assert target.stat().st_mode & 0o777 == 0o644


def test_failed_file_leaves_the_earlier_one(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")
    with pytest.raises(RuntimeError), atomic_file(target) as staging:
        staging.write_text("half")
        raise RuntimeError
    assert tree(tmp_path) == {"a.txt": "old"}


json_values = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=20,
)


@given(value=json_values)
def test_anything_becomes_strict_json(value: object) -> None:
    def plain(item: object) -> object:
        if isinstance(item, float) and not math.isfinite(item):
            return None
        if isinstance(item, list):
            return [plain(part) for part in item]
        if isinstance(item, dict):
            return {key: plain(part) for key, part in item.items()}
        return item

    text = json.dumps(to_jsonable(value), allow_nan=False)
    assert json.loads(text) == plain(value)


def test_numpy_and_paths_become_json(tmp_path: Path) -> None:
    target = tmp_path / "values.json"
    write_json(
        target,
        {
            "array": np.array([[1.5, np.nan], [np.inf, -2.0]]),
            "int": np.int32(3),
            "float": np.float32(0.5),
            "nan": np.float64("nan"),
            "bool": np.bool_(True),
            "path": Path("a/b"),
            "tuple": (1, (2.0,)),
            4: "key",
        },
    )
    assert json.loads(target.read_text()) == {
        "array": [[1.5, None], [None, -2.0]],
        "int": 3,
        "float": 0.5,
        "nan": None,
        "bool": True,
        "path": "a/b",
        "tuple": [1, [2.0]],
        "4": "key",
    }
    assert stat.S_IMODE(target.stat().st_mode) == 0o644
    assert os.listdir(tmp_path) == ["values.json"]
    with pytest.raises(TypeError):
        write_json(target, {"what": object()})
    assert os.listdir(tmp_path) == ["values.json"]
