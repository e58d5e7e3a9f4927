# SPDX-License-Identifier: Apache-2.0
"""Output folders appear whole or not at all, and never in the place of somebody else's files."""

from __future__ import annotations

import os
import shutil
import stat
import subprocess
import sys
import textwrap
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from taccel_lab.errors import InputError
from taccel_lab.files import output_folder
from taccel_lab.files.output_folder import (
    atomic_directory,
    may_hold,
    require_growable,
    require_replaceable,
    sweep_up,
)
from taccel_lab.files.output_marker import OUTPUT_MARKER


def tree(folder: Path) -> dict[str, str]:
    """Every file below ``folder``, hidden ones too, with its contents; of markers only the name."""
    return {
        str(path.relative_to(folder)): "folder"
        if path.is_dir()
        else ""
        if path.name == OUTPUT_MARKER
        else path.read_text()
        for path in sorted(folder.rglob("*"))
    }


def write(target: Path, text: str) -> None:
    with atomic_directory(target) as folder:
        (folder / "a.txt").write_text(text)


def begin(target: Path | str) -> None:
    """Ask for an output, before anything is written."""
    atomic_directory(target).__enter__()


@pytest.fixture
def target(tmp_path: Path) -> Path:
    """An earlier output, which holds ``a.txt``."""
    write(tmp_path / "out", "old")
    return tmp_path / "out"


