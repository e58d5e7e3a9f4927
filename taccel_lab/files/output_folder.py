# SPDX-License-Identifier: Apache-2.0
"""Folders that appear whole or not at all, and replace only what an earlier command wrote.

A folder is written beside its target under a hidden name and changes places with an earlier one in
one step. Its marker lists every file with a digest, so that files of somebody else, and files that
were changed since, are noticed before anything is replaced. The hidden folder is locked while its
process lives: what killed runs left is swept up by the next one that writes there.
"""

from __future__ import annotations

import errno
import fcntl
import os
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path

from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import errors_named, exchange, hidden_name, parents_made
from taccel_lab.files.inner_path import (
    real_path,
    require_outside,
)
from taccel_lab.files.output_marker import (
    DESKTOP_FILES,
    MOST_SHOWN,
    foreign_files,
    marked_files,
    read_marker,
    write_marker,
)

CAPTURES = "captures.toml"
"""A folder with this file is no output that can be made again: what it was made of may be gone."""
_TRIES = 100
"""How often others may come first before a folder is given up."""
_HIDDEN = ".taccel-lab-"
_NEW = _HIDDEN + "new-"
_OVERTAKEN = {errno.ENOENT, errno.ENOTEMPTY, errno.EEXIST}
"""What renames answer when somebody else was first."""

Check = Callable[[Path], None]
"""Raises InputError for an existing folder that must not be replaced."""


def require_replaceable(target: Path | str, *, captures: bool = False) -> None:
    """Refuse an output folder that cannot be written, or that holds files of somebody else.

    Commands call this first, before any long work. An absent or an empty folder is fine, and so is
    one in which every file is as a command wrote it; with captures, where ``captures`` allows it.
    """
    target = _folder_path(target)
    require_outside(target)
    _recover(target)
    _require_own(target, captures)
    _require_writable(target)


def require_growable(target: Path | str) -> None:
    """Refuse a folder that grows file by file where nothing can be written; commands call this
    first, before any long work. What is in it is theirs to judge."""
    target = Path(os.path.abspath(target))
    _refusefiles(target)
    require_outside(target)
    _require_writable(target, beside=False)


def may_hold(target: Path | str, sign: str) -> bool:
    """Whether a folder that grows may be begun here or gone on with: it has the file ``sign``, or
    nothing visible yet. By one look, as others may begin it at the same time: hidden files first,
    the sign, then the rest."""
    names = os.listdir(target) if os.path.isdir(target) else []
    return sign in names or all(name.startswith(".") for name in names)


@contextmanager
def atomic_directory(
    target: Path | str, check: Check | None = None, *, captures: bool = False
) -> Iterator[Path]:
    """Yield a hidden folder that takes the place of ``target`` when the block ends without error.

    An earlier folder at ``target`` stays untouched until then, and goes only after the new one
    stands. A file, or a folder with files of somebody else, is rejected.

    Args:
        target: The folder; its parents are made.
        check: Says which earlier folders may be replaced, for folders that are known by other
            means than a marker; they get none.
        captures: Replace earlier captures, too.
    """
    target = _folder_path(target)
    _recover(target)
    may_replace = check or partial(_require_own, captures=captures)
    may_replace(target)
    with (
        parents_made(target),
        _staging(target) as staging,
        errors_named(staging, target),
    ):
        before = _identity(staging)
        yield staging
        # It is open all the time, so that its number goes to no other.
        if _identity(staging) != before:
            raise OSError(errno.ENOENT, "was removed while it was being written", str(staging))
        if check is None:
            write_marker(staging)
        _put(staging, target, may_replace)


def _folder_path(target: Path | str) -> Path:
    """The path, absolute where it goes through "." or "..", of a link that to which it leads;
    refused where a file is in the way."""
    target = Path(target)
    if not target.name or ".." in target.parts:
        target = Path(os.path.abspath(target))
    if target.is_symlink():
        target = real_path(target)
        if target.is_symlink():
            raise InputError(f"{target} is a link that leads back to itself")
    _refusefiles(target)
    if os.path.ismount(target):
        raise InputError(f"{target} is a mounted drive; name a folder inside it")
    return target


