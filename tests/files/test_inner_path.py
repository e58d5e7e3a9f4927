# SPDX-License-Identifier: Apache-2.0
"""Names that others' files bring lead nowhere else, and files are plain ones."""

from __future__ import annotations

import hashlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from taccel_lab.errors import InputError
from taccel_lab.files import apart
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
from tests.files import foreign_readers as readers
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


def test_names_that_no_file_can_have(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot be followed: .*too long"):
        inner_path(tmp_path, "x" * 5000)
    with pytest.raises(InputError, match=r"file names cannot have '\\ud800'"):
        inner_path(tmp_path, "a\ud800b.png")


@pytest.mark.parametrize("name", ["a.png", "a/b.png", "..a", "a..b/c", "./a", "~", "a b"])
def test_ordinary_names_are_fine(tmp_path: Path, name: str) -> None:
    assert inner_path(tmp_path, name) == tmp_path / name


def test_links(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    (tmp_path / "secret").write_text("not yours")
    (folder / "out").symlink_to(tmp_path / "secret")
    (folder / "up").symlink_to(tmp_path)
    (folder / "round").symlink_to(folder / "round")
    (folder / "within").symlink_to(folder / "file")
    for name in ("out", "up/secret", "up"):
        with pytest.raises(InputError, match="is a link out of"):
            inner_path(folder, name)
    with pytest.raises(InputError, match="cannot be followed"):
        inner_path(folder, "round")
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


NUMPY = f"numpy {version('numpy')}"
read_apart = partial(apart.read_apart, by="numpy")
stream_apart = partial(apart.stream_apart, by="numpy")


def test_results_come_back_from_a_process_that_stays() -> None:
    value = np.arange(12.0).reshape(3, 4)
    np.testing.assert_array_equal(read_apart("a", readers.double, value), 2 * value)
    first, second = (read_apart("a", readers.process_number) for _ in range(2))
    assert first == second != os.getpid()


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("read", "words"),
    [(readers.crash, f"{NUMPY} crashed on it (the process was ended by signal 6). The file"),
     (readers.leave, f"{NUMPY} crashed on it (the process ended with code 7). The file"),
     (readers.refuse, "^a.ply has no faces$"),
     (readers.take_memory, "needs more than 2 GiB of memory")],
)  # fmt: skip
def test_what_goes_wrong_is_a_sentence_and_the_next_file_is_read(
    read: Callable[[], None], words: str
) -> None:
    with pytest.raises(InputError, match=words.replace("(", r"\(").replace(")", r"\)")) as caught:
        read_apart("x.ply", read)
    assert "the file is damaged" not in str(caught.value)
    assert read_apart("a", readers.double, 2) == 4


@pytest.mark.thorough
def test_a_reader_that_never_ends_takes_what_its_file_is_worth(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(apart, "CPU_S", 1.0)
    path = tmp_path / "a.ply"
    path.write_bytes(bytes(1000))
    said = rf"{path}: the reader did not finish within 1 s of the processor"
    with pytest.raises(InputError, match=said):
        read_apart(str(path), readers.spin)
    # Each item anew; so does each file.
    assert list(stream_apart(str(path), readers.items_of_work, 4)) == [0, 1, 2, 3]
    assert read_apart("a", readers.double, 2) == 4


@pytest.mark.thorough
@pytest.mark.parametrize("how", ["crash", "memory"])
def test_a_file_is_not_blamed_for_what_earlier_files_left(how: str) -> None:
    first, second = (read_apart("a", readers.harm, how) for _ in range(2))
    assert first != second
    (third,) = stream_apart("v", readers.harmed_stream, how)
    assert third != second
    # Nor for what they took from the memory that its later items need: each item comes once.
    assert list(stream_apart("v", readers.harmed_late, how)) == [1, 2, 3]
    # Nor for a process that ended while it waited, as where a system runs out of memory.
    os.kill(read_apart("a", readers.process_number), signal.SIGKILL)
    assert read_apart("a", readers.double, 2) == 4


def test_a_library_of_its_own_pool_leaves_the_other_processes_alone() -> None:
    common, own = (read_apart("a", readers.process_number, pool=pool) for pool in ("", "own"))
    assert common != own
    assert read_apart("a", readers.process_number) == common
    assert read_apart("a", readers.process_number, pool="own") == own


def test_arrays_come_back_where_there_are_no_files_in_memory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delattr(os, "memfd_create", raising=False)
    monkeypatch.setattr(apart, "_readers", apart._Readers())
    value = np.arange(1 << 20, dtype=np.float64).reshape(1024, 1024)
    try:
        for factor in (1, 2):
            np.testing.assert_array_equal(
                read_apart("a", readers.double, factor * value), 2 * factor * value
            )
    finally:
        apart._readers.end()


def test_relative_paths_are_those_of_the_caller(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in (tmp_path, Path("/")):
        monkeypatch.chdir(folder)
        assert read_apart("a", os.getcwd) == str(folder)


def test_a_reader_that_hangs_is_ended() -> None:
    start = time.monotonic()
    with pytest.raises(InputError, match=r"^x\.ply: the reader did not finish within 0\.3 s"):
        read_apart("x.ply", readers.sleep, limit_s=0.3)
    assert time.monotonic() - start < 60  # It would sleep as long.
    assert read_apart("a", readers.double, 2) == 4


def test_a_mistake_of_ours_stays_one_and_tells_its_traceback() -> None:
    with pytest.raises(KeyError) as caught:
        read_apart("x.ply", readers.mistake)
    assert "in mistake" in caught.value.__notes__[0]


@pytest.mark.thorough
def test_streams() -> None:
    assert list(stream_apart("v", readers.count, 5)) == [0, 1, 2, 3, 4]
    assert list(stream_apart("v", readers.count, 0)) == []
    for read, words in ((readers.count_and_crash, "crashed"), (readers.count_and_refuse, "short")):
        seen = []
        with pytest.raises(InputError, match=words):
            for item in stream_apart("v", read, 3):
                seen.append(item)
        assert seen == [0, 1, 2]


def test_a_stream_is_read_one_ahead_and_no_further() -> None:
    """However slow the one who takes the items is."""
    stream = stream_apart("v", readers.times, 6)
    asked, made = [], []
    for _ in range(6):
        asked.append(time.monotonic())
        made.append(next(stream))
        time.sleep(0.1)
    # While one is taken the next is made, and the one behind that not before this was asked for.
    assert all(later > before for before, later in zip(asked[:-2], made[2:], strict=True))


@pytest.mark.thorough
def test_arrays_of_all_shapes_come_back() -> None:
    values = {
        "empty": np.zeros((0, 3)),
        "turned": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        "strided": np.arange(100)[::7],
        "large": np.arange(5_000_000),
        "small": np.arange(3, dtype=np.uint8),
    }
    for _ in range(2):
        found = read_apart("a", readers.same, values)
        assert found.keys() == values.keys()
        for key, value in values.items():
            np.testing.assert_array_equal(found[key], value)
            assert found[key].flags.writeable


def test_an_error_that_does_not_pickle_is_told() -> None:
    with pytest.raises(RuntimeError, match="_OwnError: 3 and 4"):
        read_apart("x.ply", readers.own_error)
    assert read_apart("a", readers.double, 2) == 4


@pytest.mark.thorough
def test_streams_side_by_side_and_left_early() -> None:
    one, two = stream_apart("v", readers.count, 10**6), stream_apart("w", readers.count, 3)
    assert [next(one), next(two), next(one), next(two)] == [0, 0, 1, 1]
    one.close()
    assert list(two) == [2]
    assert read_apart("a", readers.double, 2) == 4


@pytest.mark.thorough
def test_a_plain_script_needs_no_guard_and_ctrl_c_leaves_nothing(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "import tests.files.foreign_readers as r\n"
        "from taccel_lab.files.apart import read_apart\n"
        "print(read_apart('a', r.process_number, by='numpy'), flush=True)\n"
        "read_apart('a', r.sleep, by='numpy')\n",
        encoding="utf-8",
    )
    run = subprocess.Popen(
        [sys.executable, str(script)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        # Shells start what runs in the background with Ctrl-C ignored, which is inherited.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert run.stdout is not None
    child = int(run.stdout.readline())
    time.sleep(0.5)  # until it waits for the sleeper, as somebody who grows impatient
    run.send_signal(signal.SIGINT)
    assert run.wait(50) != 0
    with pytest.raises(ProcessLookupError):
        while True:
            os.kill(child, 0)
            time.sleep(0.05)
