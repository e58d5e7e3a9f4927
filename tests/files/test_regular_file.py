# SPDX-License-Identifier: Apache-2.0
"""Only regular files of a bounded size are read; everything else is a sentence with the path."""

from __future__ import annotations

import hashlib
import os
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from taccel_lab.errors import InputError
from taccel_lab.files.arrays import read_npy, read_npz
from taccel_lab.files.images import read_grey, read_image
from taccel_lab.files.json_file import read_json
from taccel_lab.files.regular_file import (
    file_sha256,
    in_bytes,
    read_regular_file,
    require_regular_file,
)
from taccel_lab.files.toml_file import read_toml
from taccel_lab.files.videos import count_frames, read_frames
from taccel_lab.files.yaml_file import read_yaml
from taccel_lab.printable import printable


@pytest.mark.parametrize("read", [require_regular_file, read_regular_file])
def test_what_is_no_regular_file_of_that_size_is_refused(
    read: Callable[[Path, int, str], Any], tmp_path: Path
) -> None:
    os.mkfifo(tmp_path / "fifo")
    listening = socket.socket(socket.AF_UNIX)
    listening.bind(str(tmp_path / "socket"))
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "large").write_bytes(b"x" * 1025)
    for name, words in (
        ("none", "does not exist; expected a photo"),
        ("", "is a folder; expected a photo"),
        ("fifo", "is no regular file"),
        ("socket", "is no regular file"),
        ("/dev/zero", "is no regular file"),
        ("loop", "cannot be read"),
        ("a\0b", "cannot be read"),
        ("n" * 300, "cannot be read"),
        ("large", "has 1 KiB; a photo may have up to 1000 bytes"),
    ):
        with pytest.raises(InputError) as caught:
            read(tmp_path / name, 1000, "a photo")
        assert str(caught.value).startswith(printable(tmp_path / name)), name
        assert words in str(caught.value), name
    listening.close()
    with pytest.raises(InputError, match="is no regular file"):
        file_sha256(tmp_path / "fifo")


def test_files_that_tell_no_size_are_bounded_too() -> None:
    status = Path("/proc/self/status")
    if not status.exists():
        pytest.skip("no /proc")
    with pytest.raises(InputError, match="more than 10 bytes"):
        read_regular_file(status, 10, "a text")


def test_good_files_are_read_whole(tmp_path: Path) -> None:
    path = tmp_path / "good"
    content = os.urandom((1 << 20) + 17)
    path.write_bytes(content)
    assert require_regular_file(path, 1 << 21, "a file") == path
    assert read_regular_file(path, len(content), "a file") == content
    assert file_sha256(path) == hashlib.sha256(content).hexdigest()
    (tmp_path / "empty").touch()
    assert read_regular_file(tmp_path / "empty", 10, "a file") == b""


@pytest.mark.parametrize(
    ("count", "words"),
    [(0, "0 bytes"), (1023, "1023 bytes"), (1536, "1.5 KiB"), (5 << 20, "5 MiB"),
     (20 << 30, "20 GiB"), (10**13, "9313 GiB")],
)  # fmt: skip
def test_sizes(count: int, words: str) -> None:
    assert in_bytes(count) == words


READERS: dict[Callable[[Path], Any], str] = {
    read_npy: "", read_npz: "", read_image: "an image", read_grey: "an image",
    count_frames: "a video", lambda path: list(read_frames(path)): "a video", read_toml: "",
    read_json: "", read_yaml: "",
}  # fmt: skip
"""What each says that it expected."""


@pytest.mark.parametrize("read", READERS)
def test_every_reader_takes_regular_files_alone(
    read: Callable[[Path], Any], tmp_path: Path
) -> None:
    os.mkfifo(tmp_path / "pipe")
    for name, words in (("pipe", "pipe|no regular file"), ("", "a folder"), ("none", "not exist")):
        with pytest.raises(InputError, match=words) as caught:
            read(tmp_path / name)
        assert str(caught.value).startswith(str(tmp_path / name))
        assert name or READERS[read] in str(caught.value)
    (tmp_path / "empty").touch()
    if read in (read_image, read_grey):
        with pytest.raises(InputError, match=r"is empty \(0 bytes\)"):
            read(tmp_path / "empty")