@pytest.fixture(params=[True, False], ids=["one step", "two steps"])
def at_once(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> bool:
    """Whether the file system can let two folders change places."""
    if not request.param:
        monkeypatch.setattr(output_folder, "exchange", lambda one, other: False)
    return request.param


def test_a_folder_appears_at_the_end_and_replaces_an_earlier_one_as_a_whole(tmp_path: Path) -> None:
    target = tmp_path / "deep" / "er" / "out"
    with atomic_directory(target) as folder:
        (folder / "old.txt").write_text("old")
        assert not target.exists() and folder.parent == target.parent
    assert tree(target) == {OUTPUT_MARKER: "", "old.txt": "old"}
    assert stat.S_IMODE(target.stat().st_mode) == 0o755
    with atomic_directory(target) as folder:
        (folder / "a.txt").write_text("new")
        assert (target / "old.txt").read_text() == "old"
    assert tree(target) == {OUTPUT_MARKER: "", "a.txt": "new"}
    assert os.listdir(target.parent) == ["out"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
@pytest.mark.parametrize("place", ["out", "mine/a/b/out"])
def test_failure_leaves_nothing(target: Path, error: type[BaseException], place: str) -> None:
    """Neither half of a file nor a new parent, but what others put there meanwhile."""
    root = target.parent
    (root / "mine").mkdir()
    before = tree(root)
    with pytest.raises(error), atomic_directory(root / place) as folder:
        (folder / "half.txt").write_text("half")
        (folder / "sub").mkdir()
        raise error
    assert tree(root) == before
    with pytest.raises(error), atomic_directory(root / "a" / "b" / "out"):
        (root / "a" / "theirs.txt").write_text("theirs")
        raise error
    assert tree(root) == {**before, "a": "folder", "a/theirs.txt": "theirs"}


@pytest.mark.parametrize("failing_call", [1, 2, 3])
def test_earlier_output_survives_a_failed_exchange(
    target: Path, monkeypatch: pytest.MonkeyPatch, failing_call: int
) -> None:
    before = tree(target.parent)
    rename, calls = os.rename, []

    def sometimes(source: Path, destination: Path) -> None:
        calls.append(source)
        if len(calls) == failing_call:
            raise OSError(28, "No space left on device")
        rename(source, destination)

    monkeypatch.setattr(output_folder, "exchange", lambda one, other: False)
    monkeypatch.setattr(os, "rename", sometimes)
    with pytest.raises(OSError, match="No space left"):
        write(target, "new")
    require_replaceable(target)
    # The third call only clears away: the new one stands then.
    new = {"out/a.txt": "new"} if failing_call == 3 else {}
    assert tree(target.parent) == {**before, **new}


def _killed(when: int, at_once: bool, target: Path) -> int:
    """Exit code of a writer that dies without a word at a call that changes the file system or
    opens something: 9, or 0 where it has fewer of them."""
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    calls = 0

    def deadly(call: Callable[..., Any]) -> Callable[..., Any]:
        def wrapped(*arguments: Any, **options: Any) -> Any:
            nonlocal calls
            calls += 1
            if calls == when:
                os._exit(9)
            return call(*arguments, **options)

        return wrapped

    code = 1
    try:
        exchange = deadly(output_folder.exchange) if at_once else lambda *_: False
        setattr(output_folder, "exchange", exchange)  # noqa: B010
        for name in ("rename", "rmdir", "unlink", "open", "mkdir"):
            setattr(os, name, deadly(getattr(os, name)))
        with atomic_directory(target) as folder:
            (folder / "a.txt").write_text("new")
            (folder / "sub").mkdir()
            (folder / "sub" / "b.txt").write_text("new")
        code = 0
    finally:
        os._exit(code)


@pytest.mark.thorough
@pytest.mark.parametrize("at_once", [True, False])
def test_killed_anywhere_the_next_run_finds_the_earlier_or_the_new_one(
    tmp_path: Path, at_once: bool
) -> None:
    old = {OUTPUT_MARKER: "", "a.txt": "old"}
    new = {OUTPUT_MARKER: "", "a.txt": "new", "sub": "folder", "sub/b.txt": "new"}
    found, code, when = set(), 9, 0
    while code:
        when += 1
        assert when < 60, "the writer never came to its end"
        target = tmp_path / str(when) / "out"
        write(target, "old")
        code = _killed(when, at_once, target)
        assert not at_once or (target / "a.txt").exists(), f"nothing at {when}"
        require_replaceable(target)
        assert os.listdir(target.parent) == ["out"], f"left over at {when}"
        written = tree(target)
        assert written in (old, new)
        found.add(written["a.txt"])
    assert when > 6 and found == {"old", "new"}


def test_a_folder_that_is_being_written_is_not_swept_up(tmp_path: Path) -> None:
    target = tmp_path / "out"
    with atomic_directory(target) as folder:
        (folder / "a.txt").write_text("slow")
        write(target, "quick")
        require_replaceable(target)
        assert folder.exists()
    assert (target / "a.txt").read_text() == "slow"
    assert os.listdir(tmp_path) == ["out"]


@pytest.mark.usefixtures("at_once")
def test_writers_side_by_side(target: Path) -> None:
    def writer(number: int) -> None:
        for _ in range(20):
            write(target, str(number))

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(writer, range(4)))
    assert os.listdir(target.parent) == ["out"]
    require_replaceable(target)


@pytest.mark.thorough
def test_a_folder_that_others_put_away_and_back_is_no_file(tmp_path: Path) -> None:
    target, stop = tmp_path / "out", threading.Event()
    target.mkdir()

    def swap() -> None:
        while not stop.is_set():
            target.rename(tmp_path / "away")
            (tmp_path / "away").rename(target)

    with ThreadPoolExecutor(1) as others:
        swaps = others.submit(swap)
        try:
            for _ in range(300):
                require_replaceable(target)
        finally:
            stop.set()
        swaps.result()


READER = """
    import sys
    from pathlib import Path
    file, stop = Path(sys.argv[1]) / "a.txt", Path(sys.argv[2])
    looks = missing = 0
    while not stop.exists():
        looks += 1
        missing += not file.exists()
        if looks == 100:
            print("goes on", flush=True)
    print(missing)
"""


def test_a_reader_always_finds_an_output(target: Path) -> None:
    stop = target.with_name("stop")
    command = [sys.executable, "-c", textwrap.dedent(READER), target, stop]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as reader:
        assert reader.stdout is not None and reader.stdout.readline() == "goes on\n"
        for number in range(60):
            write(target, str(number))
        stop.touch()
        assert reader.communicate()[0] == "0\n"


@pytest.mark.usefixtures("at_once")
@pytest.mark.parametrize("name", ["notes.txt", "sub/notes.txt", "a.txt", "press/notes.txt"])
@pytest.mark.parametrize("when", ["before", "meanwhile"])
def test_files_added_or_changed_since_are_kept(tmp_path: Path, name: str, when: str) -> None:
    target = tmp_path / "out"
    with atomic_directory(target) as folder:
        (folder / "a.txt").write_text("old")
        write(folder / "press", "an output within")
    require_replaceable(target)

    def add() -> dict[str, str]:
        (target / name).parent.mkdir(exist_ok=True)
        (target / name).write_text("mine")
        return tree(target)

    if when == "before":
        before = add()
        with pytest.raises(InputError, match=rf"changed since: {name}; move them"):
            require_replaceable(target)
    with pytest.raises(InputError, match=name), atomic_directory(target) as folder:
        (folder / "a.txt").write_text("new")
        if when == "meanwhile":
            before = add()
    assert tree(target) == before
    assert os.listdir(tmp_path) == ["out"]


@pytest.mark.timeout(20)
def test_a_pipe_in_an_output_is_foreign_and_not_waited_for(target: Path) -> None:
    (target / "a.txt").unlink()
    os.mkfifo(target / "a.txt")
    with pytest.raises(InputError, match=r"a\.txt; move them"):
        require_replaceable(target)
    assert stat.S_ISFIFO((target / "a.txt").stat().st_mode)


def test_many_foreign_files_are_counted(tmp_path: Path) -> None:
    for number in range(5):
        (tmp_path / f"{number}.txt").write_text("mine")
    with pytest.raises(InputError, match=r"since: 0\.txt, 1\.txt, 2\.txt, \.\.\.; move"):
        require_replaceable(tmp_path)


@pytest.mark.parametrize("text", ["", "{", "[]", '{"files": 3}', "[" * 100_000])
def test_a_damaged_marker_vouches_for_nothing(target: Path, text: str) -> None:
    (target / OUTPUT_MARKER).write_text(text)
    with pytest.raises(InputError, match=r"a\.txt"):
        write(target, "new")
    assert (target / "a.txt").read_text() == "old"


def test_what_file_browsers_leave_behind_is_nobodys(target: Path) -> None:
    (target / ".DS_Store").write_text("")
    write(target, "new")
    assert (target / "a.txt").read_text() == "new"


def test_the_folder_that_a_link_leads_to_is_written(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "out").symlink_to(tmp_path / "disk" / "results")
    for text in ("old", "new"):
        write(tmp_path / "out", text)
        assert (tmp_path / "out").is_symlink()
        assert (tmp_path / "disk" / "results" / "a.txt").read_text() == text
    assert os.listdir(tmp_path / "disk") == ["results"]


@pytest.mark.parametrize(
    ("place", "says", "ways"),
    [
        ("/proc/taccel/out", "/proc/taccel/out cannot be written: ", (require_replaceable,)),
        ("/sys/taccel/out", "/sys/taccel/out cannot be written: ", (require_replaceable,)),
        ("/proc", "/proc is a mounted drive", (require_replaceable,)),
        ("/proc/x", "/proc/x cannot be written", (require_growable,)),
        *(
            (f"{name}/", "did not write, or", (require_replaceable, begin))
            for name in ("mine", "hidden", "deep")
        ),
        *(
            (f"file{below}", "file is a file; an output folder is needed",
             (require_replaceable, begin, require_growable))
            for below in ("", "/out", "/a/b")
        ),
        ("mine/..", "holds files that taccel-lab did not write", (require_replaceable,)),
    ],
)  # fmt: skip
def test_other_places_are_refused_before_any_work(
    place: str, says: str, ways: tuple[Callable[[str], None], ...], tmp_path: Path
) -> None:
    for name in ("mine/a.txt", "hidden/.hidden", "deep/sub/deep.txt", "file"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("mine")
    before = tree(tmp_path)
    for ask in ways:
        with pytest.raises(InputError, match=says):
            ask(str(tmp_path / place) if place[0] != "/" else place)
        assert tree(tmp_path) == before


def test_empty_and_absent_folders_are_fine(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for name in ("empty", "absent"):
        require_replaceable(tmp_path / name)
        write(tmp_path / name, "new")
        require_replaceable(tmp_path / name)
    before = tree(tmp_path)
    for name in ("empty", "new/one"):
        require_growable(tmp_path / name)
    assert tree(tmp_path) == before


@pytest.mark.usefixtures("at_once")
def test_a_check_of_its_own(tmp_path: Path) -> None:
    target = tmp_path / "profile"
    target.mkdir()
    (target / "profile.toml").write_text("old")

    def check(folder: Path) -> None:
        if folder.exists() and any(path.name != "profile.toml" for path in folder.iterdir()):
            raise InputError(f"{folder} holds more")

    with atomic_directory(target, check) as folder:
        (folder / "profile.toml").write_text("new")
    assert tree(target) == {"profile.toml": "new"}
    with pytest.raises(InputError, match="/profile holds more"), atomic_directory(target, check):
        (target / "mine.txt").write_text("meanwhile")
    assert os.listdir(tmp_path) == ["profile"]
    assert tree(target) == {"mine.txt": "meanwhile", "profile.toml": "new"}


@pytest.mark.parametrize("name", [".", "", "../here"])
def test_folder_names_without_a_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    write(Path(name), "new")
    assert tree(tmp_path) == {"here": "folder", f"here/{OUTPUT_MARKER}": "", "here/a.txt": "new"}


def test_a_folder_that_comes_between_is_not_taken_for_the_one_before(
    target: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """File systems give the number of a folder that is gone to the next one."""
    real, looked = output_folder.foreign_files, []

    def overtaken(folder: Path) -> list[str]:
        looked.append(folder)
        if len(looked) > 1:
            return real(folder)
        number = target.stat().st_ino
        kept = {path.name: path.read_bytes() for path in target.iterdir()}
        for _ in range(20):
            shutil.rmtree(target)
            target.mkdir()
            if target.stat().st_ino == number:
                break
        for name, content in kept.items():
            (target / name).write_bytes(content)
        return ["the marker of one, and a file of the other"]

    monkeypatch.setattr(output_folder, "foreign_files", overtaken)
    require_replaceable(target)


def test_a_folder_that_another_run_begins_at_this_moment_is_not_foreign(tmp_path: Path) -> None:
    assert may_hold(tmp_path / "new", "sign") and may_hold(tmp_path, "sign")
    (tmp_path / ".sign.half").write_text("half")
    assert may_hold(tmp_path, "sign")
    (tmp_path / "notes").write_text("mine")
    assert not may_hold(tmp_path, "sign")
    (tmp_path / "sign").write_text("whole")
    assert may_hold(tmp_path, "sign")


def test_what_ended_processes_left_is_swept_up(tmp_path: Path) -> None:
    """Not what a living one is writing, nor a folder of somebody else."""
    (tmp_path / ".a.taccel-lab-new-1" / "data").mkdir(parents=True)
    (tmp_path / "mine.taccel-lab-new-1").mkdir()
    with atomic_directory(tmp_path / "b") as staging:
        sweep_up(tmp_path)
        assert staging.is_dir()
    assert sorted(os.listdir(tmp_path)) == ["b", "mine.taccel-lab-new-1"]
    sweep_up(tmp_path / "none")
