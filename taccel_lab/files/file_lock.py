# SPDX-License-Identifier: Apache-2.0
"""Locks of files that runs share, on this machine or on several that see one file system."""

from __future__ import annotations

import fcntl
import os
import socket
from typing import IO

from taccel_lab.errors import InputError


def hold(file: IO[str], busy: str, advice: str, *, shared: bool = False) -> None:
    """Lock an open file until it is closed or this process ends, and note who holds it.

    Args:
        file: Open for reading and appending.
        busy: What it means that another process holds it.
        advice: What to do then.
        shared: Beside others who share it.

    Raises InputError where another process holds it, or where its file system has no locks.
    """
    try:
        fcntl.flock(file, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError:
        file.seek(0)
        who = file.read().strip() or "process ?"
        raise InputError(f"{busy} ({who}); {advice}") from None
    except OSError as error:
        raise InputError(
            f"{file.name} cannot be locked ({error.strerror}), which keeps runs apart; name a "
            "folder on a file system with locks, such as NFS 4, or Lustre mounted with flock"
        ) from None
    file.seek(0)
    file.truncate()
    file.write(f"process {os.getpid()} on {socket.gethostname()}\n")
    file.flush()