def _refusefiles(target: Path) -> None:
    for path in (target, *target.parents):
        # One look: between two, another process may put a folder away and back.
        with suppress(OSError):
            if not stat.S_ISDIR(path.stat().st_mode):
                raise InputError(f"{path} is a file; an output folder is needed")


# What may be replaced -------------------------------------------------------------------------


def remove_damaged(folder: Path) -> None:
    """Remove an output with ``visible_faults``; InputError where somebody put other files in it.

    What goes is what lies there, never what the list of files names; the list goes last: what a
    kill leaves is known as damaged."""
    written = read_marker(folder)
    found = [
        (name, path)
        for name, path in marked_files(folder)
        if path.is_symlink() or not path.is_dir()
    ]
    for name, path in found:
        if name not in written and path.name not in DESKTOP_FILES:
            raise InputError(
                f"{folder} is damaged and holds {name}, which taccel-lab did not write"
            )
    for _, path in found:
        path.unlink(missing_ok=True)
    shutil.rmtree(folder)


def remove_output(target: Path | str) -> None:
    """Remove a folder that a command wrote; nothing where there is none.

    Raises:
        InputError: It holds files that taccel-lab did not write, or that were changed since.
    """
    target = _folder_path(target)
    _recover(target)
    if _identity(target) is None:
        return
    _require_own(target)
    with _staging(target) as staging:
        _swap(staging, target)
        _discard(target)


def _require_own(target: Path, captures: bool = False) -> None:
    for _ in range(_TRIES):
        with _held(target) as before:
            foreign = [] if before is None else foreign_files(target)
            if not foreign:
                written = {Path(name).name for name in read_marker(target)}
                if CAPTURES in written and not captures:
                    raise InputError(
                        f"{target} holds captures; name another folder (capture import and capture "
                        "rectify have --replace)"
                    )
                return
            if _identity(target) == before:
                break
    names = [*foreign[:MOST_SHOWN], *(["..."] if len(foreign) > MOST_SHOWN else [])]
    raise InputError(
        f"{target} holds files that taccel-lab did not write, or that were changed since: "
        f"{', '.join(names)}; move them away, or name a new or empty folder"
    )


@contextmanager
def _held(folder: Path) -> Iterator[tuple[int, int] | None]:
    """The identity of a folder; open, as the number of one that is gone goes to the next."""
    try:
        handle = os.open(folder, os.O_PATH | os.O_DIRECTORY)
    except FileNotFoundError:
        yield None
        return
    try:
        status = os.fstat(handle)
        yield status.st_dev, status.st_ino
    finally:
        os.close(handle)


def _identity(folder: Path) -> tuple[int, int] | None:
    """Tells whether a path leads to another folder than before; None if there is none."""
    try:
        status = folder.stat()
    except FileNotFoundError:
        return None
    return status.st_dev, status.st_ino


def _require_writable(target: Path, beside: bool = True) -> None:
    """Try to write beside ``target``, or in it: permissions alone do not tell what a file system
    allows."""
    places = target.parents if beside else (target, *target.parents)
    parent = next(path for path in places if path.exists())
    try:
        probe = Path(tempfile.mkdtemp(prefix=_prefix(target) + "new-", dir=parent))
        try:
            (probe / "probe").write_bytes(bytes(4096))
        finally:
            shutil.rmtree(probe, ignore_errors=True)
    except OSError as error:
        raise InputError(f"{target} cannot be written: {error.strerror}") from None


# Hidden folders -------------------------------------------------------------------------------


def _prefix(target: Path) -> str:
    """How the names of hidden folders beside ``target`` begin: "new-" follows for those that may
    be thrown away when nobody holds them, "earlier-" for what must come back."""
    return f".{target.name}{_HIDDEN}"


@contextmanager
def _staging(target: Path) -> Iterator[Path]:
    """A hidden folder beside ``target``, locked until it is gone or has become the target."""
    for _ in range(_TRIES):
        staging = hidden_name(target.parent, _prefix(target) + "new-")
        try:
            staging.mkdir()
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(target)) from None
        with _lock(staging) as locked:
            # Somebody who swept up between the two lines took it for a dead one.
            if locked is None or not staging.exists():
                continue
            try:
                yield staging
            finally:
                _discard(staging)
            return
    raise InputError(f"{target} is being written by others all the time; name another folder")


