# SPDX-License-Identifier: Apache-2.0
"""Files of a folder that stays, which a command goes on with: appended to by whole lines, or held
by one run. None is reached by a link, and new ones have the permissions of the user's umask."""

from __future__ import annotations

import fcntl
import os
import socket
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from taccel_lab.errors import InputError
from taccel_lab.files.inner_path import own_place


@contextmanager
def growing_file(path: Path) -> Iterator[IO[str]]:
    """A file to read and to append to; a last line without its end gets one first.

    Raises InputError for a link and for what is no regular file; OSError as ``open``.
    """
    own_place(path.parent, path.name)
    # A link that came since is refused, and a pipe does not wait for a writer.
    flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    with open(os.open(path, flags, 0o666), "a+", encoding="utf-8", newline="\n") as file:
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode):
            raise InputError(f"{path} is no regular file but a pipe, a socket or a device")
        if status.st_size and os.pread(file.fileno(), 1, status.st_size - 1) != b"\n":
            file.write("\n")
            file.flush()
        yield file


@contextmanager
def held_file(path: Path, busy: str, advice: str, *, shared: bool = False) -> Iterator[None]:
    """Lock a file until the block or this process ends, and note in it who holds it.

    Args:
        path: The file, made where it is absent.
        busy: What it means that another process holds it.
        advice: What to do then.
        shared: Beside others who share it.

    Raises InputError where another process holds it, where its file system has no locks, and as
    ``growing_file``.
    """
    with growing_file(path) as file:
        try:
            fcntl.flock(file, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        except BlockingIOError:
            file.seek(0)
            who = file.read().strip() or "process ?"
            raise InputError(f"{busy} ({who}); {advice}") from None
        except OSError as error:
            raise InputError(
                f"{path} cannot be locked ({error.strerror}), which keeps runs apart; name a "
                "folder on a file system with locks, such as NFS 4, or Lustre mounted with flock"
            ) from None
        file.seek(0)
        file.truncate()
        file.write(f"process {os.getpid()} on {socket.gethostname()}\n")
        file.flush()
        yield
