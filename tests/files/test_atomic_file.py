# SPDX-License-Identifier: Apache-2.0
"""Outputs appear whole or not at all, and never in the place of somebody else's files."""

from __future__ import annotations

import errno
import json
import math
import os
import stat
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.files.atomic_file import atomic_file, to_jsonable, write_image, write_json


def tree(folder: Path) -> dict[str, str]:
    """Every file below ``folder``, hidden ones too, with its contents."""
    return {
        str(path.relative_to(folder)): path.read_text() if path.is_file() else "folder"
        for path in sorted(folder.rglob("*"))
    }


def test_file_appears_at_the_end(tmp_path: Path) -> None:
    target = tmp_path / "new" / "a.json"
    with atomic_file(target) as staging:
        assert staging.suffix == ".json" and staging.parent == target.parent
        staging.write_text("1")
        assert not target.exists()
    assert os.listdir(target.parent) == ["a.json"]
    assert target.stat().st_mode & 0o777 == 0o644


def test_a_folder_in_the_place_of_a_file_is_told_by_its_name(tmp_path: Path) -> None:
    target = tmp_path / "page.html"
    target.mkdir()
    with (
        pytest.raises(OSError, match="is a folder; name a file") as raised,
        atomic_file(target) as staging,
    ):
        staging.write_text("1")
    assert raised.value.filename == str(target)
    assert os.listdir(tmp_path) == ["page.html"]


def test_failed_file_leaves_the_earlier_one(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")
    with pytest.raises(RuntimeError), atomic_file(target) as staging:
        staging.write_text("half")
        raise RuntimeError
    assert tree(tmp_path) == {"a.txt": "old"}


def test_a_full_disk_is_told_by_the_files_name(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    with pytest.raises(OSError) as told, atomic_file(target):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert (told.value.errno, told.value.filename) == (errno.ENOSPC, str(target))


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


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_images_are_written_anywhere(tmp_path: Path, suffix: str) -> None:
    """OpenCV's own writer ends the process at such a path."""
    image = np.arange(12 * 16 * 3, dtype=np.uint8).reshape(12, 16, 3)
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/m\xe4rz")).with_suffix(suffix)
    write_image(path, image)
    plain = tmp_path / f"march{suffix}"
    assert cv2.imwrite(str(plain), image) and path.read_bytes() == plain.read_bytes()
    with pytest.raises(cv2.error):
        write_image(tmp_path / "image.nonsense", image)