@contextmanager
def _lock(folder: Path, *, wait: bool = True) -> Iterator[bool | None]:
    """Hold ``folder``: True if held, False where the file system knows no locks, None if it is
    somebody else's or gone. The lock ends with the process."""
    try:
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError:
        yield None
        return
    try:
        held: bool | None = True
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError:
            held = None
        except OSError:
            held = False
        yield held
    finally:
        os.close(handle)


def _put(staging: Path, target: Path, may_replace: Check) -> None:
    """Let ``staging`` become ``target``; an earlier one then has the hidden name."""
    if not _swap(staging, target):
        return
    # Held, so that nobody clears it away under the eyes of the check; or somebody has already.
    with _lock(staging) as found:
        if found is None:
            return
        try:
            # What came into the earlier folder while this one was being written.
            may_replace(staging)
        except InputError:
            _swap(staging, target)
            may_replace(target)
            raise


def _swap(staging: Path, target: Path) -> bool:
    """Let both change places; where there is no target, ``staging`` becomes it (False)."""
    for _ in range(_TRIES):
        try:
            if _identity(target) is None:
                os.rename(staging, target)
                return False
            if not exchange(staging, target):
                _swap_in_steps(staging, target)
            return True
        except OSError as error:
            # Others were first: there is a target now, or none any more.
            if error.errno not in _OVERTAKEN or not staging.exists():
                raise
    raise InputError(f"{target} is being written by others all the time; name another folder")


def _swap_in_steps(staging: Path, target: Path) -> None:
    """``_swap`` where nothing changes places at once: a kill in between leaves the earlier folder
    under a hidden name, from which ``_recover`` brings it back."""
    with _lock_file(target):
        earlier = Path(tempfile.mkdtemp(prefix=_prefix(target) + "earlier-", dir=target.parent))
        try:
            os.rename(target, earlier)
            os.rename(staging, target)
            os.rename(earlier, staging)
        except BaseException:
            _restore(earlier, target)
            raise


@contextmanager
def _lock_file(target: Path) -> Iterator[None]:
    """One at a time swaps ``target`` in steps or clears up after those who did."""
    path = target.parent / f"{_prefix(target)}lock"
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        if _identity(path) == (os.fstat(handle).st_dev, os.fstat(handle).st_ino):
            break
        os.close(handle)
    try:
        yield
    finally:
        path.unlink(missing_ok=True)
        os.close(handle)


def _recover(target: Path) -> None:
    """Clear away what killed runs left beside ``target``; bring back an earlier folder."""
    try:
        names = os.listdir(target.parent)
    except OSError:
        return
    prefix = _prefix(target)
    hidden = sorted(name for name in names if name.startswith(prefix))
    if any(not name.startswith(f"{prefix}new-") for name in hidden):
        with _lock_file(target):
            for name in hidden:
                if name.startswith(f"{prefix}earlier-") and _identity(target.parent / name):
                    _restore(target.parent / name, target)
    _sweep(target.parent, [name for name in hidden if name.startswith(f"{prefix}new-")])


def sweep_up(folder: Path) -> None:
    """Clear away what processes that were ended left of outputs in ``folder``."""
    with suppress(OSError):
        names = os.listdir(folder)
        _sweep(folder, [name for name in names if name.startswith(".") and _NEW in name])


def _sweep(folder: Path, names: Sequence[str]) -> None:
    for name in names:
        with _lock(folder / name, wait=False) as locked:
            if locked:
                _discard(folder / name)


def _restore(earlier: Path, target: Path) -> None:
    """Bring back what a swap in steps had put away, unless there is something newer."""
    if _identity(target) is None:
        os.rename(earlier, target)
    else:
        _discard(earlier)


def _discard(folder: Path) -> None:
    """Remove a hidden folder, unless it was an output into which somebody put other files."""
    if folder.exists() and not (read_marker(folder) and foreign_files(folder)):
        shutil.rmtree(folder, ignore_errors=True)
