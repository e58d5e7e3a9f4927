# SPDX-License-Identifier: Apache-2.0
"""Names that others' files bring lead nowhere else, and files are plain ones."""

from __future__ import annotations

import hashlib
import os
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.errors import InputError
from taccel_lab.files.arrays import read_npz
from taccel_lab.files.documents import read_json, read_toml, read_yaml
from taccel_lab.files.images import read_grey, read_image
from taccel_lab.files.inner_path import copy_inner, inner_files, inner_path, real_path
from taccel_lab.files.regular_file import (
    file_sha256,
    in_bytes,
    read_regular_file,
    require_regular_file,
)
from taccel_lab.files.videos import count_frames, read_frames
from taccel_lab.printable import printable
from tests.support.strangers import LURES, REFUSED, SECRET, lure
from tests.test_architecture import SOURCES

PARTS = st.sampled_from(
    ["..", ".", "a", "b c", "", "~", "*", "..a", "a..", "C:", "\\", "é", "\ud800", "\0"]
)


@given(parts=st.lists(PARTS, max_size=6), separator=st.sampled_from(["/", "//", "\\"]))
def test_no_name_leads_out(parts: list[str], separator: str) -> None:
    folder = Path("/some/folder")
    try:
        path = inner_path(folder, separator.join(parts))
    except InputError as error:
        assert str(error).startswith("/some/folder: ")
    else:
        assert path.resolve().is_relative_to(folder.resolve())


@pytest.mark.parametrize("name", ["a.png", "a/b.png", "..a", "a..b/c", "./a", "~", "a b"])
def test_ordinary_names_are_fine(tmp_path: Path, name: str) -> None:
    assert inner_path(tmp_path, name) == tmp_path / name


def test_links_and_names_that_no_file_can_have(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    (tmp_path / "secret").write_text("not yours")
    for link, target in (
        ("out", tmp_path / "secret"), ("up", tmp_path), ("round", folder / "round"),
        ("within", folder / "file"),
    ):  # fmt: skip
        (folder / link).symlink_to(target)
    for name, words in (
        *((name, "is a link out of") for name in ("out", "up/secret", "up")),
        ("round", "cannot be followed"),
        ("x" * 5000, r"cannot be followed: .*too long"),
        ("a\ud800b.png", r"file names cannot have '\\ud800'"),
    ):
        with pytest.raises(InputError, match=words):
            inner_path(folder, name)
    assert inner_path(folder, "within") == folder / "within"
    # The folder itself may be reached by a link.
    (tmp_path / "shortcut").symlink_to(folder)
    assert inner_path(tmp_path / "shortcut", "within").name == "within"


@pytest.mark.parametrize("kind", LURES)
@pytest.mark.parametrize("place", ["x", "sub/x", "sub/below/x"])
def test_nothing_that_leads_elsewhere_is_among_a_folders_files(
    tmp_path: Path, kind: str, place: str
) -> None:
    folder = tmp_path / "folder"
    (folder / "sub" / "below").mkdir(parents=True)
    (folder / "sub" / "file").write_text("own")
    assert list(inner_files(folder)) == list(inner_files(folder, "sub")) == [folder / "sub/file"]
    secret = lure(folder / place, kind, tmp_path / "outside")
    with pytest.raises(InputError, match=REFUSED):
        list(inner_files(folder))
    with pytest.raises(InputError, match=REFUSED):
        copy_inner(folder, "sub" if "/" in place else place, tmp_path / "copy")
    assert not (tmp_path / "copy" / place).exists() and secret.read_text() == SECRET
    # Places that are not looked at are not judged.
    shallow = list(inner_files(folder, levels=1)) if "/" in place else []
    assert shallow == []


def test_a_folder_is_copied_with_what_its_own_links_name(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    (folder / "sub").mkdir(parents=True)
    (folder / "file").write_text("own")
    (folder / "sub" / "link").symlink_to("../file")
    copy_inner(folder, "sub", tmp_path / "copy")
    assert not (tmp_path / "copy/sub/link").is_symlink()
    assert (tmp_path / "copy/sub/link").read_text() == "own"
    with pytest.raises(InputError, match="does not exist"):
        copy_inner(folder, "absent", tmp_path / "copy")


def test_where_a_path_leads(tmp_path: Path) -> None:
    (tmp_path / "one").symlink_to(tmp_path / "other")
    assert real_path(tmp_path / "one" / "x") == tmp_path / "other" / "x"
    (tmp_path / "other").symlink_to(tmp_path / "one")
    assert not real_path(tmp_path / "one").exists()
    for name in ("a\0b", "a\ud800b"):
        with pytest.raises(InputError, match="file name"):
            real_path(tmp_path / name)


def test_links_are_followed_by_real_path_alone() -> None:
    """``Path.resolve`` raises for a circle of links, which a user's folder may hold."""
    own = ("Path(__file__).resolve()", "link.resolve()", "place.resolve()")  # Of ours, of Linux's.
    for source in SOURCES:
        lines = source.read_text(encoding="utf-8").splitlines()
        calls = [line for line in lines if ".resolve(" in line and "``" not in line]
        left = [line for line in calls if not any(call in line for call in own)]
        assert not left, f"{source}: {left}"


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
    read_npz: "", read_image: "an image", read_grey: "an image",
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
