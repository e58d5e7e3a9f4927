# SPDX-License-Identifier: Apache-2.0
"""Single files appear whole or not at all; caches and locks of files."""

from __future__ import annotations

import errno
import fcntl
import json
import math
import os
import stat
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import atomic_file, to_jsonable, write_image, write_json
from taccel_lab.files.file_cache import CACHE_VARIABLE, cached_arrays
from taccel_lab.files.growing_file import held_file
from tests.support.small_captures import everything_below


def test_a_file_appears_at_the_end_or_not_at_all(tmp_path: Path) -> None:
    target = tmp_path / "new" / "a.json"
    with atomic_file(target) as staging:
        assert staging.suffix == ".json" and staging.parent == target.parent
        staging.write_text("1")
        assert not target.exists()
    assert target.stat().st_mode & 0o777 == 0o644
    with pytest.raises(RuntimeError), atomic_file(target) as staging:
        staging.write_text("half")
        raise RuntimeError
    # A full disk is reported with the file's name, and so is a folder in its place.
    with pytest.raises(OSError) as told, atomic_file(target):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert (told.value.errno, told.value.filename) == (errno.ENOSPC, str(target))
    assert everything_below(tmp_path) == {"new": None, "new/a.json": b"1"}
    with (
        pytest.raises(OSError, match="is a folder; name a file") as raised,
        atomic_file(target.parent) as staging,
    ):
        staging.write_text("1")
    assert raised.value.filename == str(target.parent)
    assert everything_below(tmp_path) == {"new": None, "new/a.json": b"1"}


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
    rows: list[tuple[Any, Any]] = [
        (np.array([[1.5, np.nan], [np.inf, -2.0]]), [[1.5, None], [None, -2.0]]),
        (np.int32(3), 3), (np.float32(0.5), 0.5), (np.float64("nan"), None), (np.bool_(True), True),
        (Path("a/b"), "a/b"), ((1, (2.0,)), [1, [2.0]]), ({4: "key"}, {"4": "key"}),
    ]  # fmt: skip
    write_json(target, {"values": [value for value, _ in rows]})
    assert json.loads(target.read_text()) == {"values": [written for _, written in rows]}
    assert stat.S_IMODE(target.stat().st_mode) == 0o644
    with pytest.raises(TypeError):
        write_json(target, {"what": object()})
    assert os.listdir(tmp_path) == ["values.json"]


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_images_are_written_anywhere(tmp_path: Path, suffix: str) -> None:
    """OpenCV's own writer ends the process at such a path."""
    image = np.arange(12 * 16 * 3, dtype=np.uint8).reshape(12, 16, 3)
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/m\xe4rz")).with_suffix(suffix)
    write_image(path, image)
    plain = tmp_path / f"march{suffix}"
    assert cv2.imwrite(str(plain), image[..., ::-1]) and path.read_bytes() == plain.read_bytes()
    with pytest.raises(cv2.error):
        write_image(tmp_path / "image.nonsense", image)


def test_who_holds_a_file_is_named(tmp_path: Path) -> None:
    lock = tmp_path / "lock"
    with held_file(lock, "it is taken", "wait"):
        with (
            pytest.raises(InputError, match=rf"it is taken \(process {os.getpid()} on .+\); wait"),
            held_file(lock, "it is taken", "wait"),
        ):
            pass
    with held_file(lock, "", "", shared=True), held_file(lock, "", "", shared=True):
        pass


def test_a_file_system_without_locks_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(*_: Any) -> None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))

    monkeypatch.setattr(fcntl, "flock", missing)
    with (
        pytest.raises(InputError, match=r"lock cannot be locked \(Function not implemented\).*NFS"),
        held_file(tmp_path / "lock", "", ""),
    ):
        pass


ARRAYS = {"a": np.arange(12.0).reshape(3, 4), "b": np.array([1, 2, 3], dtype=np.int32)}


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    return tmp_path


def agree(found: dict[str, np.ndarray] | None) -> bool:
    return found is not None and all(np.array_equal(found[name], ARRAYS[name]) for name in ARRAYS)


def test_made_once() -> None:
    file = cached_arrays("things", {"n": 1})
    assert file.read() is None
    assert agree(file.read_or_make(lambda: ARRAYS))
    assert agree(file.read_or_make(lambda: pytest.fail("it is there")))
    assert cached_arrays("things", {"n": 2}).read() is None


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_damage_is_told_and_made_again(data: st.DataObject) -> None:
    file = cached_arrays("things", {"n": 1})
    file.write(ARRAYS)
    sound = file.path.read_bytes()
    damage = data.draw(st.sampled_from(["cut", "byte", "more", "other"]))
    if damage == "cut":
        spoilt = sound[: data.draw(st.integers(0, len(sound) - 1))]
    elif damage == "byte":
        place = data.draw(st.integers(0, len(sound) - 1))
        flipped = sound[place] ^ data.draw(st.integers(1, 255))
        spoilt = sound[:place] + bytes([flipped]) + sound[place + 1 :]
    else:
        extra = data.draw(st.binary(min_size=1, max_size=100))
        spoilt = sound + extra if damage == "more" else extra
    file.path.write_bytes(spoilt)
    with pytest.warns(UserWarning, match="kept things .* are damaged") as told:
        assert agree(file.read_or_make(lambda: ARRAYS))
    assert len(told) == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert agree(file.read())


def test_what_cannot_be_read_is_told() -> None:
    file = cached_arrays("things", {"n": 1})
    file.path.mkdir(parents=True)
    with pytest.warns(UserWarning, match="Is a directory"):
        assert file.read() is None
    file.path.rmdir()
    os.mkfifo(file.path)
    with pytest.warns(UserWarning, match="it is a pipe"):
        assert file.read() is None


_MANY = """
import sys, warnings
import numpy as np
from taccel_lab.files.file_cache import cached_arrays
warnings.simplefilter("error")
for turn in range(40):
    for n in range(3):
        file = cached_arrays("things", {"n": n})
        found = file.read_or_make(lambda: {"a": np.full(5000, float(n))})
        assert (found["a"] == n).all(), (turn, n)
        if turn % 4 == int(sys.argv[1]):
            file.path.unlink(missing_ok=True)
"""


@pytest.mark.thorough
def test_processes_share_a_cache(folder: Path) -> None:
    """Four write, read and delete the same files: nobody meets a half-written one."""
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", _MANY, str(number)],
            env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])},
            stderr=subprocess.PIPE,
            text=True,
        )
        for number in range(4)
    ]
    for process in processes:
        _, said = process.communicate()
        assert process.returncode == 0, said
    left = [path.name for path in folder.rglob("*") if path.is_file()]
    assert len(left) <= 3, left
